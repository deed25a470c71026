"""The dispatcher of a queue. It serves waiting takers in turn, each with an equal share of the messages. Pure."""

from __future__ import annotations

from collections import OrderedDict
from heapq import heappop, heappush
from itertools import islice

from stampede_rt_channel_host.core.queue.items import QueuedRun, TrackedItem
from stampede_rt_channel_host.core.queue.queue_items import QueueItems
from stampede_rt_channel_host.core.queue.queue_leases import QueueLeases
from stampede_rt_channel_host.core.queue.takers import TakerState
from stampede_rt_channel_host.core.queue.values import Batch, LeasedSlice

BATCH_BYTES_MAX = 2**20 - 2**16
"""The most bytes that the messages of a batch take on the wire, unless it has only one message.

With its other fields the batch fits in 1 MiB.
"""
ITEMS_DISPATCHED_MAX = 128
"""The most messages that one call of the queue gives to takers, in one batch or in several.

After such a call the host serves other callers.
"""
DELIVERY_BYTES = 16
"""The most bytes that a message's delivery id and number take on the wire."""
TAKER_CURSORS_MAX = 4096
"""The most cursors that a queue keeps. If it has forgotten the cursor of a taker, that taker's cursor begins anew."""
RETURNS_PER_LOOK_MAX = 1024
"""The most returned messages at which a cursor looks in one step."""


class TakerCursor:
    """The position of one taker in a queue with copies, which gives each message only to some of its takers.

    The taker got no message with `next_seq` or a later seq. `passed` is a heap with the seqs of earlier messages that
    came back and that this taker may get. `returns_seen` is the number of the last return that this object knows.
    """

    __slots__ = ("next_seq", "passed", "returns_seen")

    def __init__(self, returns_seen: int) -> None:
        self.next_seq = 0
        self.returns_seen = returns_seen
        self.passed: list[int] = []

    def next_for(self, taker_id: int, queue_items: QueueItems) -> TrackedItem | None:
        """The oldest tracked message that the taker may get, or None if there is none.

        If more than RETURNS_PER_LOOK_MAX messages have just come back, the result may be a later one of these.
        """
        while True:  # each round looks at other messages that came back
            is_behind = self._look_at_returns(taker_id, queue_items)
            while self.passed:
                passed = queue_items.tracked.get(self.passed[0])
                if passed is not None and passed.is_available and passed.may_go_to(taker_id):
                    return passed
                heappop(self.passed)
            if not is_behind:
                break
        while (ahead := queue_items.first_available(self.next_seq)) is not None and not ahead.may_go_to(taker_id):
            self.next_seq = ahead.seq + 1  # happens only if the queue had forgotten the cursor
        return ahead

    def _look_at_returns(self, taker_id: int, queue_items: QueueItems) -> bool:
        """Look at some of the messages that came back, each once. Returns True if more are left."""
        for item in islice(queue_items.returned_since(self.returns_seen), RETURNS_PER_LOOK_MAX):
            self.returns_seen = item.return_number
            if item.seq < self.next_seq and item.may_go_to(taker_id):
                heappush(self.passed, item.seq)
        is_behind = queue_items.latest_return > self.returns_seen
        if not is_behind:
            self.returns_seen = queue_items.returns_logged
        return is_behind


class _Draft:
    """A batch to which the dispatcher still adds messages."""

    def __init__(self) -> None:
        self.slices: list[LeasedSlice] = []
        self.items = 0
        self._bytes = 0

    def has_room(self, run: QueuedRun, position: int) -> bool:
        """Whether the batch has room for one more message. It always has room for the first message."""
        return not self.items or self._bytes + self._cost(run, position) <= BATCH_BYTES_MAX

    def add(self, run: QueuedRun, position: int, delivery: tuple[int, int]) -> None:
        """Append the message with its delivery id and number."""
        self._bytes += self._cost(run, position)
        self.items += 1
        if self._continues(run, position):
            last = self.slices[-1]
            last.delivery_ids.append(delivery[0])  # type: ignore[attr-defined]  # slices of a draft have lists
            last.deliveries.append(delivery[1])  # type: ignore[attr-defined]
            self.slices[-1] = last._replace(hi=position + 1)
        else:
            self.slices.append(LeasedSlice(run, position, position + 1, [delivery[0]], [delivery[1]]))

    def _continues(self, run: QueuedRun, position: int) -> bool:
        """Whether the message directly follows the last message of the batch in the same run."""
        return bool(self.slices) and self.slices[-1].run is run and self.slices[-1].hi == position

    def _cost(self, run: QueuedRun, position: int) -> int:
        """The bytes on the wire by which the message makes the batch larger."""
        label = 0 if self._continues(run, position) else run.label_bytes
        return label + run.lengths[position] + DELIVERY_BYTES


class Dispatcher:
    """The line of waiting takers. `batches` collects the new batches until the caller takes them.

    While the dispatcher `is_paused`, no taker gets messages: all takers wait in line. `has_more`: a call of the queue
    has reached its limit, so call `dispatch` again without a wait for a change.
    """

    def __init__(self, queue_items: QueueItems, queue_leases: QueueLeases) -> None:
        self._queue_items = queue_items
        self._queue_leases = queue_leases
        self._line: OrderedDict[TakerState, None] = OrderedDict()
        # Taker id -> cursor, the least recently used first.
        self._cursors: OrderedDict[int, TakerCursor] = OrderedDict()
        self.batches: list[tuple[TakerState, Batch]] = []
        self.is_paused = self.has_more = False
        self._messages_left = ITEMS_DISPATCHED_MAX  # that this call of the queue may still give to takers

    def __len__(self) -> int:
        """The number of waiting takers."""
        return len(self._line)

    def wait(self, taker: TakerState, now: int) -> None:
        """Give the taker messages if the queue has some for it; otherwise put the taker in line.

        Does nothing if the taker has no credit, or is busy or silent. The takers in line need no messages now, because
        the queue has already tried to serve them.
        """
        waits = taker.credit and not taker.is_busy and not taker.is_silent and taker not in self._line
        if waits and (self.is_paused or self.has_more or not self._serve(taker, 1, now)):
            self._line[taker] = None

    def begin_call(self) -> None:
        """Begin a call of the queue, which may give ITEMS_DISPATCHED_MAX messages to takers."""
        self._messages_left = ITEMS_DISPATCHED_MAX

    def leave(self, taker: TakerState) -> None:
        """Take a taker out of the line. Idempotent."""
        self._line.pop(taker, None)

    def dispatch(self, now: int) -> None:
        """Serve the takers in line, because there may be new messages."""
        served = []
        self.has_more = False
        for position, taker in enumerate(self._line):
            if self.is_paused or not self._queue_items.available_items:
                break
            if self._serve(taker, len(self._line) - position, now):
                served.append(taker)
            elif self.has_more:
                break
        for taker in served:
            del self._line[taker]

    def _serve(self, taker: TakerState, takers: int, now: int) -> bool:
        """Give a taker its share of the messages, as one of `takers` takers. Returns False if it gets nothing."""
        there = self._queue_items.available_items * self._queue_items.limits.copies
        share = min(-(-there // takers), taker.credit, ITEMS_DISPATCHED_MAX)
        if share > self._messages_left:  # the taker waits for the next call, so that it gets its whole share
            self.has_more = True
            return False
        lease_nanos = taker.lease_nanos or self._queue_items.limits.lease_nanos
        draft = _Draft()
        while draft.items < share and self._give_next(taker, draft, now, now + lease_nanos):
            pass
        if not draft.items:
            return False
        self._messages_left -= draft.items
        taker.credit -= draft.items
        taker.is_busy = True
        taker.unsent = Batch(draft.slices, now + lease_nanos)
        self.batches.append((taker, taker.unsent))
        return True

    def _give_next(self, taker: TakerState, draft: _Draft, now: int, expires: int) -> bool:
        """Add the next message for the taker to the batch, and lease it. Returns False if no message fits."""
        queue_items = self._queue_items
        cursor = self._cursor_of(taker.taker_id) if queue_items.limits.copies > 1 else None
        item = cursor.next_for(taker.taker_id, queue_items) if cursor else queue_items.first_available()
        if item is None:
            run = queue_items.fresh_run()
            if run is None or not draft.has_room(run, queue_items.fresh_position):
                return False
            item = queue_items.track_fresh()
        elif not draft.has_room(item.run, item.position):
            return False
        if cursor is not None:
            cursor.next_seq = max(cursor.next_seq, item.seq + 1)
        draft.add(item.run, item.position, self._queue_leases.deliver(item, taker, now, expires))
        return True

    def _cursor_of(self, taker_id: int) -> TakerCursor:
        """The cursor of a taker. Makes it if needed. Above TAKER_CURSORS_MAX forgets the least recently used cursor."""
        cursor = self._cursors.get(taker_id)
        if cursor is None:
            cursor = self._cursors[taker_id] = TakerCursor(self._queue_items.returns_logged)
        self._cursors.move_to_end(taker_id)
        if len(self._cursors) > TAKER_CURSORS_MAX:
            self._cursors.popitem(last=False)
        return cursor
