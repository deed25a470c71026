"""A window that follows another: it has each run once, after any number of takes."""

from __future__ import annotations

import pytest

from stampede_rt.errors import InvalidArgument, TooOld
from stampede_rt_channel_host.core.dedup import KeptRun, RetryWindow
from stampede_rt_channel_host.core.run_outcome import ItemRefusal, RunOutcome, RunPart
from stampede_rt_channel_host.core.window_feed import WindowFeed


def whole(first_seq: int, items: int, time: int) -> RunOutcome:
    return RunOutcome(items, items, (RunPart(0, first_seq, items, None),), (), time)


def kept(window: RetryWindow) -> list[KeptRun]:
    return sorted(window.kept(0), key=lambda run: (run.producer_id, run.first_number))


def test_a_feed_has_each_record_once_although_all_came_at_one_instant() -> None:
    window, copy = RetryWindow(), RetryWindow()
    feed = WindowFeed(window, None)
    for number in range(1, 6):
        for producer_id in (1, 2, 3):
            window.record(producer_id, number, whole(10 * number + producer_id, 1, 7), "ann")
        found = feed.take(1000)
        assert [(run.producer_id, run.first_number) for run in found] == [(1, number), (2, number), (3, number)]
        for run in found:
            copy.adopt(run)
        assert feed.is_caught_up
        assert feed.take(1000) == []
    assert kept(copy) == kept(window)


def test_a_feed_gives_many_producers_in_parts_the_longest_silent_first() -> None:
    window = RetryWindow()
    for producer_id in range(1, 8):
        window.record(producer_id, 1, whole(producer_id, 1, producer_id))
    feed, found = WindowFeed(window, None), []
    while not feed.is_caught_up:
        part = feed.take(2)
        assert len(part) <= 2
        found += [run.producer_id for run in part]
    assert found == [1, 2, 3, 4, 5, 6, 7]


def test_a_resumed_feed_has_only_the_records_since_and_a_repeated_one_changes_nothing() -> None:
    window, copy = RetryWindow(), RetryWindow()
    for time in range(1, 7):
        window.record(1, time, whole(time, 1, time))
    for run in WindowFeed(window, None).take(1000):
        copy.adopt(run)
    window.record(1, 7, whole(7, 1, 7))
    next_runs = WindowFeed(window, 6).take(1000)
    assert [run.first_number for run in next_runs] == [6, 7]
    for run in next_runs:
        copy.adopt(run)
    assert kept(copy) == kept(window)
    assert copy.footprint_bytes == window.footprint_bytes


def test_the_feed_has_the_latest_outcome_of_a_partly_accepted_run() -> None:
    window, copy = RetryWindow(), RetryWindow()
    feed = WindowFeed(window, None)
    window.record(1, 1, RunOutcome(3, 1, (RunPart(0, 5, 1, None),), (), 1))
    for run in feed.take(1000):
        copy.adopt(run)
    window.record(1, 1, whole(5, 3, 2))
    for run in feed.take(1000):
        copy.adopt(run)
    assert copy.find(1, 1, 3, 2) == whole(5, 3, 2)


def test_a_window_forgets_the_runs_of_lost_items_and_continues_a_run_that_is_lost_in_part() -> None:
    window = RetryWindow()
    window.record(1, 1, whole(1, 2, 1))
    refused = ItemRefusal(1, TooOld("too old"))
    window.record(1, 3, RunOutcome(4, 4, (RunPart(0, 3, 3, None),), (refused,), 2))
    window.record(1, 7, whole(6, 1, 3))
    window.record(2, 1, whole(7, 1, 3))
    window.keep_up_to(5)
    assert window.find(1, 1, 2, 3) == whole(1, 2, 1)
    assert window.find(1, 3, 4, 3) == RunOutcome(4, 3, (RunPart(0, 3, 2, None),), (refused,), 2)
    assert (window.find(1, 7, 1, 3), window.find(2, 1, 1, 3), len(window)) == (None, None, 1)
    window.keep_up_to(1)
    assert (len(window), window.footprint_bytes) == (0, 0)


def test_a_copied_window_takes_over_the_entry_of_its_owner_if_the_two_differ() -> None:
    window = RetryWindow()
    window.record(1, 1, whole(1, 4, 1))
    window.adopt(KeptRun(1, 3, whole(9, 2, 2)))
    assert window.find(1, 3, 2, 2) == whole(9, 2, 2)
    with pytest.raises(InvalidArgument, match="overlap"):
        window.find(1, 4, 2, 2)


def test_a_put_that_left_the_window_is_not_taken_into_the_copy() -> None:
    """The host's clock may go on by more than the window keeps, while a write of the feed is under way."""
    window = RetryWindow()
    feed = WindowFeed(window, None)
    window.record(1, 1, whole(1, 1, 7))
    window.expire(10**18)
    assert feed.take_put() is None
    assert feed.take(1000) == []
    assert feed.is_caught_up
