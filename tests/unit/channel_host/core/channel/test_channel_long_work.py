"""What a step looks at does not grow with what the channel holds; what must grow comes in pieces."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from itertools import pairwise
from typing import Any

import pytest

from stampede_rt.values.model import Policy
from stampede_rt.values.timeline import MAX_INSTANT, MIN_INSTANT, Match, parse_interval
from stampede_rt_channel_host.core.channel import (
    ChannelCore,
    Coming,
    Position,
    Query,
    ReadAnswer,
    Slice,
    abandoning,
    emptying,
    index,
    pieces,
    seq_set,
    subscribing,
)
from stampede_rt_channel_host.core.channel.consumption import LEASE_NANOS, RANGES_PER_LOOK_MAX, Consumers
from stampede_rt_channel_host.core.channel.index import FIRST_KEY
from stampede_rt_channel_host.core.channel.pieces import run_to_end
from stampede_rt_channel_host.core.channel.retention import CONSUMERS_ASKED_MAX, SLICES_AGED_MAX, SLICES_USED_UP_MAX
from stampede_rt_channel_host.core.channel.span_ends import SLICES_MAX
from stampede_rt_channel_host.core.channel.tally import BLOCK_ITEMS
from tests.support.channel_host.channel_cores import CLOCK, a_channel, put

ITEMS = 20_000


class Counter:
    """How many slices of any index were looked at."""

    def __init__(self) -> None:
        self.slices = 0


@pytest.fixture
def looked(monkeypatch: pytest.MonkeyPatch) -> Counter:
    counter, clipped = Counter(), index._clipped
    slices_from = index.ChannelIndex.slices_from

    def counting(*args: Any) -> Iterator[Slice]:
        counter.slices += 1
        yield from clipped(*args)

    def counting_from(self: index.ChannelIndex, floor: index.ItemKey) -> Iterator[Slice]:
        for part in slices_from(self, floor):
            counter.slices += 1
            yield part

    monkeypatch.setattr(index, "_clipped", counting)
    monkeypatch.setattr(index.ChannelIndex, "slices_from", counting_from)
    return counter


def filled(items: int = ITEMS, **policy: Any) -> ChannelCore:
    """One run for each item, in order."""
    channel = a_channel(**policy)
    for time in range(items):
        put(channel, CLOCK + time)
    return channel


def shuffled(items: int = ITEMS) -> ChannelCore:
    """Runs of 200 items, each of which every other one splits: as when two producers interleave."""
    channel = a_channel()
    for first in range(0, items, 400):
        for odd in (0, 1):
            put(channel, *(CLOCK + first + at for at in range(odd, 400, 2)))
    return channel


def everything(**fields: Any) -> Query:
    return Query(interval=parse_interval(MIN_INSTANT, MAX_INSTANT), **fields)


@pytest.mark.parametrize("newest_first", [False, True])
def test_a_get_of_many_slices_comes_in_pieces_of_a_bounded_number(looked: Counter, newest_first: bool) -> None:
    channel, most = shuffled(), 0
    looked.slices = 0
    reading = channel.reading(everything(newest_first=newest_first), CLOCK)

    def counting() -> pieces.Pieces[ReadAnswer]:
        nonlocal most
        while True:
            before = looked.slices
            try:
                next(reading)
            except StopIteration as end:
                return end.value  # type: ignore[no-any-return]
            most = max(most, looked.slices - before)
            yield

    assert sum(part.items for part in pieces.run_to_end(counting()).slices) == ITEMS
    assert most <= pieces.STEPS_PER_PIECE + 10


def test_a_subscription_from_the_oldest_item_on_begins_in_pieces(looked: Counter) -> None:
    channel = filled()
    looked.slices = 0
    opening = channel.subscribing_all(CLOCK, start=parse_interval(MIN_INSTANT, MAX_INSTANT).start)
    next(opening)
    assert looked.slices <= pieces.STEPS_PER_PIECE + 10


def test_a_part_of_a_subscription_holds_a_bounded_number_of_slices() -> None:
    channel = filled()
    cursor = channel.subscribe_all(CLOCK, start=parse_interval(MIN_INSTANT, MAX_INSTANT).start)
    assert len(channel.since(cursor, CLOCK, 2**30).slices) == pieces.STEPS_PER_PIECE


@pytest.mark.parametrize("policy", [Policy(max_items=10), Policy(max_bytes=10 * (64 + 10))])
def test_a_smaller_limit_walks_hardly_more_than_a_block(looked: Counter, policy: Policy) -> None:
    channel = filled()
    looked.slices = 0
    channel.configure(policy, CLOCK)
    assert channel.counters(CLOCK).held == 10
    assert looked.slices <= 2 * BLOCK_ITEMS + 20


def test_a_put_after_a_smaller_limit_frees_a_bounded_number_of_entries() -> None:
    channel = filled()
    channel.configure(Policy(max_bytes=10 * (64 + 10)), CLOCK)
    held, _ = channel.look(CLOCK)
    before = len(held.index)
    put(channel, CLOCK + ITEMS)
    assert before - 3000 < len(held.index) < before - 1000
    while channel.collect(CLOCK):
        pass
    assert len(held.index) <= 11


def test_a_page_in_a_bucket_of_equal_times_costs_the_page(looked: Counter) -> None:
    channel = a_channel()
    for _ in range(ITEMS):
        put(channel, CLOCK)
    for query in (
        everything(limit=100, after=Position(CLOCK, ITEMS // 2)),
        everything(limit=100, after=Position(CLOCK, ITEMS // 2), newest_first=True),
        everything(limit=100, match=Match.START, newer_than=Position(CLOCK, ITEMS // 2)),
    ):
        looked.slices = 0
        assert sum(part.items for part in channel.read(query, CLOCK).slices) == 100
        assert looked.slices <= 150


@pytest.mark.parametrize("durations", [None, [5]])
def test_how_far_a_channel_has_come_is_known_without_a_walk(looked: Counter, durations: list[int] | None) -> None:
    channel = a_channel()
    for _ in range(ITEMS):
        put(channel, CLOCK, durations=durations)
    coming = Coming(channel)
    coming.begin()
    put(channel, CLOCK, durations=durations)
    looked.slices = 0
    assert coming.reach(CLOCK).end == (CLOCK if durations is None else CLOCK + 5)
    assert looked.slices <= 1


def test_late_items_that_crowd_a_block_split_it(looked: Counter) -> None:
    channel = filled(2 * BLOCK_ITEMS + 10, max_age_nanos=10**6)
    for time in range(ITEMS):
        put(channel, CLOCK - ITEMS + time)
    looked.slices = 0
    channel.configure(Policy(max_items=10), CLOCK)
    assert looked.slices <= 2 * BLOCK_ITEMS + 20


def test_the_newest_item_of_a_full_bucket_is_found_at_once(looked: Counter) -> None:
    channel = a_channel()
    for _ in range(ITEMS):
        put(channel, CLOCK)
    cursor = channel.subscribe_newest(CLOCK, start=parse_interval(MIN_INSTANT, MAX_INSTANT).start)
    looked.slices = 0
    assert channel.latest(cursor, CLOCK) is not None
    assert channel.latest(cursor, CLOCK) is None
    assert looked.slices <= 20


def test_ageing_of_what_consumers_have_consumed_looks_at_a_bounded_number_of_slices(looked: Counter) -> None:
    channel = a_channel(max_age_nanos=10**6, max_age_unconsumed_nanos=10**12)
    channel.consume(1, [], CLOCK)
    for time in range(ITEMS):
        put(channel, CLOCK + time)
    for first in range(1, ITEMS, 4000):
        channel.consume(1, range(first, first + 4000), CLOCK)
    later, most, before = CLOCK + 10**7, 0, ITEMS
    while True:
        looked.slices = 0
        more = channel.collect(later)
        most, held = max(most, looked.slices), channel.look(later)[0].items
        assert held < before or held == 1
        before = held
        if not more:
            break
    assert before == 1
    assert most <= 2 * SLICES_AGED_MAX + 2 * BLOCK_ITEMS + 20


def test_a_bucket_of_many_equal_times_that_consumers_may_owe_is_looked_through_a_part_at_a_time(
    looked: Counter,
) -> None:
    """With 100,000 items a look took 0.3 s, and a put 0.9 s."""
    channel = a_channel(max_age_nanos=10**6, max_age_unconsumed_nanos=10**12)
    channel.consume(1, [], CLOCK)
    for _ in range(ITEMS):
        put(channel, CLOCK)
    put(channel, CLOCK + 1)
    for first in range(1, ITEMS, 4000):
        channel.consume(1, range(first, min(ITEMS, first + 4000)), CLOCK)
    most, later = 0, CLOCK + 10**7

    def look(work: Callable[[], object]) -> None:
        nonlocal most
        looked.slices = 0
        work()
        most = max(most, looked.slices)

    look(lambda: channel.next_deadline(CLOCK))
    look(lambda: put(channel, CLOCK + 2))
    for _ in range(ITEMS // SLICES_AGED_MAX):
        look(lambda: channel.collect(later))
        look(lambda: channel.next_deadline(later))
    look(lambda: channel.consume(2, [], later))  # it owes what the other has consumed
    for _ in range(2 * ITEMS // SLICES_AGED_MAX):
        look(lambda: channel.collect(later))
    assert channel.look(later)[0].items == ITEMS + 2, "one item of the bucket is owed"
    for first in range(1, ITEMS + 1, 4000):
        for consumer in (1, 2):
            look(partial(channel.consume, consumer, range(first, first + 4000), later))
    while channel.collect(later):
        look(lambda: channel.next_deadline(later))
    assert channel.look(later)[0].items == 2, "those behind the bucket are owed, or the newest"
    assert most <= 4 * SLICES_AGED_MAX + 4 * BLOCK_ITEMS


def test_what_very_many_consumers_have_consumed_out_of_order_goes_after_a_bounded_number_of_looks_at_them() -> None:
    """1024 consumers were all looked at for each of 64 slices."""
    consumers, items = 300, 40
    channel = a_channel(consumers=consumers)
    for time in reversed(range(items)):
        put(channel, CLOCK + time)
    counted, most = channel.look(CLOCK)[1].consumers, 0
    assert counted is not None
    for consumer in range(1, consumers + 1):
        before = counted.looked_at
        channel.consume(consumer, range(2, items + 1), CLOCK)  # the first seq is that of the newest item
        most = max(most, counted.looked_at - before)
    more = True
    while more:
        before = counted.looked_at
        more = channel.collect(CLOCK)
        most = max(most, counted.looked_at - before)
    assert channel.look(CLOCK)[0].items == 1
    assert most <= 2 * (CONSUMERS_ASKED_MAX + consumers)


@pytest.mark.parametrize("newest_first", [False, True])
def test_a_large_answer_that_nobody_wants_is_let_go_of_in_pieces(newest_first: bool) -> None:
    answer = shuffled().read(everything(newest_first=newest_first), CLOCK)
    left = [ITEMS]
    for _ in emptying(answer.slices):
        left.append(len(answer.slices))
    assert max(before - after for before, after in pairwise(left)) <= pieces.STEPS_PER_PIECE
    assert left[-1] == 0


def test_a_large_get_that_is_given_up_lets_go_of_what_it_has_found_in_pieces() -> None:
    channel, rounds = shuffled(), ITEMS // pieces.STEPS_PER_PIECE - 2
    reading = channel.reading(everything(), CLOCK)
    for _ in range(rounds):
        next(reading)
    leaving = abandoning(reading)
    next(leaving)
    assert not channel.look(CLOCK)[0]._snapshots  # what it was to look at is not held back meanwhile
    assert sum(1 for _ in leaving) >= rounds - 2


def test_a_subscription_resumed_among_very_many_ranges_does_not_walk_them_at_once(looked: Counter) -> None:
    channel = shuffled()
    low = parse_interval(MIN_INSTANT, MAX_INSTANT).start
    saved = channel.subscribe_all(CLOCK, start=low).saved(channel.incarnation)
    put(channel, CLOCK + 2 * ITEMS)
    looked.slices = 0
    for _ in channel.subscribing_all(CLOCK, saved=saved):
        assert looked.slices <= pieces.STEPS_PER_PIECE + 10
        looked.slices = 0


def backwards(items: int, **policy: Any) -> ChannelCore:
    """Each item is earlier than the one before it, so that what is collected is out of the order of seqs."""
    channel = a_channel(max_age_nanos=10**12, **policy)
    for time in range(items):
        put(channel, CLOCK - time)
    return channel


def test_the_first_consumers_of_a_full_channel_cost_its_set_up_nothing(looked: Counter) -> None:
    channel = shuffled()
    looked.slices = 0
    channel.configure(Policy(consumers=1, max_age_nanos=10**12), CLOCK)
    assert looked.slices <= 20
    most = before = 0
    for _ in channel.catching_up(CLOCK):
        most, before = max(most, looked.slices - before), looked.slices
    assert most <= 4 * pieces.STEPS_PER_PIECE
    assert channel.consume(1, range(1, 101), CLOCK).items == 100
    assert [one.waiting for one in channel.consumers(CLOCK)] == [ITEMS - 100]


def test_what_goes_while_new_consumers_learn_what_had_gone_is_owed_by_nobody() -> None:
    channel = backwards(3000)
    channel.configure(Policy(max_items=2000, max_age_nanos=10**12), CLOCK)
    channel.configure(Policy(max_items=2000, max_age_nanos=10**12, consumers=1), CLOCK)
    for at, _ in enumerate(channel.catching_up(CLOCK)):
        put(channel, CLOCK + at)  # the earliest item goes, whose seq is the highest of the first 2000
    channel.consume(1, [1], CLOCK)
    assert [one.waiting for one in channel.consumers(CLOCK)] == [1999]
    assert channel.counters(CLOCK).held == 2000


def test_how_many_items_wait_for_a_consumer_is_known_without_a_walk_over_what_has_gone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    channel = backwards(ITEMS, consumers=10)
    for consumer in range(1, 11):
        channel.consume(consumer, [], CLOCK)
    channel.configure(Policy(max_items=1, max_age_nanos=10**12, consumers=10), CLOCK)  # leaves seq 1
    for _ in channel.catching_up(CLOCK):
        pass
    for time in range(2 * BLOCK_ITEMS):  # every other one of them goes: they come in two orders
        put(channel, CLOCK + (time if time % 2 else -time))
    calls, add = 0, seq_set.SeqSet.add

    def counting(self: seq_set.SeqSet, first: int, end: int) -> int:
        nonlocal calls
        calls += 1
        return add(self, first, end)

    monkeypatch.setattr(seq_set.SeqSet, "add", counting)
    assert {one.waiting for one in channel.consumers(CLOCK)} == {channel.counters(CLOCK).held}
    assert calls == 0


def test_the_status_of_consumers_that_have_consumed_much_out_of_order_is_counted_in_pieces() -> None:
    channel = filled(4 * pieces.STEPS_PER_PIECE, consumers=3)
    for consumer in (1, 2, 3):
        channel.consume(consumer, range(2, 4 * pieces.STEPS_PER_PIECE + 1, 2), CLOCK)
    counting = channel.counting_consumers(CLOCK)
    assert sum(1 for _ in counting) >= 3 * 2
    assert {one.waiting for one in channel.consumers(CLOCK)} == {2 * pieces.STEPS_PER_PIECE}


def test_what_is_kept_of_a_consumer_is_bounded_by_what_is_held() -> None:
    channel = a_channel(consumers=2, max_items=100)
    put(channel, CLOCK + 10**6)  # is never consumed
    for time in range(5000):
        put(channel, CLOCK + time)
        if time % 2:
            channel.consume(1, [channel.next_seq - 1], CLOCK)
    _, retention = channel.look(CLOCK)
    assert retention.consumers is not None
    done = retention.consumers._taken[1].done
    assert done is not None
    assert len(done.ranges) <= 150


def test_a_consumer_that_has_much_behind_a_gap_goes_on_behind_it_by_and_by() -> None:
    channel = filled(4000, consumers=2)
    channel.consume(1, range(3, 4001, 2), CLOCK)
    channel.consume(2, [], CLOCK)
    _, retention = channel.look(CLOCK)
    assert retention.consumers is not None
    for seq in range(2, 4000, 2):
        retention.consumers.let_go(seq, seq + 1)
    place, below = retention.consumers._taken[1], []
    channel.consume(1, [1], CLOCK)
    while place.below < 4000:
        below.append(place.below)
        channel.consume(1, [], CLOCK)
    assert max(after - before for before, after in pairwise(below)) <= 2 * (RANGES_PER_LOOK_MAX + 16 + 1)


def test_items_that_all_come_late_are_counted_in_blocks_too(looked: Counter) -> None:
    channel = backwards(ITEMS)
    looked.slices = 0
    channel.configure(Policy(max_items=ITEMS // 2, max_age_nanos=10**12), CLOCK)
    assert channel.counters(CLOCK).held == ITEMS // 2
    assert looked.slices <= 3 * BLOCK_ITEMS + 20


def test_a_consumer_whose_many_ranges_have_all_gone_takes_them_in_by_and_by() -> None:
    """One consume after 200,000 such ranges took 228 ms."""
    consumers, end = Consumers(1), 40_001
    consumers.consume(1, range(2, end, 2), next_seq=end, newest_seq=None, clock=0, lease=LEASE_NANOS)
    consumers.let_go(1, end)
    done = consumers._taken[1].done
    assert done is not None
    left = [done.range_count]
    while left[-1]:
        consumers.consume(1, [], next_seq=end, newest_seq=None, clock=0, lease=LEASE_NANOS)
        left.append(done.range_count)
    assert max(before - after for before, after in pairwise(left)) <= 2 * RANGES_PER_LOOK_MAX + 16
    assert done.below == end


def test_what_had_gone_before_the_first_consumers_is_taken_in_by_and_by() -> None:
    consumers, end = Consumers(1), 40_001
    for seq in range(2, end, 2):
        consumers.let_go(seq, seq + 1)
    seq, left = 1, [consumers._gone.range_count]
    while seq < end:
        seq = consumers.let_go_some(seq, end, ranges_max=8)
        left.append(consumers._gone.range_count)
    assert max(before - after for before, after in pairwise(left)) <= 2 * 8
    assert consumers._gone.ranges == []


def test_what_all_consumers_have_consumed_goes_by_and_by_whoever_looks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 200,000 items, consumed out of the order in which they go, one status took 6 x 256."""
    channel = backwards(ITEMS, consumers=2)
    for consumer in (1, 2):
        channel.consume(consumer, [], CLOCK)
    told, let_go = 0, Consumers.let_go

    def counting(self: Consumers, first: int, end: int) -> None:
        nonlocal told
        told += 1
        let_go(self, first, end)

    monkeypatch.setattr(Consumers, "let_go", counting)
    for first in range(2, ITEMS + 1, 4096):  # not the first item, which is the newest one
        seqs = range(first, min(first + 4096, ITEMS + 1))
        for consumer in (1, 2):
            channel.consume(consumer, seqs, CLOCK)
    for look in (channel.counters, channel.next_deadline, channel.collect):
        told = 0
        look(CLOCK)
        assert told <= 2 * SLICES_USED_UP_MAX
        assert channel.oldest is not None
        assert channel.frontier is None
        assert told <= 2 * SLICES_USED_UP_MAX, "a look at the same moment takes nothing more"
    while channel.collect(CLOCK):
        pass
    assert channel.counters(CLOCK).held == 1


def permuted(items: int = 5000) -> ChannelCore:
    """One run for each item, in a mixed order of time."""
    channel = a_channel()
    for at in range(items):
        put(channel, CLOCK + at * 1009 % items)
    return channel


@pytest.mark.parametrize("resumed", [False, True])
def test_a_subscription_merges_the_seqs_of_items_in_any_order_a_few_at_a_time(
    monkeypatch: pytest.MonkeyPatch, resumed: bool
) -> None:
    """The seqs of 5000 items make one range, but were found in 20 lists of 256 ranges each."""
    yielded, ranges_of = 0, subscribing._Ranges.__iter__

    def counting(self: subscribing._Ranges) -> Iterator[subscribing.Range]:
        nonlocal yielded
        for one in ranges_of(self):
            yielded += 1
            yield one

    channel, most = permuted(), 0
    start = parse_interval(MIN_INSTANT, MAX_INSTANT).start
    saved = channel.subscribe_all(CLOCK, start=start).saved(channel.incarnation)
    monkeypatch.setattr(subscribing._Ranges, "__iter__", counting)
    opening = channel.subscribing_all(CLOCK, saved=saved) if resumed else channel.subscribing_all(CLOCK, start=start)
    cursor: Any = None
    while cursor is None:
        before = yielded
        try:
            next(opening)
        except StopIteration as end:
            cursor = end.value
        most = max(most, yielded - before)
    assert 0 < most <= 2 * pieces.STEPS_PER_PIECE
    before = yielded
    parts = channel.since(cursor, CLOCK, 2**30).slices
    assert [part.slice.first_seq for part in parts] == [*range(1, pieces.STEPS_PER_PIECE + 1)]
    assert yielded - before <= 1


def test_the_seqs_of_items_in_order_need_no_merge() -> None:
    held, _ = filled().look(CLOCK)
    assert [*run_to_end(subscribing._seq_ranges(held, FIRST_KEY))] == [(1, ITEMS + 1)]


def test_a_resumed_subscription_owes_the_rest_of_its_items_and_all_later_ones() -> None:
    channel = a_channel()
    for time in (10, 1, 11, 2, 12, 3, 13):
        put(channel, CLOCK + time)
    cursor = channel.subscribe_all(CLOCK, start=parse_interval(CLOCK + 10, MAX_INSTANT).start)
    (first,) = channel.since(cursor, CLOCK, 1).slices
    assert first.slice.first_seq == 1
    saved = cursor.saved(channel.incarnation)
    put(channel, CLOCK + 4)
    resumed = channel.subscribe_all(CLOCK, saved=saved)
    assert [part.slice.first_seq for part in channel.since(resumed, CLOCK, 2**30).slices] == [3, 5, 7, 8]


def large_bucket(items: int = 5000) -> ChannelCore:
    """Items of one time with short durations, and one later item."""
    channel = a_channel(max_age_nanos=1000)
    for _ in range(items):
        put(channel, CLOCK, durations=[5])
    put(channel, CLOCK + 50, durations=[5])
    return channel


def test_the_end_of_a_large_bucket_costs_no_walk_over_all_of_its_items(looked: Counter) -> None:
    """A look at the next deadline took 90 ms with 50,000 items of one time, and their collection took 180 ms."""
    channel = large_bucket()
    looked.slices = 0
    due = channel.next_deadline(CLOCK)
    assert looked.slices <= SLICES_MAX + 10
    assert due == CLOCK + 50 + 1000, "its spans count up to the next bucket"
    looked.slices = 0
    held, _ = channel.look(CLOCK + 1050)
    assert (held.items, held.collected_end) == (1, CLOCK + 50)
    assert looked.slices <= 3 * SLICES_MAX


def test_the_end_of_a_small_bucket_is_that_of_its_longest_span() -> None:
    channel = large_bucket(SLICES_MAX)
    assert channel.next_deadline(CLOCK) == CLOCK + 5 + 1000
    held, _ = channel.look(CLOCK + 1005)
    assert (held.items, held.collected_end) == (1, CLOCK + 5)


def test_a_large_newest_bucket_that_goes_ends_with_its_longest_span(looked: Counter) -> None:
    channel = a_channel()
    for at in range(5000):
        put(channel, CLOCK, durations=[7 if at == 4000 else 5])
    looked.slices = 0
    channel.configure(Policy(max_items=1, max_future_nanos=10**6), CLOCK)
    held, _ = channel.look(CLOCK)
    assert (held.items, held.collected_end) == (1, CLOCK + 7)
    assert looked.slices <= 3 * SLICES_MAX
