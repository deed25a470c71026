"""Ten thousand gets blocked on one channel: their cost, the order of their ends, and the memory that remains."""

from __future__ import annotations

import asyncio
import gc
import tracemalloc
import weakref
from dataclasses import replace
from itertools import pairwise

import pytest

from stampede_rt.errors import Overloaded, Unavailable
from stampede_rt.values.model import Policy
from stampede_rt.values.timeline import MAX_INSTANT, MIN_INSTANT, Match, parse_interval
from stampede_rt_channel_host.channels.gets.waiting_get import Outcome, WaitingGet
from stampede_rt_channel_host.channels.gets.waiting_gets import (
    GETS_PER_PIECE,
    RELEASES_MAX,
    SLICES_PER_LOOK,
    WAITING_GETS_MAX,
    WaitingGets,
)
from stampede_rt_channel_host.channels.piece_scheduler import PieceScheduler
from stampede_rt_channel_host.channels.time_limits import LIMITS_PER_PIECE
from stampede_rt_channel_host.core.channel import (
    ChannelCore,
    Offer,
    PendingGet,
    Pieces,
    Position,
    Query,
    ReachTracker,
    ReadAnswer,
    WakeAt,
)
from stampede_rt_channel_host.core.channel.pieces import run_to_end

START = 1_700_000_000_000_000_000
S = 10**9
FOREVER = -1
NEWEST = Query(
    interval=parse_interval(MIN_INSTANT, MAX_INSTANT), match=Match.START, newest_first=True, limit=1,
    newer_than=Position(START),
)  # fmt: skip
COST_BYTES_MAX = 4096


class BlockedGets:
    """A channel whose clock the test moves, and gets that are blocked on the channel."""

    def __init__(self, max_items: int = 10) -> None:
        self.now = START
        self.channel = CountingChannel(Policy(max_items=max_items, max_future_nanos=1000 * S), incarnation=1, name="a")
        self.gets = WaitingGets(self.channel, ReachTracker(self.channel), lambda: self.now)
        self.released: list[int] = []
        self.outcomes: list[Outcome] = []

    def block(self, number: int, query: Query, wait_nanos: int = FOREVER) -> WaitingGet:
        pending = self.channel.begin(query, self.now)
        wake = self.channel.poll(pending, self.now)
        assert isinstance(wake, WakeAt)

        def note(outcome: Outcome) -> None:
            self.released.append(number)
            self.outcomes.append(outcome)

        return self.gets.add(pending, wake, wait_nanos, self.now, note)

    def put(self, time: int | None = None, duration: int = -1) -> None:
        times = None if time is None else (time,)
        outcome = self.channel.put(Offer(times=times, durations=(duration,), lengths=(1,)), self.now, lambda *_: b"")
        assert outcome.run is not None
        self.channel.polls = 0
        self.gets.changed(self.now)


class CountingChannel(ChannelCore):
    polls = 0

    def polling(self, pending: PendingGet, now: int) -> Pieces[ReadAnswer | WakeAt]:
        self.polls += 1
        return super().polling(pending, now)


def timers() -> int:
    """The number of timers that the event loop will still fire."""
    scheduled = asyncio.get_running_loop()._scheduled  # type: ignore[attr-defined]
    return sum(not handle.cancelled() for handle in scheduled)


async def test_ten_thousand_gets_cost_bounded_memory_and_end_in_the_order_of_their_arrival() -> None:
    blocked, before = BlockedGets(), timers()
    gc.collect()
    tracemalloc.start()
    try:
        for number in range(1000):
            blocked.block(number, NEWEST, FOREVER if number % 2 else 3600 * S)
        size, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert size / 1000 < COST_BYTES_MAX
    for number in range(1000, 10_000):
        blocked.block(number, NEWEST, FOREVER if number % 2 else 3600 * S)
    blocked.now += 1
    blocked.put()
    assert blocked.released == list(range(10_000))
    assert len(blocked.gets) == timers() - before == 0


async def test_gets_whose_time_ends_together_are_answered_a_few_in_a_turn_by_one_timer() -> None:
    blocked, before, many = BlockedGets(), timers(), 4 * LIMITS_PER_PIECE
    blocked.gets = WaitingGets(
        blocked.channel, ReachTracker(blocked.channel), lambda: blocked.now, begin=PieceScheduler().begin
    )
    gets = [blocked.block(number, NEWEST, 1) for number in range(many)]
    assert timers() - before == 1
    gets[many // 2].cancel()
    counts = [0]
    while counts[-1] < many - 1:
        await asyncio.sleep(0)
        counts.append(len(blocked.released))
    assert max(later - earlier for earlier, later in pairwise(counts)) <= LIMITS_PER_PIECE
    assert blocked.released == [number for number in range(many) if number != many // 2]
    assert all(isinstance(one, ReadAnswer) and one.reason is not None for one in blocked.outcomes)
    await asyncio.sleep(0)
    assert len(blocked.gets) == timers() - before == 0


async def test_a_put_does_not_look_at_gets_for_future_items() -> None:
    blocked = BlockedGets()
    for number in range(10_000):
        start = START + (number + 1) * S
        blocked.block(number, Query(interval=parse_interval(start, start + S), complete=bool(number % 2)))
    blocked.now += 1
    blocked.put()
    assert blocked.channel.polls == 0
    blocked.put(START + 3 * S + 1)
    # Get 0 gets the first item, whose span lasts until the second one. The interval of get 1 has ended.
    # Get 2 gets the second item.
    assert blocked.released == [0, 1, 2]
    assert blocked.channel.polls == 3
    run_to_end(blocked.gets.ending(Unavailable("gone")))
    assert blocked.released == list(range(10_000))


async def test_gets_that_end_together_are_freed_a_few_at_a_time() -> None:
    blocked, count = BlockedGets(), 20 * GETS_PER_PIECE
    kept = weakref.WeakSet(
        blocked.block(number, Query(interval=parse_interval(START + S, START + 2 * S)))._on_outcome
        for number in range(count)
    )
    left = [count]
    for _ in blocked.gets.ending(Unavailable("gone")):
        left.append(len(kept))
    assert max(before - after for before, after in pairwise([*left, len(kept)])) <= GETS_PER_PIECE + 1
    assert not kept


@pytest.mark.parametrize("match", [Match.START, Match.SPAN])
async def test_a_put_does_not_look_at_gets_between_the_newest_item_and_the_clock(match: Match) -> None:
    """In an earlier version, 2000 such gets cost each put 59 ms."""
    blocked = BlockedGets()
    blocked.now += 10_000 * S
    for number in range(2000):
        start = START + (number + 10) * S
        blocked.block(number, Query(interval=parse_interval(start, start + S), match=match))
    for second in range(9):
        blocked.put(START + second * S, duration=S)
    assert blocked.channel.polls == 0
    blocked.put(START + 10 * S + 1, duration=S // 2)
    assert blocked.released == [0]
    assert blocked.channel.polls == 1


async def test_a_late_put_does_not_look_at_gets_of_newer_items() -> None:
    blocked = BlockedGets()
    blocked.put(START)
    for number in range(1000):
        blocked.block(number, NEWEST)
    blocked.put(START - 5 * S)
    assert blocked.channel.polls == 0
    blocked.put(START + 1)
    assert len(blocked.released) == 1000


async def test_an_advance_wakes_only_the_gets_whose_interval_it_ends() -> None:
    blocked = BlockedGets()
    for number in range(1000):
        start = START + (number + 1) * S
        blocked.block(number, Query(interval=parse_interval(start, start + S, "[)"), complete=bool(number % 2)))
    blocked.channel.advance(START + 3 * S, blocked.now)
    blocked.channel.polls = 0
    blocked.gets.changed(blocked.now)
    assert blocked.released == [0, 1]
    assert blocked.channel.polls == 2


async def test_gets_that_one_put_ends_end_in_the_order_of_their_arrival() -> None:
    blocked = BlockedGets()
    for number, ahead in enumerate((9, 5, 7, 5, 60, 2)):
        blocked.block(number, Query(interval=parse_interval(START + ahead * S, MAX_INSTANT)))
    blocked.block(6, NEWEST)
    blocked.put(START + 10 * S)
    assert blocked.released == [0, 1, 2, 3, 5, 6]


async def test_an_item_whose_span_ends_in_the_future_releases_the_gets_within_the_span() -> None:
    blocked = BlockedGets()
    for number, ahead in enumerate((4, 6)):
        blocked.block(number, Query(interval=parse_interval(START + ahead * S, MAX_INSTANT)))
    blocked.put(START, duration=5 * S)
    assert blocked.released == [0]


def kept_gets() -> int:
    """Return how many waiting gets and pending gets this process still holds. Other tests may have left some."""
    gc.collect()
    return sum(isinstance(one, WaitingGet | PendingGet) for one in gc.get_objects())


async def test_cancelled_gets_are_removed_from_the_list_of_waiting_gets() -> None:
    blocked = BlockedGets()
    before, kept_before = timers(), kept_gets()
    ahead = Query(interval=parse_interval(START + S, MAX_INSTANT))
    gets = [blocked.block(number, (NEWEST, ahead)[number % 2], 3600 * S) for number in range(10_000)]
    assert timers() - before == 2, "one timer is for time limits, and one for instants"
    for get in gets:
        get.cancel()
        get.cancel()
    assert len(blocked.gets) == timers() - before == 0
    del get, gets
    assert kept_gets() == kept_before, "the cancelled gets are freed"
    blocked.put(START + 2 * S)
    assert blocked.released == []


async def test_the_number_of_waiting_gets_has_a_limit_and_a_cancelled_get_makes_room() -> None:
    blocked = BlockedGets()
    gets = [blocked.block(number, NEWEST) for number in range(WAITING_GETS_MAX)]
    with pytest.raises(Overloaded, match="20000 gets wait at the channel already"):
        blocked.block(WAITING_GETS_MAX, NEWEST)
    gets[7].cancel()
    blocked.block(WAITING_GETS_MAX, NEWEST)
    assert len(blocked.gets) == WAITING_GETS_MAX


class InPieces:
    """Collects long work, and does it a piece at a time."""

    def __init__(self, blocked: BlockedGets) -> None:
        self.work: list[Pieces[None]] = []
        blocked.gets = WaitingGets(
            blocked.channel, ReachTracker(blocked.channel), lambda: blocked.now, begin=self.work.append
        )  # fmt: skip

    def step(self) -> bool:
        return next(self.work[0], self) is not self


def bucket(time: int) -> Query:
    return Query(interval=parse_interval(time, time), match=Match.START)


def found_times(outcome: object) -> list[int]:
    assert isinstance(outcome, ReadAnswer), outcome
    return [part.first_time for part in outcome.slices]


@pytest.mark.parametrize("query", [bucket(START + S), NEWEST, replace(bucket(START + S), match=Match.SPAN)])
async def test_a_put_releases_very_many_gets_a_few_in_each_step_and_all_of_them(query: Query) -> None:
    blocked = BlockedGets(max_items=1)
    pieces = InPieces(blocked)
    for number in range(1000):
        blocked.block(number, query)
    blocked.put(START + S)
    assert blocked.channel.polls == 0, "no part of the work is done within the put"
    seen, steps = 0, 0
    while pieces.step():
        assert blocked.gets.looked_at - seen <= GETS_PER_PIECE
        seen, steps = blocked.gets.looked_at, steps + 1
        blocked.put(START + (steps + 1) * S)  # the former item leaves: the channel keeps one item
    assert blocked.released == list(range(1000))
    assert all(found_times(one) == [START + S] for one in blocked.outcomes)
    assert steps >= 1000 // GETS_PER_PIECE
    blocked.channel.collect(blocked.now)
    assert not blocked.channel.look(blocked.now)[0].has_backlog, "the channel keeps nothing more for these gets"


@pytest.mark.parametrize("gets", [GETS_PER_PIECE, 4 * GETS_PER_PIECE])
async def test_one_step_reads_a_bounded_number_of_slices_for_all_its_gets(gets: int) -> None:
    blocked = BlockedGets(max_items=1000)
    pieces = InPieces(blocked)
    held = 12 * SLICES_PER_LOOK
    for second in range(held):
        blocked.put(START + second)
    everything = Query(interval=parse_interval(START, START + held), match=Match.START, complete=True)
    for number in range(gets):
        blocked.block(number, everything)
    ended = [0]
    blocked.put(START + held + 1)
    ended.append(len(blocked.released))
    while pieces.step():
        ended.append(len(blocked.released))
    assert max(after - before for before, after in pairwise(ended)) <= GETS_PER_PIECE // 12 + 1
    assert blocked.released == list(range(gets))
    assert all(len(found_times(one)) == held for one in blocked.outcomes)


async def test_gets_that_one_change_does_not_release_are_released_by_the_next_one() -> None:
    blocked = BlockedGets(max_items=1)
    pieces = InPieces(blocked)
    for number in range(200):
        blocked.block(number, replace(NEWEST, newer_than=Position(START + S)))
        blocked.block(1000 + number, NEWEST)
    blocked.put(START + S)  # releases every second get
    blocked.put(START + 2 * S)
    blocked.block(9, replace(NEWEST, newer_than=Position(START + 2 * S)))
    blocked.put(START + 3 * S)
    while pieces.step():
        pass
    times = dict(zip(blocked.released, map(found_times, blocked.outcomes), strict=True))
    assert times == {n: [START + 2 * S] for n in range(200)} | {1000 + n: [START + S] for n in range(200)} | {
        9: [START + 3 * S]
    }


async def test_a_get_that_was_released_before_its_timeout_has_the_released_item() -> None:
    blocked = BlockedGets(max_items=1)
    pieces = InPieces(blocked)
    gets = [blocked.block(number, bucket(START + S), 3600 * S) for number in range(100)]
    blocked.put(START + S)
    blocked.put(START + 2 * S)
    blocked.gets._give_up(gets[-1])
    assert found_times(blocked.outcomes[0]) == [START + S]
    while pieces.step():
        pass
    assert len(blocked.released) == 100


async def test_gets_that_one_instant_releases_have_one_timer_and_are_looked_at_in_pieces() -> None:
    blocked, before = BlockedGets(), timers()
    pieces = InPieces(blocked)
    blocked.put(START)
    for number in range(1000):
        blocked.block(number, Query(interval=parse_interval(START + S, START + S)))
    assert timers() - before == 1
    blocked.now += S
    timer = blocked.gets._timer
    assert timer is not None
    timer.cancel()
    blocked.gets._fire()
    while pieces.step():
        pass
    assert blocked.released == list(range(1000))
    assert timers() == before


async def test_changes_that_arrive_faster_than_gets_are_released_are_kept_up_to_a_limit() -> None:
    blocked = BlockedGets(max_items=1)
    pieces = InPieces(blocked)
    for number in range(500):
        blocked.block(number, NEWEST)
    for number in range(500, 510):
        blocked.block(number, replace(NEWEST, newer_than=Position(START + 20 * (number - 500) * S)))
    for second in range(1, 101):
        blocked.put(START + second * S)
    assert len(blocked.gets._releases) == RELEASES_MAX
    while pieces.step():
        pass
    times = dict(zip(blocked.released, map(found_times, blocked.outcomes), strict=True))
    first = {501: 21, 502: 41, 503: 61, 504: 100}
    assert times == {n: [START + first.get(n, 1) * S] for n in (*range(501), *first)}
    assert len(blocked.gets) == 5
    assert not blocked.gets._releases
