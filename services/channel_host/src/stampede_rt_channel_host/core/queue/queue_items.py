"""The messages of a queue. Pure.

Fresh messages were never delivered. They are in the order of acceptance. Tracked messages were delivered at least
once. Sorted lists say which of these a taker may get, and which of these have no lease. Every operation costs amortised
O(log n).
"""

from __future__ import annotations

from collections import OrderedDict, deque
from collections.abc import Iterator
from dataclasses import dataclass, fields
from operator import attrgetter
from typing import Any

from sortedcontainers import SortedDict, SortedList

from stampede_rt_channel_host.core.deadlines import Deadlines
from stampede_rt_channel_host.core.queue.changes import QueueChanges
from stampede_rt_channel_host.core.queue.chunked_map import ChunkedMap
from stampede_rt_channel_host.core.queue.items import QueuedRun, TrackedItem
from stampede_rt_channel_host.core.queue.limits import ITEM_OVERHEAD_BYTES, QueueLimits


@dataclass(slots=True)
class QueueTally:
    """The numbers of messages and deliveries so far. `QueueCounters` explains the fields."""

    accepted: int = 0
    accepted_bytes: int = 0
    consumed: int = 0
    dropped: int = 0
    dead_lettered: int = 0
    expelled: int = 0
    delivered: int = 0
    given_back: int = 0
    leases_expired: int = 0
    terminated: int = 0
    duplicates: int = 0
    rejected_full: int = 0
    rejected_too_large: int = 0
    rejected_malformed: int = 0
    rejected_overloaded: int = 0

    def copied(self) -> QueueTally:
        """A copy with the present numbers."""
        return QueueTally(*_numbers(self))

    def after_put(self, length: int) -> QueueTally:
        """The tally after a queue has accepted one message of `length` payload bytes."""
        accepted, accepted_bytes, *rest = _numbers(self)
        return QueueTally(accepted + 1, accepted_bytes + length, *rest)


_numbers = attrgetter(*(one.name for one in fields(QueueTally)))  # `dataclasses.replace` takes five times as long


class QueueItems:
    """The held messages. Seqs start at 1. All tracked messages are older than all fresh messages.

    `tracked` maps seqs to tracked messages. `leased` counts messages with a lease. `stored_bytes` is the sum of the
    bodies of all runs with a held message. `leaving` has the messages that wait for their move to the dead-letter
    queue, by seq. `changes` collects the changes for replicas; None: there are no replicas.
    """

    def __init__(self, limits: QueueLimits) -> None:
        self.limits = limits
        self.tally = QueueTally()
        self.next_seq = 1
        self.items = self.payload_bytes = self.stored_bytes = 0
        self.fresh_items = self.leased = 0
        self.tracked: ChunkedMap[TrackedItem] = ChunkedMap()
        self.leaving: OrderedDict[int, TrackedItem] = OrderedDict()
        self.delays: Deadlines[TrackedItem] = Deadlines()  # the messages that the queue holds back
        self.changes: QueueChanges | None = None
        self.returns_logged = 0  # the number of the latest return; see `log_return`
        self._fresh: deque[QueuedRun] = deque()
        self._fresh_position = 0  # the position of the first fresh message in the first run of `_fresh`
        self._available: Any = SortedList()  # seqs of tracked messages that some taker may get
        self._unleased: Any = SortedList()  # seqs of tracked messages without a lease
        self._returns: Any = SortedDict()  # return number -> seq of an available message; empty if `copies` is 1

    def has_room(self, length: int) -> bool:
        """Whether the limits leave room for one more message of `length` payload bytes."""
        limits = self.limits
        if limits.max_items is not None and self.items >= limits.max_items:
            return False
        return self.payload_bytes + length + (self.items + 1) * ITEM_OVERHEAD_BYTES <= limits.max_bytes

    def add(self, run: QueuedRun, length: int) -> None:
        """Add a new message to a run. The run must be the latest one, and must have no body yet."""
        run.lengths.append(length)  # type: ignore[attr-defined]  # a list until `set_body`
        run.held += 1
        if not self._fresh or self._fresh[-1] is not run:
            if not self._fresh:
                self._fresh_position = len(run.lengths) - 1  # older messages of the run were dropped to make room
            self._fresh.append(run)
        self._count_in(length)

    def _count_in(self, length: int) -> None:
        """Count a new message."""
        self.next_seq += 1
        self.items += 1
        self.fresh_items += 1
        self.payload_bytes += length
        self.tally.accepted += 1
        self.tally.accepted_bytes += length

    def put_back(self, run: QueuedRun, position: int, *, is_fresh: bool) -> None:
        """Enter a message that another host held. The caller enters messages in the order of their seqs.

        This order puts all tracked messages before all fresh messages.
        """
        if not run.held:
            self.stored_bytes += len(run.body)
        run.held += 1
        self.items += 1
        self.payload_bytes += run.lengths[position]
        if not is_fresh:
            item = TrackedItem(run, position)
            self.tracked[item.seq] = item
            return
        self.fresh_items += 1
        if not self._fresh:
            self._fresh_position = position
        if not self._fresh or self._fresh[-1] is not run:
            self._fresh.append(run)

    def set_body(self, run: QueuedRun, body: bytes) -> None:
        """Store the run's body: the run gets no more messages."""
        run.lengths = tuple(run.lengths)
        run.body = body
        if run.held:
            self.stored_bytes += len(body)
        if self.changes is not None:
            self.changes.runs.append(run)

    def drop_oldest(self) -> bool:
        """Remove the oldest message without a lease. Returns False if there is none."""
        if self._unleased:
            self.remove(self.tracked[self._unleased[0]])
        elif (run := self.fresh_run()) is not None:
            length = run.lengths[self._fresh_position]
            self._fresh_position += 1
            self.fresh_items -= 1
            self._release(run, length)
            if self.changes is not None:
                self.changes.remove(run.first_seq + self._fresh_position - 1)
        else:
            return False
        self.tally.dropped += 1
        return True

    def fresh_run(self) -> QueuedRun | None:
        """The run of the first fresh message, or None if there is no fresh message."""
        while self._fresh and self._fresh_position >= len(self._fresh[0].lengths):
            self._fresh.popleft()
            self._fresh_position = 0
        return self._fresh[0] if self._fresh else None

    @property
    def fresh_position(self) -> int:
        """The position of the first fresh message in `fresh_run()`."""
        return self._fresh_position

    def track_fresh(self) -> TrackedItem:
        """Turn the first fresh message into a tracked message, for its first delivery.

        There must be a fresh message.
        """
        run = self.fresh_run()
        assert run is not None, "the caller has checked that there is a fresh message"
        item = TrackedItem(run, self._fresh_position)
        self._fresh_position += 1
        self.fresh_items -= 1
        self.tracked[item.seq] = item
        self.note_change(item)
        return item

    def note_change(self, item: TrackedItem, delivery_id: int | None = None) -> None:
        """Note that a tracked message has changed. `delivery_id`: the lease of this delivery has changed, too."""
        if self.changes is not None:
            self.changes.note(item, delivery_id)

    def fresh_runs(self) -> tuple[list[QueuedRun], int]:
        """The runs with fresh messages, and the position of the first fresh message in the first run."""
        self.fresh_run()  # drops a first run without a fresh message
        return [*self._fresh], self._fresh_position

    @property
    def available_items(self) -> int:
        """The number of messages that some taker may get."""
        return self.fresh_items + len(self._available)

    def first_available(self, from_seq: int = 0) -> TrackedItem | None:
        """The oldest tracked message from `from_seq` on that some taker may get, or None if there is none."""
        if not self._available:
            return None
        for seq in self._available.irange(minimum=from_seq):
            return self.tracked[seq]
        return None

    def returned_since(self, number: int) -> Iterator[TrackedItem]:
        """The available messages whose return has a higher number than `number`, in the order of their returns."""
        for later in self._returns.irange(minimum=number, inclusive=(False, True)):
            yield self.tracked[self._returns[later]]

    @property
    def latest_return(self) -> int:
        """The number of the latest return of a message that is still available, or 0 if there is none."""
        return self._returns.peekitem(-1)[0] if self._returns else 0

    def log_return(self, item: TrackedItem) -> None:
        """Note that a copy came back, so that takers whose cursor is after the message look at it again."""
        if self.limits.copies > 1 and item.is_available:
            self._returns.pop(item.return_number, None)
            self.returns_logged += 1
            item.return_number = self.returns_logged
            self._returns[self.returns_logged] = item.seq

    def refresh(self, item: TrackedItem) -> None:
        """Update the sorted lists after a change of the message."""
        self.note_change(item)
        available = not item.is_leaving and item.due is None and item.free_copies(self.limits.copies) > 0
        unleased = not item.is_leaving and not item.leases
        if available != item.is_available:
            item.is_available = available
            (self._available.add if available else self._available.remove)(item.seq)
            if not available:
                self._returns.pop(item.return_number, None)
        if unleased != item.is_unleased:
            item.is_unleased = unleased
            (self._unleased.add if unleased else self._unleased.remove)(item.seq)

    def set_leaving(self, item: TrackedItem) -> None:
        """Mark a message as one that waits for its move to the dead-letter queue. No taker gets it any more."""
        item.is_leaving = True
        self.delays.disarm(item)
        self.leaving[item.seq] = item
        self.refresh(item)

    def remove(self, item: TrackedItem) -> None:
        """Remove a message, which must have no lease."""
        assert not item.leases, "a leased message cannot be removed"
        del self.tracked[item.seq]
        self.leaving.pop(item.seq, None)
        self.delays.disarm(item)
        if item.is_available:
            self._available.remove(item.seq)
            self._returns.pop(item.return_number, None)
        if item.is_unleased:
            self._unleased.remove(item.seq)
        self._release(item.run, item.length)
        if self.changes is not None:
            self.changes.remove(item.seq)

    def _release(self, run: QueuedRun, length: int) -> None:
        """Subtract a message that leaves the queue from all sums."""
        self.items -= 1
        self.payload_bytes -= length
        run.held -= 1
        if not run.held:
            self.stored_bytes -= len(run.body)

    @property
    def oldest_accepted_at(self) -> int | None:
        """The time at which the oldest held message was accepted, or None if no message is held."""
        if self.tracked:
            return next(self.tracked.values()).run.accepted_at
        run = self.fresh_run()
        return None if run is None else run.accepted_at
