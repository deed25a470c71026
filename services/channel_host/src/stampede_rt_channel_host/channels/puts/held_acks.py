"""The acks of puts that wait for replicas, or for stable storage. The acks of a stream stay in order."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Awaitable, Callable, Coroutine
from typing import Any, Protocol

from stampede_rt.errors import NotArchived, NotReplicated, Unavailable
from stampede_rt.status import to_error_message
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt_channel_host.channels.puts.acks import refused
from stampede_rt_channel_host.channels.recording import Recording
from stampede_rt_channel_host.channels.replication import Replication

HELD_ACKS_MAX = 1024  # the most held acks of one stream; at this number the host stops reading its requests
WAIT_NANOS_DEFAULT = 5_000_000_000  # for a put that states no wait


class HeldAck(Protocol):
    """An ack that is not due yet."""

    async def due(self) -> pb.PutAck:
        """Wait until the ack is due, and return it."""


class AckOfDisk:
    """An ack that is due once the archive has its items on stable storage."""

    def __init__(self, ack: pb.PutAck, channel: str, recording: Recording, wait_nanos: int | None) -> None:
        """`wait_nanos`: the longest wait; None: without a limit."""
        self._ack = ack
        self._channel = channel
        self._recording = recording
        self._ends_s = _ends_s(wait_nanos)
        recording.hurry()

    async def due(self) -> pb.PutAck:
        """Wait until the ack is due, and return it, with the error NOT_ARCHIVED if the disk did not take the items."""
        ack, recorder = self._ack, self._recording.recorder
        why = await recorder.stored(ack.first_seq, _end_seq(ack), _left_s(self._ends_s))
        if why and recorder.is_stopped:
            error = Unavailable(f"the host gave channel {self._channel} up before its archive had the items; put again")
            return refused(ack.first_number, ack.items, error, ack.host_time_unix_nano, ack.incarnation)
        if why:
            ack.error.CopyFrom(to_error_message(not_archived(self._channel, why, ack.first_seq)))
        return ack


def _end_seq(ack: pb.PutAck) -> int:
    """The seq after the accepted items of an ack."""
    last = ack.later_parts[-1] if ack.later_parts else pb.PutPart(index=0, first_seq=ack.first_seq)
    refused_behind = sum(one.index >= last.index for one in ack.rejections)
    return last.first_seq + ack.items - last.index - refused_behind


def not_archived(channel: str, why: str, first_seq: int | None = None) -> NotArchived:
    """The error of a put that waits for stable storage. `first_seq`: the channel has accepted its items."""
    metadata = {"channel": channel} if first_seq is None else {"channel": channel, "seq": str(first_seq)}
    taken = "has not accepted" if first_seq is None else "has accepted"
    return NotArchived(
        f"channel {channel} {taken} the put, and its archive could not take the items ({why}); look at `stampede "
        'doctor`, and put again, or with ack="host" if memory is enough',
        metadata=metadata,
    )


def _ends_s(wait_nanos: int | None) -> float | None:
    return None if wait_nanos is None else asyncio.get_running_loop().time() + wait_nanos / 1e9


def _left_s(ends_s: float | None) -> float | None:
    return None if ends_s is None else max(0.0, ends_s - asyncio.get_running_loop().time())


class AckOfReplicas:
    """An ack that is due once all items before the seq `next_seq` are replicated.

    `may_lag`: it is due once no replica in sync is more than a second behind.
    """

    def __init__(
        self, ack: pb.PutAck, channel: str, replication: Replication, next_seq: int, wait_nanos: int | None,
        *, may_lag: bool = False,
    ) -> None:  # fmt: skip
        """`wait_nanos`: the longest wait; None: without a limit."""
        self._may_lag = may_lag
        self._ack = ack
        self._channel = channel
        self._replication = replication
        self._period = replication.period
        self._next_seq = next_seq
        self._ends_s = _ends_s(wait_nanos)

    async def due(self) -> pb.PutAck:
        """Wait until the ack is due, and return it. After the longest wait it has the error NOT_REPLICATED."""
        replication, ack = self._replication, self._ack
        is_due = await replication.wait_until(self._is_due, _left_s(self._ends_s), self._period)
        ack.copies = replication.copies(self._next_seq)
        if is_due:
            return ack
        if (ended := self._period.ended) is not None:
            return refused(ack.first_number, ack.items, ended, ack.host_time_unix_nano, ack.incarnation)
        items = ack.items - len(ack.rejections)
        replication.not_replicated += items
        ack.error.CopyFrom(to_error_message(self._error(items, ack.copies)))
        return ack

    def _is_due(self) -> bool:
        replication = self._replication
        return replication.is_within_lag if self._may_lag else replication.replicated_next >= self._next_seq

    def _error(self, items: int, copies: int) -> NotReplicated:
        least = self._replication.min_replicas
        return NotReplicated(
            f"channel {self._channel} has accepted the put, but the replicas did not have it in time: {copies - 1} in "
            f"sync hold it, and min_replicas is {least}; readers see it once it is replicated; look at `stampede info "
            f"{self._channel}`, or start another host",
            metadata={"channel": self._channel, "seq": str(self._ack.first_seq), "copies": str(copies)},
        )


class HeldAcks:
    """The acks of one stream that are not due, and the acks after them. Passes them to `pass_on`, in order."""

    def __init__(
        self, pass_on: Callable[[pb.PutAck], Awaitable[None]],
        spawn: Callable[[Coroutine[Any, Any, None]], asyncio.Task[None]],
    ) -> None:  # fmt: skip
        """`spawn` makes a task that ends with the stream."""
        self._pass_on = pass_on
        self._acks: deque[pb.PutAck | HeldAck] = deque()
        self._changed = asyncio.Event()
        self._task = spawn(self._run())

    def __bool__(self) -> bool:
        return bool(self._acks)

    async def add(self, ack: pb.PutAck | HeldAck) -> None:
        """Add an ack after the others. Waits while there are HELD_ACKS_MAX."""
        while len(self._acks) >= HELD_ACKS_MAX:
            await self._next_change()
        self._acks.append(ack)
        self._note()

    async def all_passed(self) -> None:
        """Wait until no ack is left."""
        while self._acks:
            await self._next_change()

    def close(self) -> None:
        """Stop waiting. Idempotent."""
        self._task.cancel()

    async def _run(self) -> None:
        while True:  # until the stream ends
            while not self._acks:
                await self._next_change()
            first = self._acks[0]
            ack = first if isinstance(first, pb.PutAck) else await first.due()
            await self._pass_on(ack)
            self._acks.popleft()
            self._note()

    async def _next_change(self) -> None:
        await self._changed.wait()

    def _note(self) -> None:
        changed, self._changed = self._changed, asyncio.Event()
        changed.set()
