"""What happens in a story of one channel behind a path: a policy, then a step for each number."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from hypothesis import note

from stampede_rt.model import Policy
from stampede_rt.timeline import MAX_INSTANT, MIN_INSTANT, Bound, Interval, Match, MetaTime
from stampede_rt_channel_host.core.channel import Offer, Position, Query
from tests.property.dice import Dice
from tests.property.loopback_host import LoopbackHost
from tests.property.path_pair import MOMENT_S, PathPair
from tests.property.path_values import merge
from tests.property.surfaces import Surface

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
    Policy(),
)
CHANGES = (
    Policy(max_age_nanos=30),
    Policy(max_items=2),
    Policy(max_age_nanos=5, max_items=6),
    Policy(max_age_nanos=8, on_full="block"),
    Policy(on_full="reject"),
    Policy(on_full="drop_oldest"),
    Policy(max_bytes=300),
    Policy(max_future_nanos=3),
)
DURATIONS = (None, 0, 1, 3, 7, 2**62, MAX_INSTANT)
LENGTHS = (8, 0, 40, 64, 500)
GETS_MAX, PUTS_MAX, SUBSCRIPTIONS_MAX = 3, 2, 3
DISTANT = 10**6


def a_time(dice: Dice, pair: PathPair) -> int:
    """Near the newest item, near the clock on either side, near the edge of what is kept, or far off."""
    newest, oldest = pair.oracle.newest or pair.clock, pair.oracle.oldest or pair.clock
    cutoff = pair.clock - min(pair.oracle.max_age or 0, 100)
    around = dice.pick((pair.clock, newest, oldest, cutoff, pair.clock))
    return around + dice.pick((0, 1, -1, 2, 3, -3, 5, -6, 8, 9, -12, -21, DISTANT, -DISTANT))


def an_offer(dice: Dice, pair: PathPair) -> Offer:
    items = dice.pick((2, 1, 3, 6))
    times = None if dice.one_in(6) else [a_time(dice, pair) for _ in range(items)]
    if times is not None and dice.below(2):
        times.sort()
    durations = [dice.pick(DURATIONS) for _ in range(items)] if dice.below(2) else None
    column = None if durations is None else [-1 if one is None else one for one in durations]
    return Offer(times=times, durations=column, lengths=[dice.pick(LENGTHS) for _ in range(items)])


def a_bound(dice: Dice, pair: PathPair) -> Bound:
    meta = dice.pick((None, MetaTime.NOW, MetaTime.NEWEST, MetaTime.OLDEST, None))
    if meta is None:
        return Bound(None, dice.pick((MIN_INSTANT, MAX_INSTANT)) if dice.one_in(6) else a_time(dice, pair))
    return Bound(meta, dice.pick((0, -1, 1, -4, 4, -15, 15)))


def a_position(dice: Dice, pair: PathPair) -> Position | None:
    kind = dice.below(6)
    if kind == 1:
        return Position(a_time(dice, pair))
    return an_item_position(dice, pair) if kind == 2 else None


def an_item_position(dice: Dice, pair: PathPair) -> Position | None:
    if not pair.oracle.log:
        return None
    item = pair.oracle.log[1 + dice.below(len(pair.oracle.log))]
    return Position(item.time, item.seq)


def a_query(dice: Dice, pair: PathPair) -> Query:
    start, end = a_bound(dice, pair), a_bound(dice, pair)
    if start.meta is None and end.meta is None and start.offset > end.offset:
        start, end = end, start
    return Query(
        interval=Interval(start, end, bool(dice.below(2)), bool(dice.below(2))),
        match=dice.pick(tuple(Match)),
        limit=dice.pick((None, 1, 2, 3)),
        newest_first=bool(dice.below(2)),
        complete=bool(dice.below(2)),
        after=a_position(dice, pair),
    )


def put(dice: Dice, pair: PathPair) -> None:
    time = None if dice.one_in(5) else a_time(dice, pair)
    timeout = dice.pick((None, 0.0, None, MOMENT_S))
    waits_for_time = any(book.wake_at(pair.reader()) is not None for _, _, book, _ in pair.gets)
    if waits_for_time or len(pair.line) >= PUTS_MAX:
        timeout = 0.0  # which of a get and a put is looked at first when an instant comes is not said
    if pair.line and time is None:
        timeout = 0.0  # nor whether one behind another waits since it came or since it is the first
    pair.put_one(time, dice.pick(DURATIONS), dice.pick(LENGTHS), timeout)


def put_run(dice: Dice, pair: PathPair) -> None:
    pair.put_run(an_offer(dice, pair))


def get(dice: Dice, pair: PathPair) -> None:
    pair.get(a_query(dice, pair), payloads=bool(dice.below(3)), waits_s=MOMENT_S if dice.one_in(6) else 0)


def begin(dice: Dice, pair: PathPair) -> None:
    query = a_query(dice, pair)
    if len(pair.gets) < GETS_MAX and not (pair.line and pair.may_block_on_time(query)):
        pair.begin(query, payloads=bool(dice.below(3)))


def named_reads(dice: Dice, pair: PathPair) -> None:
    pair.named_reads(a_time(dice, pair), a_position(dice, pair))


def refused_interval(dice: Dice, pair: PathPair) -> None:
    pair.refused_interval(a_time(dice, pair), a_time(dice, pair))


def tick(dice: Dice, pair: PathPair) -> None:
    pair.tick(dice.pick((1, 2, 0, 5, 9, 30, 1000)))


def step_clock(dice: Dice, pair: PathPair) -> None:
    """Somebody sets the machine's clock; the next ticks bend towards it."""
    pair.tick(dice.pick((4, 10)), wall_step=dice.pick((3600, -3600)) * 10**9)


def advance(dice: Dice, pair: PathPair) -> None:
    pair.advance(min(a_time(dice, pair), pair.clock))


def configure(dice: Dice, pair: PathPair) -> None:
    change = dice.pick(CHANGES)
    merged = merge(pair.policy, change)
    if merged.on_full != "block" or merged.max_age_nanos is not None:
        pair.configure(change)


def subscribe(dice: Dice, pair: PathPair) -> None:
    kind = dice.below(3)
    after = an_item_position(dice, pair) if kind == 2 else None
    start = a_bound(dice, pair) if kind == 1 else None
    if len(pair.followers) < SUBSCRIPTIONS_MAX:
        pair.subscribe(start, after, newest=bool(dice.below(2)))


def rest(dice: Dice, pair: PathPair) -> None:
    """Nothing happens: what a step shrinks to."""


Step = Callable[[Dice, PathPair], None]
STEPS: tuple[Step, ...] = (
    rest, put, get, put_run, tick, get, begin, put, subscribe, put, advance, configure, get, named_reads, put_run,
    begin, put, tick, step_clock, refused_interval,
)  # fmt: skip


def play(surface: Surface, host: LoopbackHost, numbers: Sequence[int]) -> None:
    """One story."""
    pair = PathPair(surface, host, Dice(numbers[0]).pick(POLICIES))
    try:
        for number in numbers[1:]:
            dice = Dice(number)
            step = dice.pick(STEPS)
            note(step.__name__)
            step(dice, pair)
    finally:
        pair.end()
