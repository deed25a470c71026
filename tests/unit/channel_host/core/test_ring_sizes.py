"""A ring has room for a burst of the longest runs, within its bounds, and is shorter where memory is short."""

from __future__ import annotations

from itertools import pairwise

from hypothesis import given, strategies

from stampede_rt_channel_host.core.ring_sizes import (
    DATA_BYTES_MAX,
    DATA_BYTES_MIN,
    RUNS_MIN,
    RUNS_OF_SHORT_RING,
    SHORT_DATA_BYTES_MIN,
    RecentRuns,
    ring_fits_for,
)

RUN_BYTES_MAX = DATA_BYTES_MAX // RUNS_OF_SHORT_RING


@given(strategies.integers(0, RUN_BYTES_MAX))
def test_every_possible_ring_takes_the_runs_for_which_it_is_made(run_bytes: int) -> None:
    fits = [*ring_fits_for(run_bytes)]
    assert DATA_BYTES_MIN <= fits[0].data_bytes <= DATA_BYTES_MAX
    assert fits[0].data_bytes >= min(RUNS_MIN * run_bytes, DATA_BYTES_MAX)
    for fit in fits:
        assert max(run_bytes, SHORT_DATA_BYTES_MIN // RUNS_OF_SHORT_RING) <= fit.longest_run or fit is fits[0]
        assert run_bytes <= fit.longest_run <= fit.data_bytes // RUNS_OF_SHORT_RING
    assert all(shorter.data_bytes * 2 == longer.data_bytes for longer, shorter in pairwise(fits))


@given(strategies.integers(RUN_BYTES_MAX + 1, 2 * DATA_BYTES_MAX))
def test_runs_that_are_too_long_for_the_largest_ring_get_no_ring(run_bytes: int) -> None:
    assert not [*ring_fits_for(run_bytes)]


@given(strategies.integers(0, RUN_BYTES_MAX))
def test_a_run_that_is_too_long_for_a_ring_gets_a_larger_ring(run_bytes: int) -> None:
    former, best = next(ring_fits_for(run_bytes // 2)), next(ring_fits_for(run_bytes))
    assert (best.data_bytes > former.data_bytes) is (run_bytes > former.longest_run)


@given(strategies.integers(0, RUN_BYTES_MAX), strategies.integers(0, RUN_BYTES_MAX))
def test_the_size_of_a_ring_is_near_the_best_size_if_neither_is_twice_the_other(one: int, other: int) -> None:
    ring, best = next(ring_fits_for(one)), next(ring_fits_for(other))
    assert ring.is_near(ring)
    assert ring.is_near(best) is (0.5 < ring.data_bytes / best.data_bytes < 2)


def test_the_longest_run_counts_for_one_to_two_periods() -> None:
    recent = RecentRuns(7)
    recent.note(5)
    assert [recent.begin_period() for _ in range(3)] == [7, 7, 0]
    recent.note(3)
    assert recent.begin_period() == 3
