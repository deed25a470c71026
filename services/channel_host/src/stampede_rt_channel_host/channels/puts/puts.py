"""The puts into one channel. The core accepts or refuses their items. `ChannelPuts` recognises retries, and lets puts
wait while the channel is full.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext

from stampede_rt.errors import InvalidArgument, ItemTooLarge, Overloaded, StampedeError
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt_channel_host.channels.limits.memory import Charge, MemoryBudget
from stampede_rt_channel_host.channels.puts.acks import ack_of, refused
from stampede_rt_channel_host.channels.puts.incoming_run import IncomingRun
from stampede_rt_channel_host.channels.puts.writers import Writers
from stampede_rt_channel_host.core.channel import ChannelCore, Offer, Pieces, PutOutcome
from stampede_rt_channel_host.core.dedup import RetryWindow
from stampede_rt_channel_host.core.run_outcome import RunOutcome

WAITING_PUTS_MAX = 10_000
PUTS_PER_PIECE = 128
ITEMS_OFFERED_MAX = 128
"""The most items of waiting runs that one call of `changed` offers.

It offers the last of these runs whole, even beyond the limit.
"""
_TIMER_SECONDS_MIN = 0.0001  # the host's clock may be slower than the loop's: the timer must not fire again and again


class ChannelPuts:
    """The puts of one channel, in the order of arrival. A put that waits blocks all later puts.

    Calls `on_accepted` with the time after each run of which the channel has accepted items. Calls `on_touched`
    whenever the memory of the channel may have changed.
    """

    def __init__(
        self,
        channel: ChannelCore,
        memory: MemoryBudget | Charge,
        now: Callable[[], int],
        on_accepted: Callable[[int], None],
        on_touched: Callable[[], None],
        may_serve: Callable[[], bool] = lambda: True,
    ) -> None:
        """`may_serve` says whether the host has its lease. Without the lease the channel accepts no waiting puts."""
        self._channel = channel
        self._memory = memory
        self._now = now
        self._on_accepted = on_accepted
        self._on_touched = on_touched
        self._may_serve = may_serve
        self.check_room: Callable[[int], None] = _has_room
        """Raises Overloaded while the channel takes no items, or has no room for a run of this size."""
        self.store: Callable[[IncomingRun, int], PutOutcome] | None = None
        """Puts the rest of a run into the channel, in place of `ChannelCore.put`."""
        self._ending: StampedeError | None = None  # set while the waiting puts are being refused
        self.retries = RetryWindow()
        self._waiting_bytes = 0
        self._waiting_runs: list[IncomingRun] = []  # not a deque: an empty one takes 600 bytes
        self._timer: asyncio.TimerHandle | None = None
        self._writers: Writers | None = None  # most channels of a large host have none
        self._overdue: list[IncomingRun] | None = None  # while the puts are held: runs whose waiting time is over

    def hold(self) -> None:
        """Let all puts wait until `release`, because the channel moves. The retry window gets the known outcomes."""
        self._overdue = []
        now = self._now()
        for run in self._waiting_runs:
            self._remember(run, now)

    def release(self) -> None:
        """Accept puts again. Does nothing if they are not held."""
        if self._overdue is None:
            return
        overdue, self._overdue = self._overdue, None
        self.changed(self._now())
        for run in overdue:
            self.give_up(run)

    def __len__(self) -> int:
        """The number of waiting runs."""
        return len(self._waiting_runs)

    @property
    def footprint_bytes(self) -> int:
        """The memory of the waiting runs and of the retry window, in bytes."""
        return self._waiting_bytes + self.retries.footprint_bytes

    def expire(self, now: int) -> None:
        """Forget the producers that have put nothing for a long time (see `RetryWindow.expire`)."""
        self.retries.expire(now)

    def next_expiry(self) -> int | None:
        """The time at which `expire` has work again; None: never."""
        return self.retries.next_expiry()

    def put(self, run: IncomingRun, now: int) -> pb.PutAck | None:
        """Judge a run. Returns its ack, or None if the run has to wait for room.

        After None, await `run.wait(self.give_up)`, and then call `withdraw`, even if that wait was cancelled. Raises
        Overloaded if too many puts wait, or if memory is used up. Raises InvalidArgument if the run's numbers overlap
        another run's.
        """
        try:
            return self._put(run, now)
        except Overloaded as error:
            self._count_overloaded(run, error)
            raise
        finally:
            self._on_touched()

    @contextmanager
    def announced_together(self) -> Iterator[None]:
        """A block of puts, without an await. The channel announces all its runs together, at the end of the block.

        Give no ack before the end: a reader must see each item whose put is acknowledged.
        """
        announce, accepted_at = self._on_accepted, list[int]()
        self._on_accepted = accepted_at.append
        try:
            yield
        finally:
            self._on_accepted = announce
            if accepted_at:
                announce(accepted_at[-1])

    def _put(self, run: IncomingRun, now: int) -> pb.PutAck | None:
        if self._ending is not None:  # the run may repeat a run that still waits
            return refused(run.first_number, run.items, self._ending, now, self._channel.incarnation)
        is_held = self._overdue is not None
        has_to_wait = is_held or bool(self._waiting_runs)
        may_not_wait = run.wait_nanos is not None and run.wait_nanos <= 0 and not is_held
        # a run that the channel accepts only in part is announced when its outcome is known, see `_offer`
        with self.announced_together() if may_not_wait and self._channel.may_block else nullcontext():
            if self._recognise(run, now) or (not has_to_wait and self._claim_and_offer(run, now)):
                assert run.ack is not None, "a run that does not wait has an ack"
                return run.ack
            if may_not_wait:
                return self._refuse_rest(run, now)
        if len(self._waiting_runs) >= WAITING_PUTS_MAX:
            raise Overloaded(
                f"{WAITING_PUTS_MAX} puts wait for room in the channel already, the limit; put again later"
            )
        if has_to_wait:
            self._memory.claim(run.charged_bytes)
        self._wait(run)
        return None

    def _wait(self, run: IncomingRun) -> None:
        self._waiting_runs.append(run)
        self._waiting_bytes += run.charged_bytes

    @property
    def may_wait(self) -> bool:
        """Whether the next run may have to wait for room."""
        return bool(self._waiting_runs) or self._overdue is not None or self._channel.may_block

    def count_unread(self, length_bytes: int, error: StampedeError, now: int) -> None:
        """Count a run of `length_bytes` bytes that the host could not read because of `error`."""
        if isinstance(error, ItemTooLarge):  # the core does not count such items as malformed
            self._channel.put(Offer(times=None, durations=None, lengths=(length_bytes,)), now, _seal_nothing)
        else:
            self._channel.reject_malformed(1)

    def changed(self, now: int) -> None:
        """Offer the waiting runs again, in order, because there may be room.

        If these runs have very many items, the host offers the last ones a moment later.
        """
        offered = 0
        while self._waiting_runs and self._may_offer:
            if offered >= ITEMS_OFFERED_MAX:
                self._set_timer(now, now)
                break
            offered += self._waiting_runs[0].undecided_items
            if not self._offer_waiting(self._waiting_runs[0], now):
                break
            self._stop_waiting(self._waiting_runs[0])
        self._on_touched()

    @property
    def _may_offer(self) -> bool:
        return self._ending is None and self._overdue is None and self._may_serve()

    def _stop_waiting(self, run: IncomingRun) -> None:
        self._waiting_runs.remove(run)
        self._waiting_bytes -= run.charged_bytes

    def give_up(self, run: IncomingRun) -> None:
        """Refuse the rest of the run, because its waiting time is over."""
        if self._overdue is not None:
            self._overdue.append(run)
            return
        now = self._now()
        if run in self._waiting_runs:
            self._stop_waiting(run)
            run.finish(self._refuse_rest(run, now))
            self.changed(now)

    def refuse(self, run: IncomingRun, error: StampedeError) -> pb.PutAck:
        """Refuse a run that waits: its caller has reached a quota, or has lost a right. Returns its ack."""
        if run in self._waiting_runs:
            now = self._now()
            if isinstance(error, Overloaded):
                self._count_overloaded(run, error)
            self._stop_waiting(run)
            self._fail(run, error, now)
            self.changed(now)
        assert run.ack is not None, "a failed run has an ack"
        return run.ack

    def withdraw(self, run: IncomingRun) -> None:
        """Stop the wait of a run, because its caller no longer waits. The channel accepts no further item of the run.

        The retry window remembers the accepted items. If the producer sends the run again, the channel continues after
        them. Does nothing for a run that has its ack.
        """
        run.forget_time()
        if run in self._waiting_runs:
            now = self._now()
            self._stop_waiting(run)
            self._remember(run, now)
            self.changed(now)

    def ending(self, error: StampedeError) -> Pieces[None]:
        """Refuse the waiting runs in pieces, and all runs that come meanwhile: the host stops serving the channel."""
        if self._timer is not None:
            self._timer.cancel()
        self._ending = error
        while self._waiting_runs:
            for _ in range(min(PUTS_PER_PIECE, len(self._waiting_runs))):
                run = self._waiting_runs.pop(0)
                self._waiting_bytes -= run.charged_bytes
                self._fail(run, error, self._now())
            self._on_touched()
            if self._waiting_runs:
                yield
        self._ending = None

    def _offer_waiting(self, run: IncomingRun, now: int) -> bool:
        try:
            return self._recognise(run, now) or self._offer(run, now)
        except StampedeError as error:
            self._fail(run, error, now)
            return True

    def _count_overloaded(self, run: IncomingRun, error: Overloaded) -> None:
        self._channel.reject_overloaded(run.undecided_items)
        self._memory.refused(self._channel.name, run.undecided_items, error)

    def _fail(self, run: IncomingRun, error: StampedeError, now: int) -> None:
        """Refuse a run that waits, because of `error`.

        If some items are accepted and the producer will not repeat the run, only the other items are refused. Otherwise
        the run as a whole gets the error, and a repetition continues after the accepted items.
        """
        if run.progress.accepted_any and not (error.retryable and run.producer_id):
            run.refuse_rest(error)
            self._finish(run, now)
        else:
            self._remember(run, now)
            run.finish(refused(run.first_number, run.items, error, now, self._channel.incarnation))

    def _recognise(self, run: IncomingRun, now: int) -> bool:
        """Whether the run repeats a run whose items were all judged. If so, the run gets the former ack.

        Returns False if only the first items were judged before. The run then continues after these items.
        """
        known = self._known(run, now)
        if known is None:
            return False
        run.resume(known, now)
        if known.is_whole:
            run.finish(ack_of(run.first_number, known, self._channel.incarnation))
        return known.is_whole

    def repeats(self, run: IncomingRun, now: int) -> bool:
        """Whether the channel has accepted items of this run before. Raises InvalidArgument as `put`."""
        return self._known(run, now) is not None

    def _known(self, run: IncomingRun, now: int) -> RunOutcome | None:
        return self.retries.find(run.producer_id, run.first_number, run.items, now) if run.producer_id else None

    def _claim_and_offer(self, run: IncomingRun, now: int) -> bool:
        self._memory.claim(run.charged_bytes)
        return self._offer(run, now)

    def _offer(self, run: IncomingRun, now: int) -> bool:
        """Offer the rest of the run, whose memory is claimed. Returns True if the run has its ack.

        The retry window has the outcome so far before the items are announced. A replica gets both together.
        """
        self.check_room(run.charged_bytes)
        outcome = self._channel.put(run.offer, now, run.seal) if self.store is None else self.store(run, now)
        is_done = run.take_outcome(outcome, now)
        if is_done:
            self._finish(run, now)
        else:
            self._set_timer(outcome.retry_at, now)
        if outcome.run is not None:
            if not is_done:
                self._remember(run, now)
            self._note_writer(run.writer, now)
            self._on_accepted(now)
        return is_done

    def _note_writer(self, name: str, now: int) -> None:
        if self._writers is None:
            self._writers = Writers()
        self._writers.note(name, now)

    def writers(self) -> list[tuple[str, int]]:
        """The latest writers, with the times of their last accepted puts (see `Writers.latest`)."""
        return [] if self._writers is None else self._writers.latest()

    def _refuse_rest(self, run: IncomingRun, now: int) -> pb.PutAck:
        run.take_outcome(self._channel.give_up_put(run.offer), now)
        return self._finish(run, now)

    def _finish(self, run: IncomingRun, now: int) -> pb.PutAck:
        judged = self._remember(run, now)
        ack = ack_of(run.first_number, judged, self._channel.incarnation)
        run.finish(ack)
        return ack

    def _remember(self, run: IncomingRun, now: int) -> RunOutcome:
        judged = run.progress.outcome(now)
        self.retries.record(run.producer_id, run.first_number, judged, run.caller_name)
        return judged

    def _set_timer(self, retry_at: int | None, now: int) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        if retry_at is not None:
            delay_s = max((retry_at - now) / 1e9, _TIMER_SECONDS_MIN)
            self._timer = asyncio.get_running_loop().call_later(delay_s, lambda: self.changed(self._now()))


def check_number(producer_id: int, first_number: int) -> None:
    """Raises InvalidArgument for a producer with an id, but without a number: its retries could not be recognised."""
    if producer_id and not first_number:
        raise InvalidArgument("first_number is 0; a producer with an id numbers its items from 1, or leaves its id out")


def _seal_nothing(first_seq: int, kept: Sequence[int] | None, stamped_time: int | None) -> bytes:
    raise AssertionError("an item larger than every limit was accepted")


def _has_room(_: int) -> None:
    """Refuse nothing."""
