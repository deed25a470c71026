from __future__ import annotations

import pytest

from stampede_rt.errors import InvalidArgument
from stampede_rt_channel_host.core.dedup import KEPT_NANOS, RUNS_MAX, RetryWindow

PRODUCER = 0xABC


def test_a_retried_run_is_answered_as_before() -> None:
    window: RetryWindow[str] = RetryWindow()
    window.record(PRODUCER, 1, 3, "first", now=0)
    window.record(PRODUCER, 4, 1, "second", now=1)
    assert window.find(PRODUCER, 1, 3, now=2) == "first"
    assert window.find(PRODUCER, 4, 1, now=2) == "second"
    assert window.find(PRODUCER, 5, 1, now=2) is None
    assert window.find(PRODUCER + 1, 1, 3, now=2) is None


def test_a_number_that_was_left_out_is_new_when_it_comes_late() -> None:
    window: RetryWindow[str] = RetryWindow()
    window.record(PRODUCER, 1, 2, "first", now=0)
    window.record(PRODUCER, 5, 2, "third", now=0)
    assert window.find(PRODUCER, 3, 2, now=0) is None


@pytest.mark.parametrize(("first_number", "items"), [(1, 2), (2, 2), (1, 5), (3, 4), (2, 1)])
def test_numbers_of_a_known_run_in_another_run_are_refused(first_number: int, items: int) -> None:
    window: RetryWindow[str] = RetryWindow()
    window.record(PRODUCER, 1, 3, "first", now=0)
    with pytest.raises(InvalidArgument, match="producer abc overlap the run 1 to 3"):
        window.find(PRODUCER, first_number, items, now=0)


def test_only_the_last_runs_of_a_producer_are_kept() -> None:
    window: RetryWindow[int] = RetryWindow()
    for number in range(1, 2 * RUNS_MAX + 1):
        window.record(PRODUCER, number, 1, number, now=0)
    assert window.find(PRODUCER, RUNS_MAX, 1, now=0) is None
    assert window.find(PRODUCER, RUNS_MAX + 1, 1, now=0) == RUNS_MAX + 1


def test_all_that_a_producer_has_in_flight_is_recognised_however_long_its_runs_are() -> None:
    """A producer whose connection broke sends up to 64 runs of 256 items again: they were doubled once, all but the
    last four, because the window was counted in numbers."""
    window: RetryWindow[int] = RetryWindow()
    for run in range(64):
        window.record(PRODUCER, 1 + run * 256, 256, run, now=0)
    assert [window.find(PRODUCER, 1 + run * 256, 256, now=1) for run in range(64)] == list(range(64))


def test_runs_are_forgotten_after_ten_minutes() -> None:
    window: RetryWindow[str] = RetryWindow()
    window.record(PRODUCER, 1, 1, "first", now=0)
    assert window.find(PRODUCER, 1, 1, now=KEPT_NANOS - 1) == "first"
    assert window.find(PRODUCER, 1, 1, now=KEPT_NANOS) is None


def test_the_longest_silent_producer_makes_room_for_another() -> None:
    window: RetryWindow[str] = RetryWindow(producers_max=2)
    window.record(1, 1, 1, "one", now=0)
    window.record(2, 1, 1, "two", now=1)
    window.record(1, 2, 1, "one again", now=2)
    window.record(3, 1, 1, "three", now=3)
    assert len(window) == 2
    assert window.find(2, 1, 1, now=3) is None
    assert window.find(1, 1, 1, now=3) == "one"


def test_producers_that_were_silent_for_ten_minutes_are_forgotten() -> None:
    window: RetryWindow[str] = RetryWindow()
    window.record(1, 1, 1, "one", now=0)
    window.record(2, 1, 1, "two", now=KEPT_NANOS)
    assert len(window) == 1


def test_producer_zero_asks_for_nothing_to_be_recognised() -> None:
    window: RetryWindow[str] = RetryWindow()
    window.record(0, 1, 1, "first", now=0)
    assert window.find(0, 1, 1, now=0) is None
    assert len(window) == 0


def test_what_is_remembered_goes_to_another_owner_as_values() -> None:
    window: RetryWindow[str] = RetryWindow()
    window.record(2, 1, 1, "of another", now=KEPT_NANOS)
    window.record(PRODUCER, 1, 3, "forgotten", now=10)
    window.record(PRODUCER, 4, 2, "first", now=KEPT_NANOS)
    window.record(PRODUCER, 6, 1, "second", now=KEPT_NANOS + 5)
    heir: RetryWindow[str] = RetryWindow()
    heir.restore(window.known(KEPT_NANOS + 10), now=7 * KEPT_NANOS)
    assert heir.known(7 * KEPT_NANOS) == window.known(KEPT_NANOS + 10)
    assert heir.find(PRODUCER, 4, 2, now=7 * KEPT_NANOS) == "first"
    assert heir.find(PRODUCER, 1, 3, now=7 * KEPT_NANOS) is None
    assert heir.find(PRODUCER, 4, 2, now=8 * KEPT_NANOS - 10) is None, "it is as old as it was"
    assert heir.find(PRODUCER, 6, 1, now=8 * KEPT_NANOS - 10) == "second"
    with pytest.raises(InvalidArgument):
        heir.find(PRODUCER, 5, 1, now=7 * KEPT_NANOS)


def test_the_last_1024_numbers_are_known_even_if_each_is_a_run() -> None:
    window: RetryWindow[int] = RetryWindow()
    for number in range(1, 3001):
        window.record(PRODUCER, number, 1, number, now=0)
    assert [window.find(PRODUCER, number, 1, now=0) for number in range(1977, 3001)] == list(range(1977, 3001))
    assert sum(run.items for producer in window.known(0) for run in producer.runs) == RUNS_MAX
