"""The clock of a queue, and its due work: ended leases, delays and waits, and checks after a change of the limits.

Each call does a bounded part. Pure.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import islice

from stampede_rt_channel_host.core.queue.dispatcher import Dispatcher
from stampede_rt_channel_host.core.queue.enqueue_line import EnqueueLine
from stampede_rt_channel_host.core.queue.items import TrackedItem
from stampede_rt_channel_host.core.queue.queue_items import QueueItems
from stampede_rt_channel_host.core.queue.queue_leases import QueueLeases

CHECKED_PER_CALL_MAX = 256
"""The most messages that one call checks again after the limits have changed, and the most leases that it notes."""
DUE_PER_CALL_MAX = 256
"""The most ended leases, delays and waits that one call handles. If more are due, `next_deadline` says so."""


class DueWork:
    """The due work of one queue. `tick` advances the queue's clock; each call of the queue begins with it."""

    def __init__(
        self,
        queue_items: QueueItems,
        queue_leases: QueueLeases,
        enqueue_line: EnqueueLine,
        dispatcher: Dispatcher,
        may_serve: Callable[[], bool],
    ) -> None:
        self._queue_items = queue_items
        self._queue_leases = queue_leases
        self._enqueue_line = enqueue_line
        self._dispatcher = dispatcher
        self._may_serve = may_serve
        self._clock: int | None = None
        self._is_paused = False
        self._unchecked_from: int | None = None  # the next seq for `_check_some`; None: all messages are checked

    def tick(self, now: int) -> int:
        """Advance the queue's clock, and do a bounded part of the due work. Returns the clock."""
        clock = self._clock = now if self._clock is None else max(self._clock, now)
        self._dispatcher.begin_call()
        due = self._check_some()
        while due < DUE_PER_CALL_MAX and (self._queue_leases.expire_one(clock) or self._end_delay(clock)):
            due += 1
        self._queue_leases.note_some(CHECKED_PER_CALL_MAX)
        for taker in self._queue_leases.silent:
            self._dispatcher.leave(taker)
        while due < DUE_PER_CALL_MAX and self._enqueue_line.give_up_one(clock):
            due += 1
        if due or self._has_more:
            self.follow_up(clock)
        while due < DUE_PER_CALL_MAX and self._enqueue_line.message_ids.forget_one(clock):
            due += 1
        return clock

    def follow_up(self, clock: int) -> None:
        """Serve the waiting runs and the waiting takers, because messages left the queue or came back."""
        if self._may_serve():
            self._enqueue_line.offer_line(clock)
        self._dispatcher.dispatch(clock)

    def pause(self) -> None:
        """Give takers no messages until `resume`."""
        self._is_paused = self._dispatcher.is_paused = True

    def resume(self, clock: int) -> None:
        """End a pause, and serve the waiting runs and takers again."""
        self._is_paused = False
        self._check_some()
        self.follow_up(clock)

    def check_all(self) -> None:
        """Check all tracked messages against the limits: some of them now, and some more at each `tick`.

        Until all are checked, takers get no messages.
        """
        self._unchecked_from = 0
        self._check_some()

    def next_deadline(self) -> int | None:
        """The time at which `tick` next has work, or None if it has none until another call changes the queue."""
        if self._unchecked_from is not None or self._has_more or self._queue_leases.has_unnoted:
            return self._clock
        known = self._enqueue_line.message_ids.next_deadline()
        due = (
            self._queue_leases.next_deadline(),
            self._queue_items.delays.next(),
            self._enqueue_line.next_deadline(),
            known,
        )
        return min((one for one in due if one is not None), default=None)

    @property
    def _has_more(self) -> bool:
        """Whether takers or runs wait in line only because a call has reached the limit of its work."""
        return self._dispatcher.has_more or self._enqueue_line.has_more

    def _check_some(self) -> int:
        """Check some tracked messages against the limits, if not all are checked. Returns their number."""
        items: list[TrackedItem] = []
        if self._unchecked_from is not None:
            items = [*islice(self._queue_items.tracked.values(self._unchecked_from), CHECKED_PER_CALL_MAX)]
            self._unchecked_from = items[-1].seq + 1 if len(items) == CHECKED_PER_CALL_MAX else None
        for item in items:
            self._queue_leases.check_again(item)
        self._dispatcher.is_paused = self._is_paused or self._unchecked_from is not None or not self._may_serve()
        return len(items)

    def _end_delay(self, clock: int) -> bool:
        """Make a message available whose delay is over. Returns False if there is no such message."""
        item = self._queue_items.delays.pop(clock)
        if item is None:
            return False
        self._queue_items.refresh(item)
        self._queue_items.log_return(item)
        return True
