"""The random steps of a test of one channel behind a path: first a policy, then one step for each number.

The same steps run on every surface (`surfaces`, `core_surface`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from stampede_rt.values.model import Policy
from stampede_rt.values.timeline import Bound, Interval, MetaTime
from tests.oracle.runs import KEPT_NANOS
from tests.property.draws import (
    CONSUMERS,
    DURATIONS,
    LEASES,
    LENGTHS,
    POLICIES,
    TICKS,
    a_bound,
    a_position,
    a_query,
    a_query_near_the_newest,
    a_time,
    an_item_position,
    an_offer,
    an_offer_in_order,
    some_seqs,
)
from tests.property.paths.pair import PathPair
from tests.property.paths.path_and_oracle import SteeredHost
from tests.property.paths.surfaces import Surface
from tests.property.random_source import RandomSource

CHANGES = (
    Policy(max_age_nanos=30),
    Policy(max_items=2),
    Policy(max_age_nanos=5, max_items=6),
    Policy(max_age_nanos=8, on_full="block"),
    Policy(on_full="reject"),
    Policy(on_full="drop_oldest"),
    Policy(max_bytes=300),
    Policy(max_future_nanos=3),
    Policy(on_full="block"),
    Policy(consumers=2),
    Policy(consumers=1),
    Policy(max_age_unconsumed_nanos=15),
    Policy(max_age_nanos=6, max_age_unconsumed_nanos=25),
)
GETS_MAX, PUTS_MAX, SUBSCRIPTIONS_MAX = 3, 2, 3
MOMENT_S = 0.002


def may_wait(pair: PathPair) -> bool:
    """Whether a further call may wait for an instant.

    The product does not say whether it first looks at a get or at a put when an instant comes. So only one of them may
    wait for it.
    """
    waits_for_time = any(predictor.wake_at(pair.reader()) is not None for _, _, predictor, _ in pair.gets)
    return not waits_for_time and len(pair.line) < PUTS_MAX


def put(rng: RandomSource, pair: PathPair) -> None:
    time = None if rng.one_in(5) else a_time(rng, pair)
    timeout = rng.pick((None, 0.0, None, MOMENT_S))
    if not may_wait(pair):
        timeout = 0.0
    pair.put_one(rng.below(len(pair.handles)), time, rng.pick(DURATIONS), rng.pick(LENGTHS), timeout)


def put_run(rng: RandomSource, pair: PathPair) -> None:
    producer_id, waits = rng.pick((1, 0, 2)), rng.below(3) > 0
    pair.put_run(an_offer(rng, pair), producer_id, waits=waits and may_wait(pair))


def put_in_order(rng: RandomSource, pair: PathPair) -> None:
    pair.put_run(an_offer_in_order(rng, pair), 0, waits=False)
    pair.tick(rng.pick((0, 1, 2, 3)))


def read_near_the_newest(rng: RandomSource, pair: PathPair) -> None:
    query = a_query_near_the_newest(rng, pair)
    if query is not None:
        pair.get(query)


def put_again(rng: RandomSource, pair: PathPair) -> None:
    """Repeat one of the last runs or any run, or put a run with wrong numbers."""
    if not pair.sent:
        return
    former = pair.sent[rng.pick((-1, rng.below(len(pair.sent))))]
    if rng.one_in(5):
        pair.put_overlapping(former)
    elif may_wait(pair) or not former.waits:
        pair.put_again(former)


def break_stream(rng: RandomSource, pair: PathPair) -> None:
    """Break a producer's stream while its run waits. Most producers then repeat the run."""
    entries = [entry for entry in pair.line if entry.run.first_number]
    if not entries:
        return
    entry = rng.pick(entries)
    if sum(one.run is entry.run for one in pair.line) == 1:
        pair.break_stream(entry)
        if rng.below(3) and may_wait(pair):
            pair.put_again(entry.run)


def get(rng: RandomSource, pair: PathPair) -> None:
    pair.get(a_query(rng, pair), payloads=bool(rng.below(3)), waits_s=MOMENT_S if rng.one_in(6) else 0)


def pages(rng: RandomSource, pair: PathPair) -> None:
    pair.pages(replace(a_query(rng, pair), limit=rng.pick((2, 1, 3))))


def around_now(rng: RandomSource, pair: PathPair) -> None:
    """Read exactly at now, just before it and just after it: as NOW and as an instant, inclusive and exclusive."""
    start, end = ((MetaTime.NOW, pair.reader().channel.now(pair.clock))[rng.below(2)] for _ in range(2))
    offsets = rng.pick((0, -1, 1)), rng.pick((0, 1, -1))
    query = a_query(rng, pair)
    bounds = [
        Bound(anchor, by) if isinstance(anchor, MetaTime) else Bound(None, anchor + by)
        for anchor, by in zip((start, end), offsets, strict=True)
    ]
    if all(bound.meta is None for bound in bounds):
        bounds.sort(key=lambda bound: bound.offset)
    interval = Interval(*bounds, query.interval.start_exclusive, query.interval.end_exclusive)
    pair.get(replace(query, interval=interval, after=None))


def begin(rng: RandomSource, pair: PathPair) -> None:
    query = a_query(rng, pair)
    if len(pair.gets) < GETS_MAX and not (pair.line and pair.may_block_on_time(query)):
        pair.begin(query, payloads=bool(rng.below(3)))


def named_reads(rng: RandomSource, pair: PathPair) -> None:
    pair.named_reads(a_bound(rng, pair), a_position(rng, pair))


def refused_interval(rng: RandomSource, pair: PathPair) -> None:
    pair.refused_interval(a_time(rng, pair), a_time(rng, pair))


def tick(rng: RandomSource, pair: PathPair) -> None:
    pair.tick(rng.pick((*TICKS, 2 * 10**6)))


def forget(rng: RandomSource, pair: PathPair) -> None:
    """Let time pass until the host forgets runs.

    No call may wait meanwhile, because its timer would use real time.
    """
    if rng.below(2) and not (pair.line or pair.gets or pair.keeps_a_place):
        pair.tick(KEPT_NANOS + rng.pick((0, -1, 1)))


def step_clock(rng: RandomSource, pair: PathPair) -> None:
    """Set the machine's clock. The host's clock approaches it in the next ticks."""
    pair.tick(rng.pick((4, 10)), wall_step=rng.pick((3600, -3600)) * 10**9)


def advance(rng: RandomSource, pair: PathPair) -> None:
    instant = a_time(rng, pair)
    pair.advance(instant if rng.one_in(4) else min(instant, pair.clock))


def configure(rng: RandomSource, pair: PathPair) -> None:
    pair.configure(rng.pick(CHANGES))


def consume(rng: RandomSource, pair: PathPair) -> None:
    """Consume as one of four consumers with leases of any length, or by a client, which renews its own lease."""
    seqs = some_seqs(rng, pair)
    if rng.one_in(6):
        pair.consume_by_client(seqs)
    else:
        pair.consume(rng.pick(CONSUMERS), seqs, rng.pick(LEASES))


def subscribe(rng: RandomSource, pair: PathPair) -> None:
    kind = rng.below(3)
    after = an_item_position(rng, pair) if kind == 2 else None
    start = a_bound(rng, pair) if kind == 1 else None
    if len(pair.followers) < SUBSCRIPTIONS_MAX:
        pair.subscribe(start, after, newest=bool(rng.below(2)))


def rest(rng: RandomSource, pair: PathPair) -> None:
    """Do nothing. Hypothesis replaces steps by this one when it shortens a failing test."""


Step = Callable[[RandomSource, PathPair], None]
STEPS: tuple[Step, ...] = (
    rest, put, get, put_run, tick, get, begin, put, subscribe, put, advance, configure, pages, named_reads, put_run,
    begin, put, tick, step_clock, refused_interval, put_again, consume, around_now, put_run, forget,
    break_stream, put_in_order, read_near_the_newest, put_in_order, read_near_the_newest,
)  # fmt: skip


STEPS_NEAR_THE_NEWEST: tuple[Step, ...] = (
    rest, put_in_order, subscribe, put_in_order, read_near_the_newest, tick, put_in_order, subscribe,
)  # fmt: skip
"""The newest items change and are read. Rings in shared memory answer most of these reads."""


def play(
    surface: Surface,
    host: SteeredHost,
    numbers: Sequence[int],
    report: Callable[[str], None],
    steps: Sequence[Step] = STEPS,
) -> None:
    """Run the steps that `numbers` choose among `steps`. `report` gets their names."""
    pair = PathPair(surface, host, RandomSource(numbers[0]).pick(POLICIES))
    try:
        for number in numbers[1:]:
            rng = RandomSource(number)
            counts = pair.oracle.consumers is not None
            step = consume if counts and rng.one_in(4) else rng.pick(steps)
            report(step.__name__)
            step(rng, pair)
    finally:
        pair.end()
