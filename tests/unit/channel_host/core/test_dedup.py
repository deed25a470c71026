"""The retry window: the host recognises a repeated run, and answers as before."""

from __future__ import annotations

import tracemalloc
from typing import Any

import pytest

from stampede_rt.errors import ChannelFull, InvalidArgument
from stampede_rt_channel_host.core.dedup import (
    KEPT_NANOS,
    PRODUCER_BYTES_MAX,
    RUN_BYTES,
    RUNS_MAX,
    RetryWindow,
)
from stampede_rt_channel_host.core.run_outcome import ItemRefusal, RunOutcome, RunPart, RunProgress
from stampede_rt_channel_host.core.window_feed import WindowFeed

PRODUCER = 0xABC


def accepted(items: int, first_seq: int, now: int = 0, stamped: int | None = None) -> RunOutcome:
    return RunOutcome(items, items, (RunPart(0, first_seq, items, stamped),), (), now)


def half(items: int, judged_items: int, first_seq: int, now: int = 0) -> RunOutcome:
    return RunOutcome(items, judged_items, (RunPart(0, first_seq, judged_items, None),), (), now)


def test_a_retried_run_is_answered_as_before() -> None:
    window = RetryWindow()
    window.record(PRODUCER, 1, accepted(3, 1))
    window.record(PRODUCER, 4, accepted(1, 4, now=1, stamped=-7))
    assert window.find(PRODUCER, 1, 3, now=2) == accepted(3, 1)
    assert window.find(PRODUCER, 4, 1, now=2) == accepted(1, 4, now=1, stamped=-7)
    assert window.find(PRODUCER, 5, 1, now=2) is None
    assert window.find(PRODUCER + 1, 1, 3, now=2) is None


def test_the_greatest_numbers_are_distinguished() -> None:
    window = RetryWindow()
    last = 2**64 - 1
    window.record(2**64 - 1, last, accepted(1, 9))
    assert window.find(2**64 - 1, last, 1, now=0) == accepted(1, 9)
    assert window.find(2**64 - 1, last - 1, 1, now=0) is None


def test_a_retry_of_a_partly_accepted_run_finds_its_accepted_part() -> None:
    window = RetryWindow()
    window.record(PRODUCER, 1, half(4, 3, first_seq=1))
    assert window.find(PRODUCER, 1, 4, now=1) == half(4, 3, first_seq=1)
    with pytest.raises(InvalidArgument):
        window.find(PRODUCER, 1, 3, now=1)
    window.record(PRODUCER, 1, accepted(4, 1, now=2))
    assert window.find(PRODUCER, 1, 4, now=3) == accepted(4, 1, now=2)
    assert [kept.outcome for kept in window.kept(3)] == [accepted(4, 1, now=2)]


def test_a_run_that_is_accepted_item_by_item_takes_the_room_of_one_run() -> None:
    window = RetryWindow()
    window.record(PRODUCER, 1, accepted(1, 1))
    before = window.footprint_bytes
    for judged_items in range(1, RUNS_MAX + 2):
        window.record(PRODUCER, 2, half(RUNS_MAX + 2, judged_items, first_seq=2))
    window.record(PRODUCER, 2, accepted(RUNS_MAX + 2, 2))
    assert window.find(PRODUCER, 1, 1, now=1) == accepted(1, 1), "the run in parts has not displaced it"
    assert window.footprint_bytes == before + RUN_BYTES
    copy = RetryWindow()
    feed = WindowFeed(window, None)
    window.record(PRODUCER, RUNS_MAX + 4, half(2, 1, first_seq=2000))
    for run in feed.take(100):
        copy.adopt(run)
    window.record(PRODUCER, RUNS_MAX + 4, accepted(2, 2000))
    for run in feed.take(100):
        copy.adopt(run)
    assert sorted(copy.kept(1)) == sorted(window.kept(1))


def test_refusals_of_a_run_that_was_accepted_in_part_are_kept_with_their_reasons() -> None:
    window = RetryWindow()
    refused = RunOutcome(2, 2, (RunPart(0, 1, 1, None),), (ItemRefusal(1, ChannelFull("full")),), 0)
    window.record(PRODUCER, 1, refused)
    assert window.find(PRODUCER, 1, 2, now=0) == refused


def test_a_run_of_which_nothing_was_accepted_is_not_kept() -> None:
    window = RetryWindow()
    window.record(PRODUCER, 1, RunOutcome(1, 1, (), (ItemRefusal(0, ChannelFull("full")),), 0))
    assert window.find(PRODUCER, 1, 1, now=0) is None
    assert window.footprint_bytes == 0


def test_a_skipped_number_is_new_when_it_arrives_late() -> None:
    window = RetryWindow()
    window.record(PRODUCER, 1, accepted(2, 1))
    window.record(PRODUCER, 5, accepted(2, 3))
    assert window.find(PRODUCER, 3, 2, now=0) is None


@pytest.mark.parametrize(("first_number", "items"), [(1, 2), (2, 2), (1, 5), (3, 4), (2, 1)])
def test_numbers_of_a_known_run_in_another_run_are_refused(first_number: int, items: int) -> None:
    window = RetryWindow()
    window.record(PRODUCER, 1, accepted(3, 1))
    with pytest.raises(InvalidArgument, match="producer abc overlap the run 1 to 3"):
        window.find(PRODUCER, first_number, items, now=0)


def test_only_the_last_runs_of_a_producer_are_kept() -> None:
    window = RetryWindow()
    for number in range(1, 2 * RUNS_MAX + 1):
        window.record(PRODUCER, number, accepted(1, number))
    assert window.find(PRODUCER, RUNS_MAX, 1, now=0) is None
    found = [window.find(PRODUCER, number, 1, now=0) for number in range(RUNS_MAX + 1, 2 * RUNS_MAX + 1)]
    assert [one.first_seq for one in found if one is not None] == list(range(RUNS_MAX + 1, 2 * RUNS_MAX + 1))


def test_each_run_in_flight_of_a_producer_is_recognised_however_long_its_runs_are() -> None:
    """A producer whose connection broke sends up to 64 runs of 256 items again.

    In an earlier version, the window counted numbers, so only the last four runs were recognised.
    """
    window = RetryWindow()
    for run in range(64):
        window.record(PRODUCER, 1 + run * 256, accepted(256, 1 + run * 256))
    for run in range(64):
        assert window.find(PRODUCER, 1 + run * 256, 256, now=1) == accepted(256, 1 + run * 256)


def test_runs_are_forgotten_after_ten_minutes() -> None:
    window = RetryWindow()
    window.record(PRODUCER, 1, accepted(1, 1))
    assert window.find(PRODUCER, 1, 1, now=KEPT_NANOS - 1) is not None
    assert window.find(PRODUCER, 1, 1, now=KEPT_NANOS) is None


def test_the_longest_silent_producer_makes_room_for_another() -> None:
    window = RetryWindow(producers_max=2)
    window.record(1, 1, accepted(1, 1))
    window.record(2, 1, accepted(1, 2, now=1))
    window.record(1, 2, accepted(1, 3, now=2))
    window.record(3, 1, accepted(1, 4, now=3))
    assert len(window) == 2
    assert window.find(2, 1, 1, now=3) is None
    assert window.find(1, 1, 1, now=3) == accepted(1, 1)


def test_producers_that_were_silent_for_ten_minutes_are_forgotten_without_another_put() -> None:
    window = RetryWindow()
    assert window.next_expiry() is None
    window.record(1, 1, accepted(1, 1))
    window.record(2, 1, accepted(1, 2, now=5))
    assert window.next_expiry() == KEPT_NANOS
    window.expire(KEPT_NANOS)
    assert (len(window), window.next_expiry()) == (1, KEPT_NANOS + 5)
    window.expire(KEPT_NANOS + 5)
    assert (len(window), window.footprint_bytes) == (0, 0)


def test_a_window_at_its_bound_in_bytes_drops_the_longest_silent_producers() -> None:
    window = RetryWindow(bytes_max=100_000)
    for producer_id in range(1, 1001):
        window.record(producer_id, 1, accepted(1, producer_id))
    assert 90_000 < window.footprint_bytes <= 100_000
    assert window.find(1000, 1, 1, now=0) is not None
    assert window.find(1, 1, 1, now=0) is None


def test_the_memory_of_one_producer_has_a_bound_for_any_number_of_refusals() -> None:
    window = RetryWindow()
    refusals = [ItemRefusal(place, ChannelFull("full " * 100)) for place in range(1, 256)]
    for run in range(50):
        window.record(PRODUCER, 1 + run * 256, RunOutcome(256, 256, (RunPart(0, 1 + run, 1, None),), refusals, 0))
    assert window.footprint_bytes <= 2 * PRODUCER_BYTES_MAX
    assert window.find(PRODUCER, 1 + 49 * 256, 256, now=0) is not None


def test_a_thousand_puts_of_one_item_cost_tens_of_bytes_each_and_the_window_knows_it() -> None:
    """In an earlier version, the window took 607 kB for these puts, and no budget counted these bytes."""
    window = RetryWindow()
    tracemalloc.start()
    try:
        for number in range(1, RUNS_MAX + 1):
            window.record(PRODUCER, number, accepted(1, number, stamped=10**18 + number))
        size, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert size < 64 * RUNS_MAX
    assert size <= window.footprint_bytes <= 64 * RUNS_MAX


def test_many_producers_cost_the_memory_that_the_window_reports() -> None:
    window = RetryWindow()
    tracemalloc.start()
    try:
        for producer_id in range(1, 4097):
            window.record(2**40 + producer_id, 1, accepted(1, producer_id))
        size, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert size <= window.footprint_bytes <= 1.5 * size


def test_runs_of_producer_zero_are_never_recognised_as_retries() -> None:
    window = RetryWindow()
    window.record(0, 1, accepted(1, 1))
    assert window.find(0, 1, 1, now=0) is None
    assert len(window) == 0


def test_a_retry_window_is_exported_and_imported_as_values() -> None:
    window = RetryWindow()
    window.record(2, 1, accepted(1, 1, now=KEPT_NANOS))
    window.record(PRODUCER, 1, accepted(3, 2, now=10))
    window.record(PRODUCER, 4, half(2, 1, 5, now=KEPT_NANOS))
    window.record(PRODUCER, 6, accepted(1, 6, now=KEPT_NANOS + 5))
    restored = RetryWindow()
    for kept in window.kept(KEPT_NANOS + 10):
        restored.record(kept.producer_id, kept.first_number, kept.outcome)
    assert [*restored.kept(KEPT_NANOS + 10)] == [*window.kept(KEPT_NANOS + 10)]
    assert restored.find(PRODUCER, 4, 2, KEPT_NANOS + 10) == half(2, 1, 5, now=KEPT_NANOS)
    assert restored.find(PRODUCER, 1, 3, KEPT_NANOS + 10) is None
    with pytest.raises(InvalidArgument):
        restored.find(PRODUCER, 5, 1, KEPT_NANOS + 10)


def test_parts_whose_seqs_follow_each_other_are_one() -> None:
    progress = RunProgress(5)
    progress.accept(0, 1, 2, None)
    progress.accept(2, 3, 1, None)
    progress.accept(3, 9, 2, None)
    progress.judged_items = 5
    assert progress.outcome(0).parts == (RunPart(0, 1, 3, None), RunPart(3, 9, 2, None))


@pytest.mark.parametrize("bounds", [{"producers_max": 200}, {"bytes_max": 100_000}])
def test_one_caller_with_very_many_producers_displaces_only_its_own_producers(bounds: dict[str, int]) -> None:
    window = RetryWindow(**bounds)
    for producer_id in range(1, 11):
        window.record(producer_id, 1, accepted(1, producer_id), caller_name="good")
    for producer_id in range(1000, 3000):
        window.record(producer_id, 1, accepted(1, producer_id), caller_name="hostile")
    assert all(window.find(one, 1, 1, now=0) is not None for one in range(1, 11)), (
        "the good producers stay, although they were silent longest"
    )
    assert window.find(1000, 1, 1, now=0) is None
    assert window.find(2999, 1, 1, now=0) is not None
    assert len(window) <= 200 or window.footprint_bytes <= 100_000


def test_a_full_window_looks_at_all_producers_once_for_many_new_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    window, sheds = RetryWindow(producers_max=640), 0
    shed = RetryWindow._shed

    def counted(*arguments: Any) -> bool:
        nonlocal sheds
        sheds += 1
        return shed(*arguments)

    monkeypatch.setattr(RetryWindow, "_shed", counted)
    for producer_id in range(1, 1281):
        window.record(producer_id, 1, accepted(1, producer_id), caller_name="hostile")
    assert sheds <= 64
    assert 630 <= len(window) <= 640
