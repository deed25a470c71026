"""A copy for which a host waits must come nearer to its source. A feed sends runs as they are stored."""

from __future__ import annotations

import pytest

from stampede_rt_channel_host.core.channel import CATCH_UP_NANOS, ChannelCore, ChannelFeed, LagWatch, pieces
from tests.support.channel_host.channel_cores import CLOCK, a_channel, put

ALL = 10**9


def test_a_copy_whose_lag_grows_is_marked_as_lagging_after_a_while() -> None:
    watch = LagWatch()
    assert not watch.stays_behind(100, 0)
    assert not watch.stays_behind(150, CATCH_UP_NANOS - 1)
    assert watch.stays_behind(150, CATCH_UP_NANOS)


def test_a_copy_that_catches_up_or_was_level_is_not_marked_as_lagging() -> None:
    watch = LagWatch()
    for step in range(9):
        assert not watch.stays_behind(100 - step, step * CATCH_UP_NANOS)
    assert not watch.stays_behind(0, 9 * CATCH_UP_NANOS)
    assert not watch.stays_behind(200, 10 * CATCH_UP_NANOS)
    assert watch.stays_behind(200, 11 * CATCH_UP_NANOS)


def ranges_of_parts(channel: ChannelCore) -> list[list[tuple[int, int]]]:
    """The seqs of each slice of each part, from the first seq up to the end, for a copy that has nothing."""
    feed = ChannelFeed(channel, None, CLOCK)
    parts = iter(lambda: feed.take(CLOCK, ALL), None)
    ranges = [[(one.first_seq, one.end_seq) for one in part.slices] for part in parts]
    feed.close()
    return [one for one in ranges if one]


def test_a_run_is_fed_as_it_is_stored_if_items_of_other_runs_lie_between_its_items() -> None:
    channel = a_channel()
    put(channel, 10, 20, 30)
    put(channel, 15, 25, 35)
    assert ranges_of_parts(channel) == [[(1, 4), (4, 7)]]


def test_a_run_is_fed_without_its_collected_items() -> None:
    channel = a_channel(max_items=4)
    put(channel, 10, 20, 30)
    put(channel, 15, 25, 35)
    assert ranges_of_parts(channel) == [[(2, 4)], [(5, 7)]]


def test_a_part_of_a_feed_looks_at_a_bounded_number_of_items_between_other_items(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(pieces, "STEPS_PER_PIECE", 4)
    channel = a_channel()
    put(channel, *range(0, 12, 2))
    put(channel, *range(1, 13, 2))
    assert ranges_of_parts(channel) == [[(1, 5)], [(5, 7), (7, 9)], [(9, 13)]]
