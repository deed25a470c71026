"""Subscriptions, in the words of the time model."""

from __future__ import annotations

import pytest

from stampede_rt.errors import IncarnationLost, InvalidArgument
from stampede_rt.values.model import Policy
from stampede_rt.values.timeline import NEWEST, OLDEST, Bound
from stampede_rt_channel_host.core.channel import Position, SavedCursor
from tests.support.channel_host.channel_cores import CLOCK, a_channel, put, seqs_of, times_of

ALL = 10**9


def test_a_subscription_without_a_start_yields_new_items_of_any_time() -> None:
    channel = a_channel(max_items=9)
    put(channel, 10, 20)
    cursor = channel.subscribe_all(CLOCK)
    assert channel.since(cursor, CLOCK, ALL).is_empty
    put(channel, 30)
    put(channel, 5)
    delivery = channel.since(cursor, CLOCK, ALL)
    assert times_of([one.slice for one in delivery.slices]) == [30, 5]
    assert [one.next_time for one in delivery.slices] == [None, 10]
    assert channel.since(cursor, CLOCK, ALL).is_empty
    assert (cursor.delivered, cursor.next_seq) == (2, 5)


def test_a_subscription_with_a_start_yields_held_items_first_in_the_order_of_seqs() -> None:
    channel = a_channel(max_items=9)
    put(channel, 10, 20)
    put(channel, 15)
    put(channel, 30)
    cursor = channel.subscribe_all(CLOCK, start=Bound(None, 15))
    put(channel, 1)
    delivery = channel.since(cursor, CLOCK, ALL)
    assert seqs_of([one.slice for one in delivery.slices]) == [2, 3, 4, 5]
    exclusive = channel.subscribe_all(CLOCK, start=Bound(None, 15), start_exclusive=True)
    assert seqs_of([one.slice for one in channel.since(exclusive, CLOCK, ALL).slices]) == [2, 4]


def test_a_start_at_the_newest_of_an_empty_channel_means_all_new_items() -> None:
    channel = a_channel(max_items=9)
    cursor = channel.subscribe_all(CLOCK, start=NEWEST)
    put(channel, 10)
    assert seqs_of([one.slice for one in channel.since(cursor, CLOCK, ALL).slices]) == [1]


def test_items_that_were_collected_before_they_were_sent_are_a_gap_with_its_count() -> None:
    channel = a_channel(max_items=3)
    put(channel, 10, 20)
    cursor = channel.subscribe_all(CLOCK)
    put(channel, 30, 40)
    put(channel, 50, 60, 70)
    delivery = channel.since(cursor, CLOCK, ALL)
    assert delivery.gap is not None
    assert (delivery.gap.first_seq, delivery.gap.last_seq, delivery.gap.items) == (3, 4, 2)
    assert delivery.gap.reason == "COLLECTED"
    assert "max_items (3)" in delivery.gap.reason.detail
    assert seqs_of([one.slice for one in delivery.slices]) == [5, 6, 7]
    assert (cursor.delivered, cursor.dropped) == (3, 2)


def test_a_reader_that_lags_far_gets_adjoining_gaps() -> None:
    """In an earlier version, one call looked at all collected items.

    A million items took half a second and delayed all callers.
    """
    channel = a_channel(max_items=9999)
    for time in range(2500):
        put(channel, time)
    cursor = channel.subscribe_all(CLOCK, start=OLDEST)
    channel.configure(Policy(max_items=2), CLOCK)
    gaps = []
    while (gap := (delivery := channel.since(cursor, CLOCK, ALL)).gap) is not None and not delivery.slices:
        gaps.append(gap)
    assert gap is not None
    assert seqs_of([one.slice for one in delivery.slices]) == [2499, 2500]
    seq_ranges = [(one.first_seq, one.last_seq) for one in [*gaps, gap]]
    assert len(seq_ranges) > 1
    assert [seq for first, last in seq_ranges for seq in range(first, last + 1)] == list(range(1, 2499))
    assert (cursor.delivered, cursor.dropped) == (2, 2498)


def test_a_part_ends_at_the_byte_bound_but_brings_one_slice_at_least() -> None:
    channel = a_channel(max_items=99)
    cursor = channel.subscribe_all(CLOCK)
    for time in range(6):
        put(channel, time, time, lengths=[36, 36])
    assert [len(channel.since(cursor, CLOCK, 400).slices) for _ in range(4)] == [2, 2, 2, 0]
    put(channel, 10, lengths=[5000])
    assert len(channel.since(cursor, CLOCK, 1).slices) == 1


def test_a_subscription_resumes_after_the_seq_of_an_item() -> None:
    channel = a_channel(max_items=9)
    put(channel, 10, 20, 30)
    cursor = channel.subscribe_all(CLOCK, after=Position(20, 2, incarnation=3))
    assert seqs_of([one.slice for one in channel.since(cursor, CLOCK, ALL).slices]) == [3]


def test_an_invalid_resumption_is_refused() -> None:
    channel = a_channel(max_items=9)
    with pytest.raises(IncarnationLost):
        channel.subscribe_all(CLOCK, after=Position(20, 2, incarnation=9))
    with pytest.raises(InvalidArgument, match="no seq"):
        channel.subscribe_newest(CLOCK, after=Position(20))
    with pytest.raises(InvalidArgument, match="both start and after"):
        channel.subscribe_all(CLOCK, start=NEWEST, after=Position(20, 2))


def test_a_newest_subscription_never_goes_back_and_counts_skipped_items() -> None:
    channel = a_channel(max_items=9)
    put(channel, 10)
    cursor = channel.subscribe_newest(CLOCK)
    assert channel.latest(cursor, CLOCK) is None
    put(channel, 20, 30)
    put(channel, 25)
    taken = channel.latest(cursor, CLOCK)
    assert taken is not None
    assert (times_of([taken.slice]), taken.next_time, cursor.skipped) == ([30], None, 2)
    put(channel, 5)
    assert channel.latest(cursor, CLOCK) is None
    assert (cursor.delivered, cursor.skipped) == (1, 3)


def test_a_newest_subscription_with_a_start_begins_with_the_present_newest_item() -> None:
    channel = a_channel(max_items=9)
    put(channel, 10, 20, 20)
    cursor = channel.subscribe_newest(CLOCK, start=Bound(None, 5))
    taken = channel.latest(cursor, CLOCK)
    assert taken is not None
    assert (seqs_of([taken.slice]), cursor.skipped) == ([3], 2)
    assert channel.latest(channel.subscribe_newest(CLOCK, start=Bound(None, 21)), CLOCK) is None


def test_a_run_is_split_where_the_bound_is_reached() -> None:
    channel = a_channel(max_items=99)
    cursor = channel.subscribe_all(CLOCK)
    put(channel, *range(6), lengths=[36] * 6)
    assert [seqs_of([one.slice for one in channel.since(cursor, CLOCK, 150).slices]) for _ in range(4)] == [
        [1, 2], [3, 4], [5, 6], [],
    ]  # fmt: skip


def test_a_resumed_cursor_skips_the_items_before_its_start() -> None:
    channel = a_channel(max_items=99)
    put(channel, 30, 5, 10, 7, 20)
    cursor = channel.subscribe_all(CLOCK, start=Bound(None, 10))
    assert seqs_of([one.slice for one in channel.since(cursor, CLOCK, 1).slices]) == [1]
    saved = cursor.saved(3)
    assert (saved.next_seq, saved.low, saved.live_seq) == (3, (10, 0), 6)
    put(channel, 6)
    resumed = channel.subscribe_all(CLOCK, saved=saved)
    assert seqs_of([one.slice for one in channel.since(resumed, CLOCK, ALL).slices]) == [3, 5, 6]
    assert resumed.saved(3) == SavedCursor(incarnation=3, next_seq=7)


def test_items_that_are_collected_before_a_cursor_continues_are_reported() -> None:
    channel = a_channel(max_items=4)
    put(channel, 10, 20, 30)
    cursor = channel.subscribe_all(CLOCK, start=Bound(None, 10))
    channel.since(cursor, CLOCK, 1)
    saved = cursor.saved(3)
    put(channel, 40, 50, 60)
    resumed = channel.subscribe_all(CLOCK, saved=saved)
    delivery = channel.since(resumed, CLOCK, ALL)
    assert delivery.gap is not None
    assert (delivery.gap.first_seq, delivery.gap.last_seq) == (2, 2)
    assert seqs_of([one.slice for one in delivery.slices]) == [3, 4, 5, 6]


def test_a_resumed_newest_subscription_counts_each_skipped_item_once() -> None:
    channel = a_channel(max_items=99)
    put(channel, 10, 20)
    cursor = channel.subscribe_newest(CLOCK)
    saved = cursor.saved(3)  # the reader took nothing yet, and the present items are not new
    resumed = channel.subscribe_newest(CLOCK, saved=saved)
    assert channel.latest(resumed, CLOCK) is None
    put(channel, 15, 30)
    taken = channel.latest(resumed, CLOCK)
    assert taken is not None
    assert (times_of([taken.slice]), resumed.skipped) == ([30], 1)
    put(channel, 25)
    last = channel.subscribe_newest(CLOCK, saved=resumed.saved(3))
    assert channel.latest(last, CLOCK) is None
    assert last.skipped == 1


def test_a_cursor_of_another_incarnation_or_of_a_group_is_refused() -> None:
    channel = a_channel(max_items=9)
    with pytest.raises(IncarnationLost):
        channel.subscribe_all(CLOCK, saved=SavedCursor(incarnation=9, next_seq=1))
    with pytest.raises(InvalidArgument, match="group"):
        channel.subscribe_newest(CLOCK, saved=SavedCursor(incarnation=3, next_seq=1, cut=5))


def test_a_saved_cursor_continues_within_the_held_items_if_retention_has_collected_items_after_its_start() -> None:
    """In an earlier version, the reading of this cursor never ended, and the host served nothing any more."""
    channel = a_channel(max_items=3)
    put(channel, 10, 20, 30, 40)
    saved = SavedCursor(incarnation=3, next_seq=3, low=(5, 0), live_seq=5)
    cursor = channel.subscribe_all(CLOCK, saved=saved)
    assert cursor.owed(channel.next_seq) == (3, 5)
    assert seqs_of([one.slice for one in channel.since(cursor, CLOCK, ALL).slices]) == [3, 4]
