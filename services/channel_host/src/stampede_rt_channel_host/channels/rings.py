"""The rings in shared memory of a host: their readers, their memory, and their ends."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from typing import Any

from stampede_rt.errors import InvalidArgument, Overloaded, Unavailable
from stampede_rt.ring.layout import RingSize
from stampede_rt.transports import futexes
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt_channel_host.channels.channel_ring import ChannelRing, newest_run_bytes
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.limits.memory import MemoryBudget
from stampede_rt_channel_host.channels.ring_memory import RingMemory
from stampede_rt_channel_host.core.ring_sizes import RingFit, ring_fits_for
from stampede_rt_channel_host.core.ring_writer import ClockReading, ring_size
from stampede_rt_runtime.access.control import is_denied
from stampede_rt_runtime.rpc import Context
from stampede_rt_runtime.sockets.stream_socket import LOCAL_PEER

logger = logging.getLogger(__name__)

MEMORY_SHARE = 4  # all rings together take at most this part of the host's memory
KEPT_SECONDS = 10.0  # a ring without readers stays for this time
REFRESH_SECONDS = 0.2  # the time between two refreshes of the fence and the clock in all rings
REVIEW_SECONDS = 30.0  # the time between two comparisons of a ring with the runs of its channel
REVIEWS_MAX = 16  # the most comparisons in one refresh


class Rings:
    """Makes a ring when a reader first asks for one, and drops it KEPT_SECONDS after its last reader has left.

    A ring that no longer fits the runs of its channel ends, and its readers ask for a new one. If memory is short, the
    new ring is shorter than its channel needs.
    """

    def __init__(self, memory: MemoryBudget, clock: Callable[[], ClockReading]) -> None:
        """`clock` reads the host's clock together with CLOCK_BOOTTIME."""
        self._memory, self._clock = memory, clock
        self.fence_boottime: Callable[[], int] = lambda: 0
        """Returns the instant until which the host may serve, in nanoseconds of CLOCK_BOOTTIME; 0: it may not serve."""
        self._open: dict[ChannelRing, HostedChannel] = {}
        self._making: dict[object, asyncio.Future[ChannelRing]] = {}
        self._charge = memory.charge_for("")
        self._used_bytes = 0
        self._refreshing: asyncio.TimerHandle | None = None

    def __len__(self) -> int:
        return len(self._open)

    async def serve(self, hosted: HostedChannel, context: Context) -> None:
        """Give one reader the ring of the channel. Returns when the ring has ended, or the reader has gone.

        Raises InvalidArgument if the reader is not at a Unix socket, Overloaded if the host has no memory for a ring,
        and Unavailable if the channel has changed or left while a worker thread made the ring.
        """
        write: Any = getattr(context, "write_with_file", None)
        if write is None or context.peer() != LOCAL_PEER or not futexes.is_supported():
            raise InvalidArgument("memory is shared only over the Unix socket of the host, on Linux and x86-64")
        if unsuited := _unsuited(hosted):
            await context.write(pb.ShareMemoryResponse(detail=unsuited).SerializeToString())
            return
        ring = await self._of(hosted)
        ring.readers += 1
        try:
            response = pb.ShareMemoryResponse(memory_bytes=ring.memory.size.whole_bytes)
            await write(response.SerializeToString(), ring.memory.file)
            await _first_of(context.read(), ring.ended.wait())
        finally:
            ring.readers -= 1
            if is_denied():
                hosted.close_ring()  # the other readers get a new ring, which the denied reader cannot map
            elif not ring.readers and ring.is_open:
                asyncio.get_running_loop().call_later(KEPT_SECONDS, self._drop_unused, ring)

    async def _of(self, hosted: HostedChannel) -> ChannelRing:
        """The open ring of the channel. All readers that ask while a thread makes the ring wait for this ring."""
        if hosted.ring is not None:
            return hosted.ring
        making = self._making.get(hosted.ring_making)
        if making is None:
            making = self._begin_making(hosted)
        ring = await asyncio.shield(making)  # the other readers still want the ring if this reader goes
        if not ring.is_open:
            raise _changed(hosted)
        return ring

    def _begin_making(self, hosted: HostedChannel) -> asyncio.Future[ChannelRing]:
        mark = hosted.ring_making = object()
        making = self._making[mark] = asyncio.ensure_future(self._make(hosted, mark))

        def made(done: asyncio.Future[ChannelRing]) -> None:
            del self._making[mark]
            if hosted.ring_making is mark:
                hosted.ring_making = None
            if not done.cancelled():
                done.exception()  # perhaps no reader waits for the ring any more

        making.add_done_callback(made)
        return making

    async def _make(self, hosted: HostedChannel, mark: object) -> ChannelRing:
        """Make the ring. `HostedChannel.close_ring` takes the mark away, and then no reader may get this ring."""
        while True:
            fit = self._fit_for(_longest_run(hosted))
            if fit is None:
                hosted.refused_run_bytes = 0  # perhaps such a run never comes again
                raise Overloaded(
                    f"the host shares {self._used_bytes} bytes of memory with readers, a quarter of its memory at most "
                    "(--memory-bytes-max, or max_memory of st.host); read without shared memory"
                )
            memory = await self._take(ring_size(fit.data_bytes))
            if hosted.ring_making is not mark or _unsuited(hosted):
                self._free(memory)
                raise _changed(hosted)
            if _longest_run(hosted) <= fit.longest_run:
                return self._begin(hosted, memory, fit)
            self._free(memory)  # the items have grown meanwhile

    def _fit_for(self, run_bytes: int, freed_bytes: int = 0) -> RingFit | None:
        """The best ring for runs of this length for which there is memory, after `freed_bytes` have become free."""
        room_bytes = self._memory.bytes_max // MEMORY_SHARE - self._used_bytes + freed_bytes
        for fit in ring_fits_for(run_bytes):
            whole_bytes = ring_size(fit.data_bytes).whole_bytes
            if whole_bytes <= room_bytes and self._charge.has_room(whole_bytes - freed_bytes):
                return fit
        return None

    async def _take(self, size: RingSize) -> RingMemory:
        self._count(size.whole_bytes)
        try:
            return await asyncio.get_running_loop().run_in_executor(None, RingMemory, size)
        except BaseException as error:
            self._count(-size.whole_bytes)
            if isinstance(error, OSError):
                raise Overloaded(f"the system gives no memory to share: {error.strerror or error}") from error
            raise

    def _free(self, memory: RingMemory) -> None:
        memory.close_soon()
        self._count(-memory.size.whole_bytes)

    def _begin(self, hosted: HostedChannel, memory: RingMemory, fit: RingFit) -> ChannelRing:
        """Open the ring with the newest items of this moment. From now on the channel repeats each change in it."""
        ring = ChannelRing(hosted.channel, memory, fit, self._clock)
        ring.recent_runs.note(hosted.refused_run_bytes)
        hosted.refused_run_bytes = 0
        self._open[ring] = hosted
        hosted.ring, ring.on_closed = ring, lambda: self._closed(ring)
        ring.refresh(self.fence_boottime())
        if self._refreshing is None:
            self._refresh_later()
        asyncio.get_running_loop().call_later(KEPT_SECONDS, self._drop_unused, ring)  # the readers may have gone
        return ring

    def refresh(self) -> None:
        """Write to all rings the instant until which the host may serve, and the host's clock."""
        fence_boottime = self.fence_boottime()
        for ring in self._open:
            ring.refresh(fence_boottime)

    def fence(self) -> None:
        """Tell the readers of all rings that the host no longer serves, because it shuts down."""
        self.fence_boottime = lambda: 0
        self.refresh()

    def _refresh_later(self) -> None:
        self._refreshing = asyncio.get_running_loop().call_later(REFRESH_SECONDS, self._refresh_on)

    def _refresh_on(self) -> None:
        self._refreshing = None
        self.refresh()
        self.review(asyncio.get_running_loop().time())
        if self._open:
            self._refresh_later()

    def review(self, now_s: float) -> None:
        """End the rings that no longer fit the runs of their channels. Their readers ask for new ones.

        `now_s`: the time of the event loop. This looks at a ring every REVIEW_SECONDS.
        """
        due = [ring for ring in self._open if now_s - ring.reviewed_s >= REVIEW_SECONDS]
        for ring in due[:REVIEWS_MAX]:
            ring.reviewed_s, hosted = now_s, self._open[ring]
            longest = max(ring.recent_runs.begin_period(), newest_run_bytes(hosted.channel))
            best = self._fit_for(longest, ring.memory.size.whole_bytes)
            if best is not None and not ring.fit.is_near(best):
                hosted.refused_run_bytes = longest  # the next ring takes such a run, too
                hosted.close_ring()

    def _drop_unused(self, ring: ChannelRing) -> None:
        if ring.is_open and not ring.readers:
            self._open[ring].close_ring()

    def _closed(self, ring: ChannelRing) -> None:
        del self._open[ring]
        self._count(-ring.memory.size.whole_bytes)

    def _count(self, added_bytes: int) -> None:
        self._used_bytes += added_bytes
        self._charge.set(self._used_bytes)


def _unsuited(hosted: HostedChannel) -> str:
    """The reason why a ring cannot repeat the channel; empty if it can."""
    policy = hosted.record.policy
    if policy.consumers or policy.max_age_unconsumed_nanos:
        return "items of a channel with consumers leave it when they are consumed, which only the host knows"
    if hosted.core is not hosted.channel:
        return "the items of a channel with replicas are shown when the replicas have them, which only the host knows"
    if next(ring_fits_for(_longest_run(hosted)), None) is None:
        hosted.refused_run_bytes = 0  # perhaps such a run never comes again
        return "the channel's items are too large"
    return ""


def _longest_run(hosted: HostedChannel) -> int:
    return max(newest_run_bytes(hosted.channel), hosted.refused_run_bytes)


def _changed(hosted: HostedChannel) -> Unavailable:
    return Unavailable(f"channel {hosted.record.name!r} changed while the host took memory for it; ask again")


async def _first_of(*waits: Any) -> None:
    """Wait until one of the waits is over, and cancel the others."""
    tasks = [asyncio.ensure_future(one) for one in waits]
    try:
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in tasks:
            task.cancel()
