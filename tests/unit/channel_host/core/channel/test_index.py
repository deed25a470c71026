"""The two indexes against a plain sorted list, at sizes where they are split into many blocks."""

from __future__ import annotations

import random

from stampede_rt_channel_host.core.channel.index import ChannelIndex
from stampede_rt_channel_host.core.channel.item_keys import FIRST_KEY, LAST_KEY
from stampede_rt_channel_host.core.channel.run import make_run
from tests.support.channel_host.channel_cores import seqs_of, times_of

Entries = list[tuple[int, int]]


def fill(index: ChannelIndex, rng: random.Random, runs: int, late: int) -> Entries:
    """Insert runs of up to 8 items, each at most `late` behind the newest time. Returns all (time, seq), sorted."""
    entries: Entries = []
    time = 0
    for _ in range(runs):
        time += rng.randrange(10)
        times = [time - rng.randrange(late + 1) for _ in range(rng.randrange(1, 9))]
        first_seq = len(entries) + 1
        index.insert(make_run(first_seq, times, None, [1] * len(times), b""))
        entries += [(one, first_seq + at) for at, one in enumerate(times)]
    return sorted(entries)


def test_the_slices_between_any_two_keys_have_the_items_between_them_in_order() -> None:
    rng, index = random.Random(1), ChannelIndex()
    entries = fill(index, rng, 3000, late=60)
    for _ in range(30):
        low, high = sorted((rng.choice(entries), rng.choice(entries)))
        expected = [entry for entry in entries if low <= entry < high]
        slices = list(index.slices(low, high))
        assert list(zip(times_of(slices), seqs_of(slices), strict=True)) == expected
        assert list(index.slices_down(low, high)) == slices[::-1]


def test_the_slices_by_seq_are_the_items_in_the_order_in_which_they_came() -> None:
    rng, index = random.Random(2), ChannelIndex()
    entries = fill(index, rng, 2000, late=60)
    for _ in range(100):
        low, high = sorted((rng.randrange(1, len(entries)), rng.randrange(1, len(entries))))
        floor = rng.choice(entries)
        expected = sorted(seq for time, seq in entries if low <= seq < high and (time, seq) >= floor)
        assert seqs_of(list(index.slices_by_seq(low, high, floor))) == expected


def test_the_next_and_the_last_time_are_found_for_any_instant() -> None:
    rng, index = random.Random(3), ChannelIndex()
    times = [time for time, _ in fill(index, rng, 1500, late=30)]
    for instant in range(times[0] - 1, times[0] + 800):
        assert index.next_time(instant) == min((time for time in times if time > instant), default=None)
        assert index.last_time_up_to(instant) == max((time for time in times if time <= instant), default=None)
    assert index.next_time(times[-1]) is None


def test_each_run_that_comes_in_order_makes_one_entry() -> None:
    index = ChannelIndex()
    for first in range(0, 10_000, 100):
        index.insert(make_run(first + 1, range(first, first + 100), None, [1] * 100, b""))
    assert len(index) == 100


def test_a_late_item_splits_the_run_into_whose_times_it_falls() -> None:
    index = ChannelIndex()
    index.insert(make_run(1, [10, 20, 30], None, [1, 1, 1], b"early"))
    index.insert(make_run(4, [20], None, [1], b"late"))
    slices = list(index.slices(FIRST_KEY, LAST_KEY))
    assert seqs_of(slices) == [1, 2, 4, 3]
    assert [part.run.body for part in slices] == [b"early", b"early", b"late", b"early"]
    assert [part.is_whole for part in slices] == [False, False, True, False]


def test_entries_are_removed_from_the_front_until_one_reaches_the_floor() -> None:
    rng, index = random.Random(4), ChannelIndex()
    entries = fill(index, rng, 800, late=40)
    floor = entries[len(entries) // 2]
    while index.pop_below(floor) is not None:
        pass
    expected = [entry for entry in entries if entry >= floor]
    slices = list(index.slices(floor, LAST_KEY))
    assert list(zip(times_of(slices), seqs_of(slices), strict=True)) == expected
    assert list(index.slices_from(floor)) == slices
    assert seqs_of(list(index.slices_by_seq(0, 10**9, floor))) == sorted(seq for _, seq in expected)
