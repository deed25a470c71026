"""The instants at which items are due. They are exact in each loop of the clip."""

import numpy as np
import pytest
from hypothesis import given, strategies

from stampede_rt_demos.staging.schedule import LoopedClock, planned_blocks, planned_frames

MS = 1_000_000
START = 1_700_000_000_123_456_789


def test_the_loops_follow_each_other_without_a_gap():
    clock = LoopedClock([0, 40, 80], 120)
    assert [clock.offset(n) for n in range(7)] == [0, 40, 80, 120, 160, 200, 240]


def test_uneven_timestamps_are_kept_in_every_loop():
    clock = LoopedClock([0, 40, 70], 120)
    assert [clock.offset(n) for n in range(6)] == [0, 40, 70, 120, 160, 190]
    assert clock.end(2) == 120


def test_a_day_of_frames_has_not_drifted_by_a_nanosecond():
    clock = LoopedClock([n * 40 * MS for n in range(132)], 5280 * MS)
    assert clock.offset(25 * 86_400) == 86_400_000 * MS


@given(strategies.lists(strategies.integers(1, 100), min_size=1, max_size=20), strategies.integers(-5, 5000))
def test_the_count_before_an_instant_is_the_number_of_items_that_begin_earlier(gaps, nanos):
    ends = np.cumsum(gaps).tolist()
    clock = LoopedClock([0, *ends[:-1]], ends[-1])
    count = clock.count_before(nanos)
    assert count == 0 or clock.offset(count - 1) < nanos
    assert clock.offset(count) >= nanos


@pytest.mark.parametrize(("offsets", "loop"), [([], 10), ([1, 2], 10), ([0, 5, 5], 10), ([0, 7, 3], 10), ([0, 5], 5)])
def test_timestamps_that_make_no_loop_of_the_clip_are_refused(offsets, loop):
    with pytest.raises(ValueError, match="loop"):
        LoopedClock(offsets, loop)


def test_frames_last_until_the_next_one_and_repeat_with_the_loop():
    plan = list(planned_frames(LoopedClock([0, 40 * MS, 80 * MS], 120 * MS), [b"a", b"b", b"c"], START, 200 * MS))
    assert [frame.payload for frame in plan] == [b"a", b"b", b"c", b"a", b"b"]
    assert [frame.time - START for frame in plan] == [0, 40 * MS, 80 * MS, 120 * MS, 160 * MS]
    assert {frame.duration for frame in plan} == {40 * MS}
    assert all(frame.due == frame.time for frame in plan)
    assert plan[3].clip_nanos == 0


def test_blocks_run_on_over_the_end_of_the_loop_sample_by_sample():
    samples = np.arange(10, dtype=np.int16)
    plan = list(planned_blocks(samples, 1000, 4 * MS, START, 12 * MS))
    blocks = [np.frombuffer(block.payload, "<i2").tolist() for block in plan]
    assert blocks == [[0, 1, 2, 3], [4, 5, 6, 7], [8, 9, 0, 1]]
    assert [block.clip_nanos for block in plan] == [0, 4 * MS, 8 * MS]


def test_a_block_is_due_when_its_last_sample_has_been_heard():
    (block,) = planned_blocks(np.zeros(8, dtype=np.int16), 1000, 4 * MS, START, 4 * MS)
    assert (block.time, block.due, block.duration) == (START, START + 4 * MS, 4 * MS)


def test_blocks_that_are_no_whole_number_of_samples_are_refused():
    with pytest.raises(ValueError, match="no whole number of samples"):
        list(planned_blocks(np.zeros(8, dtype=np.int16), 44_100, 125 * MS, START, 1000 * MS))
