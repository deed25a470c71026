"""Judges the runs that producers put into a queue. Pure.

The queue judges a run message by message, and recognises a repeated run. While the queue has no room, the run waits.
"""

from __future__ import annotations

from collections import Counter, OrderedDict
from itertools import islice

from stampede_rt.errors import ItemTooLarge, Overloaded, QueueFull, StampedeError
from stampede_rt_channel_host.core.deadlines import Deadlines
from stampede_rt_channel_host.core.dedup import KeptRun, RetryWindow
from stampede_rt_channel_host.core.queue.enqueue import Enqueue
from stampede_rt_channel_host.core.queue.items import QueuedRun
from stampede_rt_channel_host.core.queue.limits import BLOCK, DROP_OLDEST, ITEM_OVERHEAD_BYTES
from stampede_rt_channel_host.core.queue.message_ids import KnownMessage, MessageIds
from stampede_rt_channel_host.core.queue.queue_items import QueueItems
from stampede_rt_channel_host.core.run_outcome import RunOutcome, RunPart

WAITING_RUNS_MAX = 10_000
WAITING_BYTES_MAX = 64 * 2**20
"""The bounds of one queue's waiting runs. A single run may wait even if it is larger."""
WAITING_BYTES_OF_ONE_MAX = WAITING_BYTES_MAX * 3 // 4
"""The most bytes of one caller's waiting runs in one queue. A single run of a caller may be larger."""
OFFERED_PER_CALL_MAX = 512
"""After this number of messages of waiting runs, one call judges no further run."""
DROPPED_PER_RUN_MAX = 1024
"""To make room for a run of n messages, one call drops at most this number plus 2n messages.

If the queue must drop more messages, the run waits in line, and the next call drops some.
"""
MAKING_ROOM_NANOS = 1_000_000_000
"""While the queue drops messages to make room for a run, the run waits up to this time, even if its producer does not
want to wait.
"""


class EnqueueLine:
    """The line of waiting runs. A waiting run blocks all later runs.

    `finished` collects the runs that waited and are done, until the caller takes them. `has_more`: there may be room
    for the first run in line, so call `offer_line` again without a wait for a change.
    """

    def __init__(self, queue_items: QueueItems, queue_name: str) -> None:
        self._queue_items = queue_items
        self._queue = queue_name
        self._line: OrderedDict[Enqueue, None] = OrderedDict()
        self._deadlines: Deadlines[Enqueue] = Deadlines()
        self._arrivals = 0
        self.retries = RetryWindow()
        self.message_ids = MessageIds()
        self.waiting_bytes = 0
        self._waiting_bytes_by_caller: Counter[str] = Counter()  # without the runs of callers that have no name
        self.finished: list[Enqueue] = []
        self.has_more = False
        self._ending: StampedeError | None = None  # the error of `refuse_waiting`, until no run waits
        self._drops_left = 0  # the messages that the present offer may still drop to make room

    def __len__(self) -> int:
        """The number of waiting runs."""
        return len(self._line)

    def enqueue(self, run: Enqueue, now: int) -> None:
        """Judge the run. If some of its messages have to wait for room, the run waits in line.

        Raises InvalidArgument if the run's numbers overlap another run's numbers, and Overloaded if too many runs wait.
        """
        if self._ending is not None:  # the run may repeat a run that still waits
            run.error = self._ending
            return
        if self._recognise(run, now):
            return
        if not self._line and self._offer(run, now):
            return
        if run.wait_nanos is not None and run.wait_nanos <= 0 and not self._is_making_room:
            self._refuse_rest(run, self._full(), now)
            return
        self._stand_in_line(run, now)

    def offer_line(self, now: int) -> None:
        """Judge the waiting runs again, in order, because there may be room."""
        self.has_more, offered = False, 0
        while self._line and self._ending is None:
            if offered >= OFFERED_PER_CALL_MAX:
                self.has_more = True
                return
            run = next(iter(self._line))
            if not self._judge_again(run, now):
                return
            self._stop_waiting(run)
            self.finished.append(run)
            offered += len(run.lengths)

    def give_up_one(self, now: int) -> bool:
        """End the wait of a run whose time is over. Returns False if there is no such run."""
        run = self._deadlines.pop(now)
        if run is None:
            return False
        self._stop_waiting(run)
        self._refuse_rest(run, self._full(), now)
        self.finished.append(run)
        return True

    def withdraw(self, run: Enqueue, now: int) -> None:
        """Take a run out of the line, because its producer does not wait for it any more. Idempotent.

        The queue keeps the messages that it has accepted. If the producer repeats the run, the queue continues after
        these messages.
        """
        if run in self._line:
            self._stop_waiting(run)
            self._remember(run, now)

    def refuse(self, run: Enqueue, error: StampedeError, now: int) -> None:
        """Take a run out of the line, and refuse its unjudged messages because of `error`. Idempotent."""
        if run in self._line:
            self._stop_waiting(run)
            self.fail(run, error, now)
            self.finished.append(run)

    def fail(self, run: Enqueue, error: StampedeError, now: int) -> None:
        """Refuse a run that is not in line, because of `error`.

        If some messages are accepted and the producer will not repeat the run, refuses only the other messages.
        Otherwise the run as a whole gets the error. If the producer repeats it, the queue continues after the accepted
        messages.
        """
        if run.progress.accepted_any and not (error.retryable and run.producer_id):
            self._refuse_rest(run, error, now)
        else:
            self._remember(run, now)
            run.error = error

    def refuse_waiting(self, error: StampedeError, now: int, runs_max: int) -> bool:
        """Refuse the first `runs_max` waiting runs, because the host gives the queue up. Returns True if more wait.

        While runs wait, the queue refuses all new runs, too.
        """
        self._ending = error
        for run in [*islice(self._line, runs_max)]:
            self._stop_waiting(run)
            self.fail(run, error, now)
            self.finished.append(run)
        if not self._line:
            self._ending = None
        return bool(self._line)

    def next_deadline(self) -> int | None:
        """The time at which the wait of a run next ends, or None if no wait has an end."""
        return self._deadlines.next()

    def _recognise(self, run: Enqueue, now: int) -> bool:
        """Whether the run is done because it repeats a judged run, or because its message id is known.

        If only the first messages of the run were judged before, the judgement continues after them.
        """
        known = None
        if run.producer_id:
            known = self.retries.find(run.producer_id, run.first_number, len(run.lengths), now)
        if known is None:
            return self._is_duplicate(run, now)
        run.progress.resume(known)
        run.outcome = known if known.is_whole else None
        return known.is_whole

    def _is_duplicate(self, run: Enqueue, now: int) -> bool:
        """Whether a message with the run's message id was accepted before. The run then gets that message's seq."""
        seq = self.message_ids.find(run.message_id, now) if run.message_id else None
        if seq is not None:
            self._queue_items.tally.duplicates += 1
            run.is_duplicate = True
            run.outcome = RunOutcome(1, 1, (RunPart(0, seq, 1, None),), (), now)
        return run.is_duplicate

    def _judge_again(self, run: Enqueue, now: int) -> bool:
        """Judge a waiting run. Returns True if the run is done.

        The producer may have repeated the run on another stream meanwhile.
        """
        try:
            return self._recognise(run, now) or self._offer(run, now)
        except StampedeError as error:
            self.fail(run, error, now)
            return True

    def _stand_in_line(self, run: Enqueue, now: int) -> None:
        """Put the run at the end of the line. Raises Overloaded if too many runs wait."""
        too_much = self.waiting_bytes + run.charged_bytes > WAITING_BYTES_MAX
        if len(self._line) >= WAITING_RUNS_MAX or (self._line and too_much):
            raise Overloaded(
                f"{len(self._line)} runs with {self.waiting_bytes} bytes wait for room in {self._queue} already; put "
                "less at a time, let more takers take, or raise the queue's limits"
            )
        own_bytes = self._waiting_bytes_by_caller[run.caller_name] if run.caller_name else 0
        if own_bytes and own_bytes + run.charged_bytes > WAITING_BYTES_OF_ONE_MAX:
            raise Overloaded(
                f"runs of {run.caller_name} with {own_bytes} bytes wait for room in {self._queue} already, and one "
                f"caller may have {WAITING_BYTES_OF_ONE_MAX} bytes there; put less at a time, or let more takers take",
                metadata={"subject": run.caller_name, "used": str(own_bytes), "limit": str(WAITING_BYTES_OF_ONE_MAX)},
            )
        self._arrivals += 1
        run.order = self._arrivals
        self._count_waiting(run, run.charged_bytes)
        self._line[run] = None
        if run.wait_nanos is not None:
            at_least = MAKING_ROOM_NANOS if self._is_making_room else 0
            self._deadlines.set_due(run, now + max(run.wait_nanos, at_least))

    @property
    def _is_making_room(self) -> bool:
        """Whether the runs wait only because a call has dropped as many messages as it may."""
        return self.has_more and self._queue_items.limits.on_full == DROP_OLDEST

    def _stop_waiting(self, run: Enqueue) -> None:
        del self._line[run]
        self._deadlines.disarm(run)
        self._count_waiting(run, -run.charged_bytes)

    def _count_waiting(self, run: Enqueue, more_bytes: int) -> None:
        """Add `more_bytes`, which may be below 0, to the bytes of waiting runs of the queue and of the run's caller."""
        self.waiting_bytes += more_bytes
        if run.caller_name:
            self._waiting_bytes_by_caller[run.caller_name] += more_bytes
            if not self._waiting_bytes_by_caller[run.caller_name]:
                del self._waiting_bytes_by_caller[run.caller_name]

    def _offer(self, run: Enqueue, now: int) -> bool:
        """Accept the messages for which there is room. Returns True if the run is done."""
        queue_items, taken, progress = self._queue_items, QueuedRun(self._queue_items.next_seq, [], now), run.progress
        positions: list[int] = []
        self._drops_left = DROPPED_PER_RUN_MAX + 2 * len(run.lengths)
        while progress.judged_items < len(run.lengths):
            length = run.lengths[progress.judged_items]
            if length > queue_items.limits.payload_bytes_max:
                self._refuse(run, self._too_large(length))
            elif self._make_room(length):
                queue_items.add(taken, length)
                positions.append(progress.judged_items)
            elif queue_items.limits.on_full == BLOCK or self._is_making_room:
                break
            else:
                self._refuse(run, self._full())
            progress.judged_items += 1
        if positions:
            self._seal(run, taken, positions, now)
        if progress.judged_items < len(run.lengths):
            if positions:
                self._remember(run, now)  # a replica gets the messages and the outcome so far together
            return False
        self._resolve(run, now)
        return True

    def _make_room(self, length: int) -> bool:
        """Drop the oldest messages until there is room, if the policy says so. Returns whether there is room."""
        while not self._queue_items.has_room(length):
            if self._queue_items.limits.on_full != DROP_OLDEST:
                return False
            if not self._drops_left:
                self.has_more = True
                return False
            if not self._queue_items.drop_oldest():
                return False
            self._drops_left -= 1
        return True

    def _seal(self, run: Enqueue, taken: QueuedRun, positions: list[int], now: int) -> None:
        """Give the accepted messages their seqs and their stored bytes."""
        stamped = run.progress.stamped_time if run.progress.accepted_any else now if run.is_stamped else None
        run.progress.accept(positions[0], taken.first_seq, len(positions), stamped)
        self._queue_items.set_body(taken, run.seal(taken.first_seq, positions, stamped))

    def _resolve(self, run: Enqueue, now: int) -> None:
        """Set the outcome of a run whose messages are all judged, and remember it."""
        run.outcome = self._remember(run, now)
        if run.message_id and run.progress.accepted_any:
            known = KnownMessage(run.message_id, run.outcome.parts[0].first_seq, now, run.caller_name)
            self.message_ids.record(*known)
            if self._queue_items.changes is not None:
                self._queue_items.changes.message_ids.append(known)

    def _remember(self, run: Enqueue, now: int) -> RunOutcome:
        """Remember the run's outcome so far, so that a repetition of the run gets it or continues after it."""
        judged = run.progress.outcome(now)
        self.retries.record(run.producer_id, run.first_number, judged, run.caller_name)
        if run.producer_id and self._queue_items.changes is not None:
            kept = KeptRun(run.producer_id, run.first_number, judged, run.caller_name)
            self._queue_items.changes.producers.append(kept)
        return judged

    def _refuse_rest(self, run: Enqueue, error: StampedeError, now: int) -> None:
        """Refuse the messages of the run that are not judged yet."""
        while run.progress.judged_items < len(run.lengths):
            self._refuse(run, error)
            run.progress.judged_items += 1
        self._resolve(run, now)

    def _refuse(self, run: Enqueue, error: StampedeError) -> None:
        """Refuse the next message of the run, and count the refusal."""
        if isinstance(error, ItemTooLarge):
            self._queue_items.tally.rejected_too_large += 1
        elif isinstance(error, QueueFull):
            self._queue_items.tally.rejected_full += 1
        run.progress.refuse(run.progress.judged_items, error)

    def _too_large(self, length: int) -> ItemTooLarge:
        return ItemTooLarge(
            f"a message of {length} bytes is too large for {self._queue}, which takes at most "
            f"{max(0, self._queue_items.limits.payload_bytes_max)}; split it, or raise the limits"
        )

    def _full(self) -> QueueFull:
        limits, queue_items = self._queue_items.limits, self._queue_items
        charged = queue_items.payload_bytes + queue_items.items * ITEM_OVERHEAD_BYTES
        return QueueFull(
            f"{self._queue} is full: it holds {queue_items.items} messages charged with {charged} bytes, "
            f"{queue_items.leased} of them leased, of at most {limits.max_items or 'any number of'} messages and "
            f"{limits.max_bytes} bytes; take faster, put later, or raise its limits"
        )
