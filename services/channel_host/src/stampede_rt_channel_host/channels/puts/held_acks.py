"""The acks of puts that wait for replicas, or for stable storage. The acks of a stream stay in order."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Coroutine
from functools import partial
from typing import Any, Protocol

from stampede_rt.errors import NotArchived, NotReplicated, Unavailable
from stampede_rt.status import to_error_message
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt_channel_host.channels.owned_replicas import OwnedReplicas
from stampede_rt_channel_host.channels.puts.acks import refused
from stampede_rt_channel_host.channels.recording import Recording

HELD_ACKS_MAX = 1024  # the most held acks of one stream; at this number the host stops reading its requests
WAIT_NANOS_DEFAULT = 5_000_000_000  # for a put that states no wait


Spawn = Callable[[Coroutine[Any, Any, None]], asyncio.Task[None]]
Look = Callable[[bool], None]
"""Checks whether an ack is due. The argument says whether it may write the ack in this turn of the event loop."""


class HeldAck(Protocol):
    """An ack that may not be due yet."""

    @property
    def is_due(self) -> bool:
        """Whether `take` may be called."""

    def take(self) -> pb.PutAck:
        """Return the ack. Call this once, when the ack is due."""

    def watch(self, look: Look, spawn: Spawn) -> Callable[[], object]:
        """Call `look` whenever the ack may have become due. Returns a function that stops these calls.

        `spawn` makes a task that ends with the stream.
        """

    async def due(self) -> pb.PutAck:
        """Wait until the ack is due, and return it. Call this instead of `watch` and `take`."""


class AckOfDisk:
    """An ack that is due as soon as the archive has its items on stable storage."""

    def __init__(self, ack: pb.PutAck, channel: str, recording: Recording, wait_nanos: int | None) -> None:
        """`wait_nanos`: the longest wait; None: without a limit."""
        self._ack = ack
        self._channel = channel
        self._recording = recording
        self._ends_s = _ends_s(wait_nanos)
        self._due: pb.PutAck | None = None
        recording.hurry()

    @property
    def is_due(self) -> bool:
        """See `HeldAck`."""
        return self._due is not None

    def take(self) -> pb.PutAck:
        """See `HeldAck`."""
        assert self._due is not None, "the ack is due"
        return self._due

    def watch(self, look: Look, spawn: Spawn) -> Callable[[], object]:
        """See `HeldAck`."""
        return spawn(self._wait(look)).cancel

    async def _wait(self, look: Look) -> None:
        self._due = await self.due()
        look(True)

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
    """The seq after the last accepted item of an ack."""
    last = ack.later_parts[-1] if ack.later_parts else pb.PutPart(index=0, first_seq=ack.first_seq)
    refused_behind = sum(one.index >= last.index for one in ack.rejections)
    return last.first_seq + ack.items - last.index - refused_behind


def not_archived(channel: str, why: str, first_seq: int | None = None) -> NotArchived:
    """The error of a put that waits for stable storage. `first_seq`: the channel has accepted its items."""
    metadata = {"channel": channel} if first_seq is None else {"channel": channel, "seq": str(first_seq)}
    taken = "has not accepted" if first_seq is None else "has accepted"
    return NotArchived(
        f"channel {channel} {taken} the put, and its archive could not take the items ({why}); look at `stampede "
        'doctor`, and put again. If memory is enough, put with ack="host"',
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
        self._is_late = False  # the longest wait is over

    @property
    def is_due(self) -> bool:
        """See `HeldAck`."""
        return self._is_late or self._is_replicated() or self._period.ended is not None

    def take(self) -> pb.PutAck:
        """See `HeldAck`. After the longest wait the ack has the error NOT_REPLICATED."""
        ack, replication = self._ack, self._replication
        ack.copies = replication.copies(self._next_place)
        if self._is_replicated():
            return ack
        if (ended := self._period.ended) is not None:
            return refused(ack.first_number, ack.items, ended, ack.host_time_unix_nano, ack.incarnation)
        replication.not_replicated += ack.items - len(ack.rejections)
        ack.error.CopyFrom(to_error_message(self._explain(ack)))
        return ack

    def watch(self, look: Look, _spawn: Spawn) -> Callable[[], object]:
        """See `HeldAck`."""
        timer = None
        if self._ends_s is not None:
            timer = asyncio.get_running_loop().call_at(self._ends_s, self._note_late, look)
        self._replication.watch(look)
        return partial(self._unwatch, look, timer)

    def _unwatch(self, look: Look, timer: asyncio.TimerHandle | None) -> None:
        self._replication.unwatch(look)
        if timer is not None:
            timer.cancel()

    def _note_late(self, look: Look) -> None:
        self._is_late = True  # `is_due` cannot compare clocks, because a timer may be early by a part of a millisecond
        look(True)

    async def due(self) -> pb.PutAck:
        """Wait until the ack is due, and take it."""
        if not self._is_replicated():
            left_s = _left_s(self._ends_s)
            await self._replication.wait_until(self._is_replicated, left_s, self._period)
        return self.take()


class HeldAcks:
    """The acks of one stream from the first one on that is not due, in order."""

    def __init__(self, on_due: Look, spawn: Spawn) -> None:
        """`on_due` is called when the first ack becomes due, and must not wait. `spawn`: see `HeldAck.watch`."""
        self._on_due = on_due
        self._spawn = spawn
        self._acks: deque[pb.PutAck | HeldAck] = deque()
        self._unwatch: Callable[[], object] | None = None  # while the first ack is watched

    def __len__(self) -> int:
        return len(self._acks)

    @property
    def is_due(self) -> bool:
        """Whether the first ack is due."""
        return bool(self._acks) and _is_due(self._acks[0])

    def add(self, ack: pb.PutAck | HeldAck) -> None:
        """Add an ack after the others."""
        self._acks.append(ack)
        if len(self._acks) == 1:
            self._watch_first()

    def take(self, acks_max: int) -> list[pb.PutAck]:
        """Take the first acks that are due, `acks_max` at most."""
        taken: list[pb.PutAck] = []
        while len(taken) < acks_max and self.is_due:
            ack = self._acks.popleft()
            taken.append(ack if isinstance(ack, pb.PutAck) else ack.take())
        if taken:
            self._watch_first()
        return taken

    def close(self) -> None:
        """Stop waiting, and drop `on_due`, which refers to the owner of this object. Idempotent."""
        self._stop_watch()
        self._on_due = _ignore

    def _watch_first(self) -> None:
        self._stop_watch()
        first = self._acks[0] if self._acks else None
        if first is None or isinstance(first, pb.PutAck) or first.is_due:
            return
        self._unwatch = first.watch(self._look, self._spawn)

    def _stop_watch(self) -> None:
        if self._unwatch is not None:
            self._unwatch()
            self._unwatch = None

    def _look(self, in_this_turn: bool) -> None:
        if self.is_due:
            self._on_due(in_this_turn)


def _ignore(_: bool) -> None:
    """Write no acks: the stream has ended."""


def _is_due(ack: pb.PutAck | HeldAck) -> bool:
    return isinstance(ack, pb.PutAck) or ack.is_due
