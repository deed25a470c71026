"""The acks of puts that wait for replicas, or for stable storage. The acks of a stream stay in order."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Awaitable, Callable, Coroutine
from typing import Any, Protocol

from stampede_rt.errors import NotArchived, NotReplicated, Unavailable
from stampede_rt.status import to_error_message
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt_channel_host.channels.owned_replicas import OwnedReplicas
from stampede_rt_channel_host.channels.puts.acks import refused
from stampede_rt_channel_host.channels.recording import Recording

PASSED_MAX = 64  # the most acks that a stream passes on together
HELD_ACKS_MAX = 1024  # the most held acks of one stream; at this number the host stops reading its requests
WAIT_NANOS_DEFAULT = 5_000_000_000  # for a put that states no wait


class HeldAck(Protocol):
    """An ack that may not be due yet."""

    @property
    def is_due(self) -> bool:
        """Whether `due` returns at once."""

    async def due(self) -> pb.PutAck:
        """Wait until the ack is due, and return it."""


class AckOfDisk:
    """An ack that is due as soon as the archive has its items on stable storage."""

    def __init__(self, ack: pb.PutAck, channel: str, recording: Recording, wait_nanos: int | None) -> None:
        """`wait_nanos`: the longest wait; None: without a limit."""
        self._ack = ack
        self._channel = channel
        self._recording = recording
        self._ends_s = _ends_s(wait_nanos)
        recording.hurry()

    @property
    def is_due(self) -> bool:
        """Whether `due` returns at once. False, because the ack cannot know."""
        return False

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
    """The ack of a put into a channel or queue, which is due as soon as the replicas have everything before
    `next_place`.
    """

    def __init__(
        self, ack: pb.PutAck, replication: OwnedReplicas[Any], next_place: int, wait_nanos: int | None,
        explain: Callable[[pb.PutAck], NotReplicated], is_enough: Callable[[], bool] | None = None,
    ) -> None:  # fmt: skip
        """`wait_nanos`: the longest wait; None: without a limit. After it, `explain` makes the error for the ack.

        `is_enough`: the ack is due as soon as this holds, even if some replicas do not have everything.
        """
        self._is_replicated = is_enough or (lambda: replication.replicated_next >= next_place)
        self._ack = ack
        self._replication = replication
        self._period = replication.period
        self._next_place = next_place
        self._explain = explain
        self._ends_s = _ends_s(wait_nanos)

    @property
    def is_due(self) -> bool:
        """Whether `due` returns at once."""
        return self._is_replicated() or self._period.ended is not None

    async def due(self) -> pb.PutAck:
        """Wait until the ack is due, and return it. After the longest wait it has the error NOT_REPLICATED."""
        replication, ack = self._replication, self._ack
        is_replicated = self._is_replicated() or await replication.wait_until(
            self._is_replicated, _left_s(self._ends_s), self._period
        )
        ack.copies = replication.copies(self._next_place)
        if is_replicated:
            return ack
        if (ended := self._period.ended) is not None:
            return refused(ack.first_number, ack.items, ended, ack.host_time_unix_nano, ack.incarnation)
        replication.not_replicated += ack.items - len(ack.rejections)
        ack.error.CopyFrom(to_error_message(self._explain(ack)))
        return ack


class HeldAcks:
    """The acks of one stream that are not due, and the acks after them. Passes them to `pass_on`, in order.

    `pass_on` gets the acks that have become due together.
    """

    def __init__(
        self, pass_on: Callable[[list[pb.PutAck]], Awaitable[None]],
        spawn: Callable[[Coroutine[Any, Any, None]], asyncio.Task[None]],
    ) -> None:  # fmt: skip
        """`spawn` makes a task that ends with the stream."""
        self._pass_on = pass_on
        self._acks: deque[pb.PutAck | HeldAck] = deque()
        self._changed = asyncio.Event()
        self._task = spawn(self._run())

    def __bool__(self) -> bool:
        return bool(self._acks)

    def add(self, ack: pb.PutAck | HeldAck) -> None:
        """Add an ack after the others. Wait for `room` before the first ack of a request."""
        self._acks.append(ack)
        self._note()

    async def room(self) -> None:
        """Wait while there are HELD_ACKS_MAX."""
        while len(self._acks) >= HELD_ACKS_MAX:
            await self._changed.wait()

    async def all_passed(self) -> None:
        """Wait until no ack is left."""
        while self._acks:
            await self._changed.wait()

    def close(self) -> None:
        """Stop waiting, and drop `pass_on`, which refers to the owner of this object. Idempotent."""
        self._task.cancel()
        self._pass_on = to_nobody

    async def _run(self) -> None:
        while True:  # until the stream ends
            while not self._acks:
                await self._changed.wait()
            due = [await _due(self._acks[0])]
            while len(due) < min(len(self._acks), PASSED_MAX) and _is_due(self._acks[len(due)]):
                due.append(await _due(self._acks[len(due)]))
            await self._pass_on(due)
            for _ in due:  # not earlier: `add` puts later acks behind these ones
                self._acks.popleft()
            self._note()

    def _note(self) -> None:
        changed, self._changed = self._changed, asyncio.Event()
        changed.set()


async def to_nobody(_: list[pb.PutAck]) -> None:
    """Write no acks: the stream has ended."""


def _is_due(ack: pb.PutAck | HeldAck) -> bool:
    return isinstance(ack, pb.PutAck) or ack.is_due


async def _due(ack: pb.PutAck | HeldAck) -> pb.PutAck:
    return ack if isinstance(ack, pb.PutAck) else await ack.due()
