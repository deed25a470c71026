"""Collection in large channels: each step looks at a bounded number of slices, however many items leave."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import pytest

from stampede_rt.values.model import Policy
from stampede_rt_channel_host.core.channel import ChannelCore
from stampede_rt_channel_host.core.channel.item_blocks import BLOCK_ITEMS
from stampede_rt_channel_host.core.channel.retention import SLICES_AGED_MAX
from stampede_rt_channel_host.core.channel.span_ends import SLICES_MAX
from tests.support.channel_host.channel_cores import CLOCK, a_channel, put
from tests.support.channel_host.large_channels import ITEMS, SliceCounter, backwards, count_slices, filled


@pytest.fixture
def looked(monkeypatch: pytest.MonkeyPatch) -> SliceCounter:
    return count_slices(monkeypatch)


@pytest.mark.parametrize("policy", [Policy(max_items=10), Policy(max_bytes=10 * (64 + 10))])
def test_a_smaller_limit_reads_little_more_than_one_block(looked: SliceCounter, policy: Policy) -> None:
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


def test_a_block_with_too_many_late_items_is_split(looked: SliceCounter) -> None:
    channel = filled(2 * BLOCK_ITEMS + 10, max_age_nanos=10**6)
    for time in range(ITEMS):
        put(channel, CLOCK - ITEMS + time)
    looked.slices = 0
    channel.configure(Policy(max_items=10), CLOCK)
    assert looked.slices <= 2 * BLOCK_ITEMS + 20


def test_late_items_are_counted_in_blocks(looked: SliceCounter) -> None:
    channel = backwards(ITEMS)
    looked.slices = 0
    channel.configure(Policy(max_items=ITEMS // 2, max_age_nanos=10**12), CLOCK)
    assert channel.counters(CLOCK).held == ITEMS // 2
    assert looked.slices <= 3 * BLOCK_ITEMS + 20


def test_collection_of_consumed_items_by_age_looks_at_a_bounded_number_of_slices(looked: SliceCounter) -> None:
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


def test_collection_looks_at_a_part_of_a_large_bucket_at_a_time_if_consumers_may_owe_its_items(
    looked: SliceCounter,
) -> None:
    """In an earlier version, a poll with 100,000 items took 0.3 s, and a put took 0.9 s."""
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
    look(lambda: channel.consume(2, [], later))  # this consumer owes the items that the other one has consumed
    for _ in range(2 * ITEMS // SLICES_AGED_MAX):
        look(lambda: channel.collect(later))
    assert channel.look(later)[0].items == ITEMS + 2, "one item of the bucket is owed"
    for first in range(1, ITEMS + 1, 4000):
        for consumer in (1, 2):
            look(partial(channel.consume, consumer, range(first, first + 4000), later))
    while channel.collect(later):
        look(lambda: channel.next_deadline(later))
    assert channel.look(later)[0].items == 2, (
        "of the items after the bucket, consumers owe one, and the other is the newest"
    )
    assert most <= 4 * SLICES_AGED_MAX + 4 * BLOCK_ITEMS


def large_bucket(items: int = 5000) -> ChannelCore:
    """Items of one time with short durations, and one later item."""
    channel = a_channel(max_age_nanos=1000)
    for _ in range(items):
        put(channel, CLOCK, durations=[5])
    put(channel, CLOCK + 50, durations=[5])
    return channel


def test_the_end_of_a_large_bucket_is_known_without_a_scan_of_its_items(looked: SliceCounter) -> None:
    """In an earlier version, with 50,000 items of one time, the search for the next deadline took 90 ms, and the
    collection 180 ms.
    """
    channel = large_bucket()
    looked.slices = 0
    due = channel.next_deadline(CLOCK)
    assert looked.slices <= SLICES_MAX + 10
    assert due == CLOCK + 50 + 1000, "the spans of the bucket count up to the next bucket"
    looked.slices = 0
    held, _ = channel.look(CLOCK + 1050)
    assert (held.items, held.collected_end) == (1, CLOCK + 50)
    assert looked.slices <= 3 * SLICES_MAX


def test_a_small_bucket_ends_at_the_end_of_its_longest_span() -> None:
    channel = large_bucket(SLICES_MAX)
    assert channel.next_deadline(CLOCK) == CLOCK + 5 + 1000
    held, _ = channel.look(CLOCK + 1005)
    assert (held.items, held.collected_end) == (1, CLOCK + 5)


def test_a_large_newest_bucket_is_collected_at_the_end_of_its_longest_span(looked: SliceCounter) -> None:
    channel = a_channel()
    for at in range(5000):
        put(channel, CLOCK, durations=[7 if at == 4000 else 5])
    looked.slices = 0
    channel.configure(Policy(max_items=1, max_future_nanos=10**6), CLOCK)
    held, _ = channel.look(CLOCK)
    assert (held.items, held.collected_end) == (1, CLOCK + 7)
    assert looked.slices <= 3 * SLICES_MAX
