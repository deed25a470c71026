"""One queue at its host: the core, the directory's record, the streams of its takers, and its waiting runs."""

from __future__ import annotations

import asyncio
import itertools
import random
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from functools import partial
from typing import Protocol

from stampede_rt.errors import ItemTooLarge, Overloaded, StampedeError
from stampede_rt_channel_host.channels.limits.memory import MemoryBudget
from stampede_rt_channel_host.core.channel import Pieces
from stampede_rt_channel_host.core.deadlines import Deadlines
from stampede_rt_channel_host.core.queue import (
    Batch,
    Enqueue,
    PendingDelivery,
    QueueCore,
    QueueLimits,
    Settlement,
    SettlementResult,
    TakerState,
)
from stampede_rt_channel_host.core.records import RecordedQueue
from stampede_rt_channel_host.queues.queue_content import QueueContent, QueueMove
from stampede_rt_channel_host.queues.refusals import display_name
from stampede_rt_channel_host.queues.replicated_queue import ReplicatedQueue

TAKERS_MAX = 4096
STREAMS_PER_PIECE = 256
STREAMS_END_SECONDS_MAX = 2.0
_orders = itertools.count()
FIRST_DELIVERY_IDS = range(1, 2**62)  # below 2**62, so that all later ids fit into a signed int64
_TIMER_SECONDS_MIN = 0.0001  # the host's clock may be slower than the loop's: the timer must not fire again and again


class TakerStream(Protocol):
    """The methods of a taker's stream that its queue calls."""

    def deliver(self, batch: Batch) -> None:
        """Send a batch that the queue has leased to the taker."""

    def probe(self) -> None:
        """Send a sign of life to the taker, which was silent for a long time. A live taker answers it."""

    def end(self, error: StampedeError) -> None:
        """Note that the host no longer serves the queue."""


class HostedQueue(ReplicatedQueue):
    """One queue at this host.

    `record` is the latest record from the directory. The core has the incarnation of the record. Requests must name
    `epoch`, the epoch of the record. `epoch` 0: the store must ask the directory before it serves the queue again.
    The queue calls `on_dead_letters` at each change while messages wait for their move to the dead-letter queue.
    """

    def __init__(
        self,
        record: RecordedQueue,
        memory: MemoryBudget,
        now: Callable[[], int],
        on_dead_letters: Callable[[HostedQueue], None],
        deadlines: Deadlines[HostedQueue],
        may_serve: Callable[[], bool] = lambda: True,
        content: QueueContent | None = None,
    ) -> None:
        """`deadlines`: the deadlines of all queues of the host. `may_serve` says whether the host has its lease.
        `content`: the queue, if it came from another host. Raises InvalidArgument for impossible limits.
        """
        self.record = record
        self.epoch: int = record.epoch
        self.registration = 0  # the number of the host's last registration when the store took `record` over
        self.moving: QueueMove | None = None  # the move of the queue away from this host, while one is under way
        self.queue = (
            content.core
            if content is not None
            else QueueCore(
                QueueLimits.of(record.policy),
                incarnation=record.incarnation,
                name=display_name(record),
                first_delivery_id=random.choice(FIRST_DELIVERY_IDS),
                may_serve=may_serve,
            )
        )
        self.due: int | None = None  # when the sweep looks at the queue; `Deadlines` sets it
        self.order = next(_orders)  # decides between queues that are due at the same time
        self._deadlines = deadlines
        self._charge = memory.charge_for(record.created_by)
        self._now = now
        self._on_dead_letters = on_dead_letters
        self._streams: dict[TakerState, TakerStream] = {}
        self._stream_ended = asyncio.Event()  # set when a stream has ended
        self._waiting: dict[Enqueue, asyncio.Future[None]] = {}
        self._timer: asyncio.TimerHandle | None = None
        self._timer_due: int | None = None
        self.replicate(content)
        if content is not None:
            self.queue.resume(now())  # the queue was paused if this host held it for a move before
            self.queue.configure(QueueLimits.of(record.policy), now())
            self.follow_up()

    def update(self, record: RecordedQueue) -> None:
        """Take over a newer record of the same incarnation. Raises InvalidArgument for an unusable policy."""
        has_changed, has_failed = record.spec_version != self.record.spec_version, record.epoch > self.record.epoch
        was_at_other_owner = record.epoch > self.record.epoch + 1
        self.record, self.epoch = record, record.epoch
        if self.moving is not None and not has_failed:
            return  # nothing may change the queue now; it gets the new limits when the move is over
        moving, self.moving = self.moving, None
        if has_changed:
            self.replicate()
        if has_changed or moving is not None:
            self.queue.configure(QueueLimits.of(record.policy), self._now())
        if moving is not None and was_at_other_owner and self.replication is not None:
            self.replication.own_again(record.epoch)
        if moving is not None:  # the move has failed
            self.queue.resume(self._now())
            moving.over.set()
        self.follow_up()

    async def hold(self, error: StampedeError) -> None:
        """End all streams and waits with `error`, and let nothing change the queue from then on, until `update` gets a
        record with another epoch. Raises Overloaded if the streams do not end.
        """
        self.moving = QueueMove()
        for _ in self._stopping(error):
            await asyncio.sleep(0)
        try:
            async with asyncio.timeout(STREAMS_END_SECONDS_MAX):
                while self._streams:
                    self._stream_ended.clear()
                    await self._stream_ended.wait()
        except TimeoutError:
            raise Overloaded(f"the streams of queue {display_name(self.record)} did not end; move it again") from None
        self.moving.is_held = True

    @property
    def is_held(self) -> bool:
        """Whether nothing may change the queue, because it moves to another host."""
        return self.moving is not None and self.moving.is_held

    async def enqueue(self, run: Enqueue, waiting: Callable[[], AbstractContextManager[None]]) -> None:
        """Put a run, and return when it is accepted or refused. If the run has to wait for room, this call waits inside
        the context that `waiting` makes.

        A cancellation withdraws the run. Raises InvalidArgument if the run's numbers overlap another run's, Overloaded
        if memory is used up or too many runs wait.
        """
        done: asyncio.Future[None] | None = None
        try:
            self._charge.claim(run.charged_bytes)
            self.put(run)
            if not run.is_done:
                done = self._waiting[run] = asyncio.get_running_loop().create_future()
        except Overloaded as error:
            self._count_overloaded(run, error)
            raise
        finally:
            self.follow_up()  # the core may also have ended leases, even if it has refused the run
        if done is None:
            return
        try:
            with waiting():
                await done
        except Overloaded as error:
            self._count_overloaded(run, error)
            raise
        finally:
            if self._waiting.pop(run, None) is not None:
                self.queue.withdraw(run, self._now())
                self.follow_up()

    def refuse(self, run: Enqueue, error: StampedeError) -> None:
        """Refuse a run that waits for room. The call of `enqueue` that waits with the run then returns."""
        self.queue.refuse(run, error, self._now())
        self.follow_up()

    def _count_overloaded(self, run: Enqueue, error: Overloaded) -> None:
        self.queue.reject_overloaded(len(run.lengths))
        self._charge.refused(display_name(self.record), len(run.lengths), error)

    def refuse_unread(self, error: StampedeError) -> None:
        """Count a run that the host could not read."""
        if isinstance(error, ItemTooLarge):
            self.queue.reject_too_large()
        else:
            self.queue.reject_malformed()

    def takers(self) -> list[TakerState]:
        """The takers with a stream."""
        return [*self._streams]

    def attach(self, taker: TakerState, stream: TakerStream) -> None:
        """Add the stream of a taker. Call `leave` at its end. Raises Overloaded if there are TAKERS_MAX streams."""
        if len(self._streams) >= TAKERS_MAX:
            raise Overloaded(f"queue {display_name(self.record)} has {TAKERS_MAX} takers, the limit; close some")
        self._streams[taker] = stream

    def grant(self, taker: TakerState, credit: int) -> None:
        """Add `credit` messages to the credit of the taker. 0 only notes a sign of life."""
        self.queue.grant(taker, credit, self._now())
        self.follow_up()

    def note_sent(self, taker: TakerState) -> None:
        """Note that the taker's last batch has been sent."""
        self.queue.note_sent(taker, self._now())
        self.follow_up()

    def leave(self, taker: TakerState) -> None:
        """Remove the stream of a taker, which has ended. Its sent messages stay leased. The queue takes back the
        messages that were not sent.
        """
        stream = self._streams.pop(taker)
        self._stream_ended.set()
        if self.replication is not None:
            self.replication.forget(taker)
            self.replication.forget(stream)
        self.queue.leave(taker, self._now())
        self.follow_up()

    def settle(self, taker_id: int, settlements: Sequence[Settlement]) -> list[SettlementResult]:
        """Perform settlements. Returns their results in order."""
        results = self.queue.settle(taker_id, settlements, self._now())
        self.follow_up()
        return results

    def pending(self, after_delivery_id: int, limit: int) -> list[PendingDelivery]:
        """The first `limit` leased deliveries whose ids follow `after_delivery_id`, with their takers."""
        found = self.queue.pending(after_delivery_id, limit, self._now())
        self.follow_up()
        return found

    def dead_letter_moved(self, seq: int) -> None:
        """Note that the dead-letter queue has acknowledged the message."""
        # The next owner of a held queue sends the message again. The dead-letter queue recognises the message.
        if not self.is_held:
            self.queue.dead_letter_moved(seq, self._now())
            self.follow_up()

    def tick(self) -> None:
        """Handle everything that is due by the host's clock."""
        if self.is_held:
            return
        now = self._now()
        self.queue.tick(now)
        self.queue.expire(now)
        self.follow_up()

    def ending(self, error: StampedeError) -> Pieces[None]:
        """Refuse all waiting runs and end all takers' streams with `error`, in pieces.

        Meanwhile the queue accepts no messages, and gives takers none.
        """
        if self.replication is not None:
            self.replication.end(error)
        if self.moving is not None:  # `hold` has ended them
            return
        yield from self._stopping(error)
        if not self._is_forgotten:
            yield  # afterwards the interrupted streams do not use the queue any more
            self.queue.resume(self._now())
            self.follow_up()

    def _stopping(self, error: StampedeError) -> Pieces[None]:
        self.queue.pause()
        streams = list(self._streams.items())
        while self.queue.refuse_waiting(error, self._now()):
            self.follow_up()
            yield
        self.follow_up()
        for at, (taker, stream) in enumerate(streams, 1):
            if self._streams.get(taker) is stream:
                stream.end(error)
            if at % STREAMS_PER_PIECE == 0:
                yield

    def leaving(self, error: StampedeError) -> Pieces[None]:
        """End like `ending`, and then free the messages, unless the host keeps them as a replica. The host gives the
        queue up, and stops counting its memory.
        """
        self._is_forgotten = True
        if self._timer is not None:
            self._timer.cancel()
        self._deadlines.disarm(self)
        self._charge.set(0)
        if self.moving is not None:
            self.moving.redirect_error = error
            self.moving.over.set()
        if self.replication is not None:
            self.replication.close()
        yield from self.ending(error)
        yield  # afterwards the interrupted streams do not use the queue any more
        if self.replication is not None:
            yield from self.replication.journal.stopping()
        if not self.is_kept:
            yield from self.queue.emptying()

    def follow_up(self) -> None:
        """Pass the results of a call of the core on to streams and waiting runs, and set the next deadline."""
        if self.replication is not None:
            self.replication.changed(self._now())
        elif self.copying is not None:
            self.copying.changed(self._now())
        for taker, batch in self.queue.take_batches():
            self.once_replicated(taker, partial(self._streams[taker].deliver, batch))
        for taker in self.queue.take_silent():
            self._streams[taker].probe()
        for run in self.queue.take_finished():
            done = self._waiting.pop(run, None)
            if done is not None:
                _finish(done)
        if self._is_forgotten:
            return
        steps_bytes = 0 if self.replication is None else self.replication.journal.size_bytes
        steps_bytes += 0 if self.copying is None else self.copying.steps.size_bytes
        self._charge.set(self.queue.footprint_bytes + steps_bytes)
        if self.queue.has_dead_letters:
            self._on_dead_letters(self)
        due = self.queue.next_deadline()
        self._set_timer(due)
        due = self.queue.next_expiry() if due is None else due
        # an earlier deadline stays: the sweep may look at a queue too early
        if due is not None and (self.due is None or due < self.due):
            self._deadlines.set_due(self, due)

    def _set_timer(self, due: int | None) -> None:
        """Set the timer to `due`, unless it fires earlier already. A timer that fires too early does no harm."""
        if due is None or (self._timer_due is not None and self._timer_due <= due):
            return
        if self._timer is not None:
            self._timer.cancel()
        self._timer_due = due
        delay_s = max((due - self._now()) / 1e9, _TIMER_SECONDS_MIN)
        self._timer = asyncio.get_running_loop().call_later(delay_s, self._fire)

    def _fire(self) -> None:
        self._timer = self._timer_due = None
        self.tick()


def _finish(done: asyncio.Future[None]) -> None:
    if not done.done():
        done.set_result(None)
