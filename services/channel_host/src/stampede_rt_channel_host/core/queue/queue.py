"""One queue: enqueues, takers, leases and limits over values and `now` (paper, section 3.5). Pure."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from itertools import islice
from typing import Any

from stampede_rt.errors import StampedeError
from stampede_rt_channel_host.core.channel.pieces import Pieces
from stampede_rt_channel_host.core.queue import handoff
from stampede_rt_channel_host.core.queue.dispatcher import Dispatcher
from stampede_rt_channel_host.core.queue.due_work import DueWork
from stampede_rt_channel_host.core.queue.enqueue import Enqueue
from stampede_rt_channel_host.core.queue.enqueue_line import EnqueueLine
from stampede_rt_channel_host.core.queue.handoff import QueueHandoff
from stampede_rt_channel_host.core.queue.journal import QueueJournal
from stampede_rt_channel_host.core.queue.limits import QueueLimits
from stampede_rt_channel_host.core.queue.queue_items import QueueItems
from stampede_rt_channel_host.core.queue.queue_leases import QueueLeases
from stampede_rt_channel_host.core.queue.queue_snapshot import export
from stampede_rt_channel_host.core.queue.takers import TakerState
from stampede_rt_channel_host.core.queue.values import (
    Batch,
    DeadLetter,
    PendingDelivery,
    QueueCounters,
    Settlement,
    SettlementResult,
)

EMPTIED_PER_PIECE = 256  # the most messages that one piece of `emptying` removes
ENDED_PER_CALL_MAX = 128  # the most waiting runs that one call of `refuse_waiting` refuses


class QueueCore:
    """The messages of one queue, in memory. Not thread-safe. Each call is atomic and never waits.

    The caller is the shell of queues. It passes `now`, the host's clock, to the calls. A `now` before the latest one
    counts as the latest. After each call the caller takes the results: `take_batches` gives batches for takers, and
    `take_finished` the runs that waited and are done. The caller calls `tick` at `next_deadline`.

    Each incarnation gets a `first_delivery_id` far from the ids of earlier incarnations. A taker may still name a
    delivery of an earlier incarnation. The queue never mistakes such a delivery for one of its own.
    """

    def __init__(
        self,
        limits: QueueLimits,
        *,
        incarnation: int,
        name: str = "",
        first_delivery_id: int = 1,
        may_serve: Callable[[], bool] = lambda: True,
    ) -> None:
        """While `may_serve` returns False, the queue gives takers no messages, and accepts no waiting run."""
        self.incarnation = incarnation
        self._name = f"queue {name!r}" if name else "the queue"
        self._queue_items = QueueItems(limits)
        self._queue_leases = QueueLeases(self._queue_items, self._name, first_delivery_id)
        self._enqueue_line = EnqueueLine(self._queue_items, self._name)
        self._dispatcher = Dispatcher(self._queue_items, self._queue_leases)
        self._due_work = DueWork(self._queue_items, self._queue_leases, self._enqueue_line, self._dispatcher, may_serve)

    def export(self, now: int, chunks_max: int | None = None) -> QueueHandoff:
        """The whole queue as values, without waiting runs and takers.

        For a move, the caller first calls `withdraw` for all waiting runs and `leave` for all takers. `chunks_max`: see
        `AcknowledgedDeliveries.latest`.
        """
        clock = self._due_work.tick(now)
        return export(self._queue_items, self._queue_leases, self._enqueue_line, clock, chunks_max)

    @classmethod
    def restore(
        cls,
        limits: QueueLimits,
        state: QueueHandoff,
        now: int,
        *,
        incarnation: int,
        name: str = "",
        may_serve: Callable[[], bool] = lambda: True,
    ) -> QueueCore:
        """The queue that another host exported, with its seqs, leases and counters.

        The time of this call grows with the number of messages.
        """
        queue = cls.restored(limits, state, now, incarnation=incarnation, name=name, may_serve=may_serve)
        queue._due_work.check_all()  # the other host may have known other limits
        queue._due_work.tick(now)
        return queue

    @classmethod
    def restored(cls, limits: QueueLimits, state: QueueHandoff, now: int, **about: Any) -> QueueCore:
        """Like `restore`, but for a copy: the queue does no work that is due, because its owner does it."""
        queue = cls(limits, **about)
        handoff.restore(state, queue._queue_items, queue._queue_leases, queue._enqueue_line, now)
        return queue

    def journal(self, next_step: int = 1) -> QueueJournal:
        """A journal of all changes of the queue from now on. The first step gets the number `next_step`."""
        return QueueJournal(self._queue_items, self._queue_leases, self._enqueue_line, next_step)

    def recall(self, taker: TakerState, now: int) -> None:
        """Take back the taker's batch, which the host has not begun to send. The taker waits again."""
        clock = self._due_work.tick(now)
        if taker.unsent is not None:
            self._queue_leases.recall(taker.unsent.slices)
            taker.credit += taker.unsent.items
            taker.unsent, taker.is_busy = None, False
            self._dispatcher.wait(taker, clock)

    def postpone(self, nanos: int) -> None:
        """Let all leases last longer, because no host has served the queue for `nanos`."""
        self._queue_leases.postpone(nanos)

    def enqueue(self, run: Enqueue, now: int) -> None:
        """Judge a run. When this method returns, the run is done, or it waits and `take_finished` returns it later.

        A run that its producer put before gets the same outcome again. A run whose message id is known gets the seq of
        the first message with that id. Raises InvalidArgument if the run's numbers overlap another run's numbers, and
        Overloaded if too many runs wait.
        """
        clock = self._due_work.tick(now)
        self._enqueue_line.enqueue(run, clock)
        self._dispatcher.dispatch(clock)

    def withdraw(self, run: Enqueue, now: int) -> None:
        """Take a run out of the line, because its producer does not wait for it any more. Idempotent."""
        clock = self._due_work.tick(now)
        self._enqueue_line.withdraw(run, clock)
        self._due_work.follow_up(clock)

    def refuse(self, run: Enqueue, error: StampedeError, now: int) -> None:
        """Take a run out of the line, and refuse its unjudged messages because of `error`. Idempotent."""
        clock = self._due_work.tick(now)
        self._enqueue_line.refuse(run, error, clock)
        self._due_work.follow_up(clock)

    def pause(self) -> None:
        """Give takers no messages until `resume`, because the host does not serve the queue at present."""
        self._due_work.pause()

    def refuse_waiting(self, error: StampedeError, now: int) -> bool:
        """Refuse some of the waiting runs with `error`, because the host does not serve the queue any more.

        Returns True if more runs wait: then call this method again. While runs wait, the queue refuses new runs, too.
        """
        return self._enqueue_line.refuse_waiting(error, self._due_work.tick(now), ENDED_PER_CALL_MAX)

    def resume(self, now: int) -> None:
        """Serve takers and waiting runs again, after `pause` or `refuse_waiting`."""
        clock = self._due_work.tick(now)
        self._due_work.resume(clock)

    def reject_malformed(self) -> None:
        """Count a run that the caller could not decode."""
        self._queue_items.tally.rejected_malformed += 1

    def reject_overloaded(self, items: int) -> None:
        """Count messages that were refused because a limit of the host or of the queue's waiting line is reached."""
        self._queue_items.tally.rejected_overloaded += items

    def reject_too_large(self) -> None:
        """Count a message that the caller refused, because it is larger than any queue can hold."""
        self._queue_items.tally.rejected_too_large += 1

    def grant(self, taker: TakerState, credit: int, now: int) -> None:
        """Add `credit` to the taker's credit. A credit of 0 is only a sign of life.

        From now on the taker does not count as silent.
        """
        clock = self._due_work.tick(now)
        taker.credit += credit
        taker.last_request_at, taker.is_silent = clock, False
        self._dispatcher.wait(taker, clock)

    def sending(self, taker: TakerState) -> None:
        """Note that the host begins to send the taker's latest batch. From now on the batch counts as delivered."""
        taker.unsent = None

    def note_sent(self, taker: TakerState, now: int) -> None:
        """Note that the host has sent the taker's latest batch. The taker waits for more messages if it has credit."""
        clock = self._due_work.tick(now)
        taker.unsent, taker.is_busy = None, False
        self._dispatcher.wait(taker, clock)

    def drain(self, taker: TakerState) -> None:
        """Cancel the taker's credit, because the taker wants no more messages."""
        taker.credit = 0
        self._dispatcher.leave(taker)

    def leave(self, taker: TakerState, now: int) -> None:
        """Remove a taker whose stream has ended. Idempotent.

        The queue takes back the messages of a batch that the host has not begun to send. Messages that the host has
        sent stay leased.
        """
        clock = self._due_work.tick(now)
        self.drain(taker)
        self._dispatcher.batches = [one for one in self._dispatcher.batches if one[0] is not taker]
        self._queue_leases.silent = [silent for silent in self._queue_leases.silent if silent is not taker]
        if taker.unsent is not None:
            self._queue_leases.recall(taker.unsent.slices)
            taker.unsent = None
        self._due_work.follow_up(clock)

    def settle(self, taker_id: int, settlements: Iterable[Settlement], now: int) -> list[SettlementResult]:
        """Perform the taker's settlements, in order. Returns one result for each settlement."""
        clock = self._due_work.tick(now)
        results = [self._queue_leases.settle(taker_id, settlement, clock) for settlement in settlements]
        self._due_work.follow_up(clock)
        return results

    def pending(self, after_delivery_id: int, limit: int, now: int) -> list[PendingDelivery]:
        """At most `limit` leased deliveries after `after_delivery_id`, with their takers, in the order of their ids."""
        self._due_work.tick(now)
        return self._queue_leases.pending(after_delivery_id, limit)

    def dead_letters(self, items_max: int) -> list[DeadLetter]:
        """At most `items_max` messages that wait for their move to the dead-letter queue.

        The message that has waited longest comes first.
        """
        leaving = islice(self._queue_items.leaving.values(), items_max)
        return [DeadLetter(item.seq, item.run, item.position, item.last) for item in leaving]

    def dead_letter_moved(self, seq: int, now: int) -> None:
        """Remove a message, because the dead-letter queue has accepted it. Idempotent."""
        clock = self._due_work.tick(now)
        item = self._queue_items.leaving.get(seq)
        if item is not None:
            self._queue_items.tally.dead_lettered += 1
            self._queue_items.remove(item)
            self._due_work.follow_up(clock)

    def postpone_dead_letter(self, seq: int) -> None:
        """Put a message behind the others that wait for their move, because its move failed."""
        if seq in self._queue_items.leaving:
            self._queue_items.leaving.move_to_end(seq)

    def configure(self, limits: QueueLimits, now: int) -> None:
        """Set other limits. Held messages stay, even if they need more room than the new limits allow.

        The queue checks all tracked messages against the new limits, a bounded number in one call. Until all are
        checked, it gives takers no messages.
        """
        clock = self._due_work.tick(now)
        self._queue_items.limits = limits
        self._due_work.check_all()
        self._due_work.follow_up(clock)

    def emptying(self) -> Pieces[None]:
        """Remove all messages, in pieces. The caller must not use the queue between the pieces or afterwards."""
        while self._queue_items.items:
            for item in [*islice(self._queue_items.tracked.values(), EMPTIED_PER_PIECE)]:
                self._queue_leases.expel(item)
            yield
            for _ in range(EMPTIED_PER_PIECE):
                self._queue_items.drop_oldest()
            yield
        yield from self._queue_leases.emptying()
        yield from self._queue_items.delays.emptying()

    def tick(self, now: int) -> None:
        """Handle ended leases, ended delays of messages, and ended waits of runs."""
        self._due_work.tick(now)

    def next_deadline(self) -> int | None:
        """The time at which `tick` next has work, or None if it has none until another call changes the queue."""
        return self._due_work.next_deadline()

    def expire(self, now: int) -> None:
        """Forget producers that have put nothing for ten minutes."""
        self._enqueue_line.retries.expire(now)

    def next_expiry(self) -> int | None:
        """The time at which `expire` next has work, or None if no producer is known."""
        return self._enqueue_line.retries.next_expiry()

    def take_batches(self) -> list[tuple[TakerState, Batch]]:
        """The new batches since the last call, with their takers.

        The caller sends each batch. It calls `sending` when it begins to send a batch, and `note_sent` after it.
        """
        batches, self._dispatcher.batches = self._dispatcher.batches, []
        return batches

    def take_silent(self) -> list[TakerState]:
        """The takers that became silent since the last call. The caller asks them for a sign of life.

        A silent taker let a lease end, and has sent nothing since that lease began. It does not count as waiting, and
        gets no messages, until it sends something (`grant`).
        """
        silent, self._queue_leases.silent = self._queue_leases.silent, []
        return silent

    def take_finished(self) -> list[Enqueue]:
        """The waiting runs that became done since the last call."""
        finished, self._enqueue_line.finished = self._enqueue_line.finished, []
        return finished

    def counters(self, now: int) -> QueueCounters:
        """The present counts."""
        self._due_work.tick(now)
        return self.latest_counters()

    def latest_counters(self) -> QueueCounters:
        """Like `counters`, but as of the last call that took the time. Changes nothing."""
        tally, queue_items = self._queue_items.tally, self._queue_items
        return QueueCounters(
            held=queue_items.items,
            leased=queue_items.leased,
            held_bytes=queue_items.payload_bytes,
            **{name: getattr(tally, name) for name in tally.__slots__},
        )

    @property
    def limits(self) -> QueueLimits:
        """The present limits."""
        return self._queue_items.limits

    @property
    def waiting_takers(self) -> int:
        """The number of takers that wait for a message."""
        return len(self._dispatcher)

    @property
    def waiting_enqueues(self) -> int:
        """The number of runs that wait for room."""
        return len(self._enqueue_line)

    @property
    def has_dead_letters(self) -> bool:
        """Whether a message waits for its move to the dead-letter queue."""
        return bool(self._queue_items.leaving)

    @property
    def oldest_accepted_at(self) -> int | None:
        """The time at which the oldest held message was accepted, or None if the queue is empty."""
        return self._queue_items.oldest_accepted_at

    @property
    def footprint_bytes(self) -> int:
        """The bytes that the queue takes in the host's memory.

        They include stored runs, 64 bytes for each message, waiting runs, acknowledged deliveries, producers' latest
        runs, and message ids.
        """
        queue_items, enqueue_line = self._queue_items, self._enqueue_line
        known = self._queue_leases.acknowledged.footprint_bytes + enqueue_line.retries.footprint_bytes
        known += enqueue_line.message_ids.footprint_bytes
        return queue_items.stored_bytes + queue_items.items * 64 + enqueue_line.waiting_bytes + known
