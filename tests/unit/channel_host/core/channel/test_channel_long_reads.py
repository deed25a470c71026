"""Gets and subscriptions of large channels: each piece of the work looks at a bounded number of slices."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import pytest

from stampede_rt.values.timeline import MAX_INSTANT, MIN_INSTANT, Match, parse_interval
from stampede_rt_channel_host.core.channel import (
    ChannelCore,
    Position,
    ReachTracker,
    ReadAnswer,
    abandoning,
    emptying,
    owed_ranges,
    pieces,
)
from stampede_rt_channel_host.core.channel.item_keys import FIRST_KEY
from stampede_rt_channel_host.core.channel.pieces import run_to_end
from tests.support.channel_host.channel_cores import CLOCK, a_channel, put
from tests.support.channel_host.large_channels import ITEMS, SliceCounter, count_slices, everything, filled, shuffled


@pytest.fixture
def looked(monkeypatch: pytest.MonkeyPatch) -> SliceCounter:
    return count_slices(monkeypatch)


@pytest.mark.parametrize("newest_first", [False, True])
def test_a_get_of_many_slices_is_answered_in_bounded_pieces(looked: SliceCounter, newest_first: bool) -> None:
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


def test_a_subscription_from_the_oldest_item_on_begins_in_pieces(looked: SliceCounter) -> None:
    channel = filled()
    looked.slices = 0
    opening = channel.subscribing_all(CLOCK, start=parse_interval(MIN_INSTANT, MAX_INSTANT).start)
    next(opening)
    assert looked.slices <= pieces.STEPS_PER_PIECE + 10


def test_a_part_of_a_subscription_holds_a_bounded_number_of_slices() -> None:
    channel = filled()
    cursor = channel.subscribe_all(CLOCK, start=parse_interval(MIN_INSTANT, MAX_INSTANT).start)
    assert len(channel.since(cursor, CLOCK, 2**30).slices) == pieces.STEPS_PER_PIECE


def test_a_page_within_a_large_bucket_reads_only_the_items_of_the_page(looked: SliceCounter) -> None:
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
def test_the_reach_of_a_channel_is_known_without_a_scan(looked: SliceCounter, durations: list[int] | None) -> None:
    channel = a_channel()
    for _ in range(ITEMS):
        put(channel, CLOCK, durations=durations)
    tracker = ReachTracker(channel)
    tracker.begin()
    put(channel, CLOCK, durations=durations)
    looked.slices = 0
    assert tracker.reach(CLOCK).end == (CLOCK if durations is None else CLOCK + 5)
    assert looked.slices <= 1


def test_the_newest_item_of_a_full_bucket_is_found_in_a_few_looks(looked: SliceCounter) -> None:
    channel = a_channel()
    for _ in range(ITEMS):
        put(channel, CLOCK)
    cursor = channel.subscribe_newest(CLOCK, start=parse_interval(MIN_INSTANT, MAX_INSTANT).start)
    looked.slices = 0
    assert channel.latest(cursor, CLOCK) is not None
    assert channel.latest(cursor, CLOCK) is None
    assert looked.slices <= 20


@pytest.mark.parametrize("newest_first", [False, True])
def test_an_unwanted_large_answer_is_freed_in_pieces(newest_first: bool) -> None:
    answer = shuffled().read(everything(newest_first=newest_first), CLOCK)
    left = [ITEMS]
    for _ in emptying(answer.slices):
        left.append(len(answer.slices))
    assert max(before - after for before, after in pairwise(left)) <= pieces.STEPS_PER_PIECE
    assert left[-1] == 0


def test_a_cancelled_large_get_frees_its_found_items_in_pieces() -> None:
    channel, rounds = shuffled(), ITEMS // pieces.STEPS_PER_PIECE - 2
    reading = channel.reading(everything(), CLOCK)
    for _ in range(rounds):
        next(reading)
    leaving = abandoning(reading)
    next(leaving)
    assert not channel.look(CLOCK)[0]._snapshots  # the channel does not keep the items for this read meanwhile
    assert sum(1 for _ in leaving) >= rounds - 2


def test_a_subscription_resumed_among_very_many_ranges_walks_them_in_pieces(looked: SliceCounter) -> None:
    channel = shuffled()
    low = parse_interval(MIN_INSTANT, MAX_INSTANT).start
    saved = channel.subscribe_all(CLOCK, start=low).saved(channel.incarnation)
    put(channel, CLOCK + 2 * ITEMS)
    looked.slices = 0
    for _ in channel.subscribing_all(CLOCK, saved=saved):
        assert looked.slices <= pieces.STEPS_PER_PIECE + 10
        looked.slices = 0


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
    """The seqs of 5000 items make one range. In an earlier version, the seqs filled 20 lists of 256 ranges each."""
    yielded, ranges_of = 0, owed_ranges.OwedRanges.__iter__

    def counting(self: owed_ranges.OwedRanges) -> Iterator[owed_ranges.Range]:
        nonlocal yielded
        for one in ranges_of(self):
            yielded += 1
            yield one

    channel, most = permuted(), 0
    start = parse_interval(MIN_INSTANT, MAX_INSTANT).start
    saved = channel.subscribe_all(CLOCK, start=start).saved(channel.incarnation)
    monkeypatch.setattr(owed_ranges.OwedRanges, "__iter__", counting)
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
    assert [*run_to_end(owed_ranges.owed_ranges(held, FIRST_KEY))] == [(1, ITEMS + 1)]


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
