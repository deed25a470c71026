"""Draws for the scenarios of a channel: policies, offers, queries and positions, for any path."""

from __future__ import annotations

from typing import Protocol

from stampede_rt.values.model import Policy
from stampede_rt.values.timeline import MAX_INSTANT, MIN_INSTANT, Bound, Interval, Match, MetaTime
from stampede_rt_channel_host.core.channel import Offer, Position, Query
from tests.oracle import OracleChannel
from tests.property.random_source import RandomSource

POLICIES = (
    Policy(max_age_nanos=20, max_future_nanos=8),
    Policy(max_items=4, max_future_nanos=8),
    Policy(max_bytes=400, max_future_nanos=8),
    Policy(max_age_nanos=12, max_items=5, max_bytes=500, max_future_nanos=8),
    Policy(max_age_nanos=20, max_items=3, max_future_nanos=8, on_full="block"),
    Policy(max_items=3, max_future_nanos=8, on_full="reject"),
    Policy(max_age_nanos=9, max_bytes=400, max_future_nanos=8, on_full="block"),
    Policy(max_age_nanos=9, max_bytes=400, max_items=6, max_future_nanos=8, on_full="reject"),
    Policy(max_age_nanos=1, max_future_nanos=0),
    Policy(consumers=2, max_future_nanos=8),
    Policy(consumers=1, max_items=2, max_future_nanos=8, on_full="block"),
    Policy(consumers=2, max_age_nanos=15, max_bytes=500, max_future_nanos=8),
    Policy(consumers=3, max_items=4, max_future_nanos=8, on_full="reject"),
    Policy(consumers=2, max_items=3, max_age_nanos=20, max_future_nanos=8, on_full="block"),
    Policy(max_age_nanos=6, max_age_unconsumed_nanos=25, max_future_nanos=8),
    Policy(max_age_nanos=6, max_age_unconsumed_nanos=25, max_items=4, max_future_nanos=8, on_full="block"),
    Policy(max_age_nanos=6, max_age_unconsumed_nanos=25, consumers=2, max_bytes=500, max_future_nanos=8),
    Policy(max_age_nanos=9, max_future_nanos=8, overlap_nanos=5),
    Policy(max_items=4, max_age_nanos=12, max_future_nanos=8, on_full="block", overlap_nanos=3),
    Policy(max_items=4, max_future_nanos=8, overlap_nanos=9),
    Policy(consumers=2, max_age_nanos=15, max_bytes=500, max_future_nanos=8, overlap_nanos=4),
    Policy(),
)
DURATIONS = (None, 0, 1, 3, 7, 2**62, MAX_INSTANT)
LENGTHS = (8, 0, 40, 64, 500)
RUN_LENGTHS = (1, 2, 1, 3, 6)
LEASES = (10, 3, 40, 0, 10**6)
TICKS = (1, 2, 0, 5, 9, 30, 1000)
CONSUMERS = (1, 2, 3, 4)
LOOKED_BACK_MAX = 100


class RunningScenario(Protocol):
    """A running scenario: the host's clock, and the oracle's channel."""

    clock: int
    oracle: OracleChannel


def a_time(rng: RandomSource, scenario: RunningScenario) -> int:
    """A time near the newest item, near the clock on either side, near the edge of the held items, or far off."""
    newest, oldest = scenario.oracle.newest or scenario.clock, scenario.oracle.oldest or scenario.clock
    cutoff = scenario.clock - min(scenario.oracle.max_age or 0, LOOKED_BACK_MAX)
    around = rng.pick((scenario.clock, newest, oldest, cutoff, scenario.clock))
    distant = rng.pick((10**6, -(10**6), 10**6, -(10**10), 10**10))
    return around + rng.pick((0, 1, -1, 2, 3, -3, 5, -6, 8, 9, -12, -21, distant))


def an_offer(rng: RandomSource, scenario: RunningScenario) -> Offer:
    """A run in any order, most of them small. The host gives the items their time, or each item has its own."""
    items = rng.pick((40, 17)) if rng.one_in(30) else rng.pick(RUN_LENGTHS)
    times = None if rng.one_in(6) else [a_time(rng, scenario) for _ in range(items)]
    if times is not None and rng.below(2):
        times.sort()
    durations = [rng.pick(DURATIONS) for _ in range(items)] if rng.below(2) else None
    column = None if durations is None else [-1 if one is None else one for one in durations]
    return Offer(times=times, durations=column, lengths=[rng.pick(LENGTHS) for _ in range(items)])


def a_bound(rng: RandomSource, scenario: RunningScenario) -> Bound:
    """A bound: any instant, or any meta-time with a small offset."""
    meta = rng.pick((None, MetaTime.NOW, MetaTime.NEWEST, MetaTime.OLDEST, None))
    if meta is None:
        return Bound(None, rng.pick((MIN_INSTANT, MAX_INSTANT)) if rng.one_in(6) else a_time(rng, scenario))
    return Bound(meta, rng.pick((0, -1, 1, -4, 4, -15, 15)))


def a_position(rng: RandomSource, scenario: RunningScenario) -> Position | None:
    """A position: mostly none, or an instant, or an item that is or was in the channel."""
    kind = rng.below(6)
    if kind == 1:
        return Position(a_time(rng, scenario))
    return an_item_position(rng, scenario) if kind == 2 else None


def an_item_position(rng: RandomSource, scenario: RunningScenario) -> Position | None:
    """The position of any item that is or was in the channel."""
    if not scenario.oracle.log:
        return None
    item = scenario.oracle.log[1 + rng.below(len(scenario.oracle.log))]
    return Position(item.time, item.seq)


def a_query(rng: RandomSource, scenario: RunningScenario) -> Query:
    """Any read of items between two bounds."""
    start, end = a_bound(rng, scenario), a_bound(rng, scenario)
    if start.meta is None and end.meta is None and start.offset > end.offset:
        start, end = end, start
    return Query(
        interval=Interval(start, end, bool(rng.below(2)), bool(rng.below(2))),
        match=rng.pick(tuple(Match)),
        limit=rng.pick((None, 1, 2, 3)),
        newest_first=bool(rng.below(2)),
        complete=bool(rng.below(2)),
        after=a_position(rng, scenario),
    )


def an_offer_in_order(rng: RandomSource, scenario: RunningScenario) -> Offer:
    """A run of items after the newest item. Most producers put such runs."""
    time, items = max(scenario.clock, scenario.oracle.newest or 0), rng.pick((1, 1, 3))
    steps = [rng.pick((0, 1, 2)) for _ in range(items)]
    times = [time + sum(steps[: at + 1]) for at in range(items)]
    durations = [rng.pick((-1, 0, 1, 7)) for _ in range(items)] if rng.below(2) else None
    return Offer(times=times, durations=durations, lengths=[rng.pick((8, 0, 40))] * items)


def a_query_near_the_newest(rng: RandomSource, scenario: RunningScenario) -> Query | None:
    """A read of the last few items, if there are any."""
    held = scenario.oracle.held[-6:]
    if not held:
        return None
    start, end = sorted(rng.pick(held).time + rng.pick((0, 1, -1)) for _ in range(2))
    bound = Bound(MetaTime.NOW, 0) if rng.one_in(3) else Bound(None, end)
    interval = Interval(Bound(None, start), bound, bool(rng.below(2)), bool(rng.below(2)))
    match = rng.pick((Match.SPAN, Match.START, Match.WHOLE))
    limit, newest_first = rng.pick((None, 1, 2)), bool(rng.below(2))
    return Query(interval=interval, match=match, limit=limit, newest_first=newest_first, complete=rng.one_in(4))


def some_seqs(rng: RandomSource, scenario: RunningScenario) -> list[int]:
    """The seqs of all held items, of the oldest or the newest ones, or of any items that ever existed; perhaps none."""
    held, kind = [item.seq for item in scenario.oracle.held], rng.below(4)
    ever = len(scenario.oracle.log)
    return (held, held[:2], held[-1:], [1 + rng.below(ever) for _ in range(2) if ever])[kind]
