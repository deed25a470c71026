"""The rings in shared memory of a host: their readers, their memory, and their ends."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from itertools import islice
from typing import Any

from stampede_rt.errors import InvalidArgument, Overloaded
from stampede_rt.ring.layout import RING_BYTES_MAX
from stampede_rt.transports import futexes
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt_channel_host.channels.channel_ring import FILLED_SLICES_MAX, ChannelRing
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.limits.memory import MemoryBudget
from stampede_rt_channel_host.core.ring_sizes import DATA_BYTES_MAX, data_bytes_for, longest_run
from stampede_rt_channel_host.core.ring_writer import ClockReading, ring_size
from stampede_rt_runtime.access.control import is_denied
from stampede_rt_runtime.rpc import Context
from stampede_rt_runtime.sockets.stream_socket import LOCAL_PEER

logger = logging.getLogger(__name__)

MEMORY_SHARE = 4  # all rings together take at most this part of the host's memory
KEPT_SECONDS = 10.0  # a ring without readers stays for this time
REFRESH_SECONDS = 0.2  # the time between two refreshes of the fence and the clock in all rings


class Rings:
    """Makes a ring when a reader first asks for one, and drops it KEPT_SECONDS after its last reader has left."""

    def __init__(self, memory: MemoryBudget, clock: Callable[[], ClockReading]) -> None:
        """`clock` reads the host's clock together with CLOCK_BOOTTIME."""
        self._memory, self._clock = memory, clock
        self.fence_boottime: Callable[[], int] = lambda: 0
        """Returns the instant until which the host may serve, in nanoseconds of CLOCK_BOOTTIME; 0: it may not serve."""
        self._open: dict[ChannelRing, HostedChannel] = {}
        self._charge = memory.charge_for("")
        self._used_bytes = 0
        self._refreshing: asyncio.TimerHandle | None = None

    def __len__(self) -> int:
        return len(self._open)

    async def serve(self, hosted: HostedChannel, context: Context) -> None:
        """Give one reader the ring of the channel. Returns when the ring has ended, or the reader has gone.

        Raises InvalidArgument if the reader is not at a Unix socket, and Overloaded if the host has no memory for a
        ring.
        """
        write: Any = getattr(context, "write_with_file", None)
        if write is None or context.peer() != LOCAL_PEER or not futexes.is_supported():
            raise InvalidArgument("memory is shared only over the Unix socket of the host, on Linux and x86-64")
        if unsuited := _unsuited(hosted):
            await context.write(pb.ShareMemoryResponse(detail=unsuited).SerializeToString())
            return
        ring = self._of(hosted)
        ring.readers += 1
        try:
            response = pb.ShareMemoryResponse(memory_bytes=ring.size.whole_bytes)
            await write(response.SerializeToString(), ring.file)
            await _first_of(context.read(), ring.ended.wait())
        finally:
            ring.readers -= 1
            if is_denied():
                hosted.close_ring()  # the other readers get a new ring, which the denied reader cannot map
            elif not ring.readers and ring.is_open:
                asyncio.get_running_loop().call_later(KEPT_SECONDS, self._drop_unused, ring)

    def _of(self, hosted: HostedChannel) -> ChannelRing:
        if hosted.ring is not None:
            return hosted.ring
        newest = islice(hosted.channel.newest_slices(), FILLED_SLICES_MAX)
        largest = max((len(part.run.body) for part in newest), default=0)
        size = ring_size(data_bytes_for(max(largest, hosted.largest_run_bytes)))
        assert size.whole_bytes <= RING_BYTES_MAX, "readers refuse a larger one"
        wanted_bytes = size.whole_bytes
        if self._used_bytes + wanted_bytes > self._memory.bytes_max // MEMORY_SHARE:
            raise Overloaded(
                f"the host shares {self._used_bytes} bytes of memory with readers, a quarter of its memory at most "
                "(--memory-bytes-max); read without shared memory"
            )
        self._charge.claim(wanted_bytes)
        try:
            ring = ChannelRing(hosted.channel, size, self._clock)
        except OSError as error:
            raise Overloaded(f"the system gives no memory to share: {error.strerror or error}") from error
        self._count(wanted_bytes)
        self._open[ring] = hosted
        hosted.ring, ring.on_closed = ring, lambda: self._closed(ring)
        ring.refresh(self.fence_boottime())
        if self._refreshing is None:
            self._refresh_later()
        return ring

    def refresh(self) -> None:
        """Write to all rings the instant until which the host may serve, and the host's clock."""
        fence_boottime = self.fence_boottime()
        for ring in self._open:
            ring.refresh(fence_boottime)

    def fence(self) -> None:
        """Tell the readers of all rings that the host serves no more, because it shuts down."""
        self.fence_boottime = lambda: 0
        self.refresh()

    def _refresh_later(self) -> None:
        self._refreshing = asyncio.get_running_loop().call_later(REFRESH_SECONDS, self._refresh_on)

    def _refresh_on(self) -> None:
        self._refreshing = None
        self.refresh()
        if self._open:
            self._refresh_later()

    def _drop_unused(self, ring: ChannelRing) -> None:
        if ring.is_open and not ring.readers:
            self._open[ring].close_ring()

    def _closed(self, ring: ChannelRing) -> None:
        del self._open[ring]
        self._count(-ring.size.whole_bytes)

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
    if hosted.largest_run_bytes > longest_run(DATA_BYTES_MAX):
        return "the channel's items are too large"
    return ""


async def _first_of(*waits: Any) -> None:
    """Wait until one of the waits is over, and cancel the others."""
    tasks = [asyncio.ensure_future(one) for one in waits]
    try:
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in tasks:
            task.cancel()
