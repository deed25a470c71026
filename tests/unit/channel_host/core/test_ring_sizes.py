"""A ring has room for a burst of the longest runs, within its bounds."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as some

from stampede_rt_channel_host.core.ring_sizes import (
    DATA_BYTES_MAX,
    DATA_BYTES_MIN,
    RUNS_MIN,
    data_bytes_for,
    longest_run,
)


@given(some.integers(0, DATA_BYTES_MAX))
def test_a_ring_takes_the_runs_for_which_it_was_made(run_bytes: int) -> None:
    data_bytes = data_bytes_for(run_bytes)
    assert DATA_BYTES_MIN <= data_bytes <= DATA_BYTES_MAX
    assert data_bytes >= min(RUNS_MIN * run_bytes, DATA_BYTES_MAX)
    if run_bytes <= longest_run(DATA_BYTES_MAX):
        assert run_bytes <= longest_run(data_bytes)


@given(some.integers(0, DATA_BYTES_MAX))
def test_a_run_that_is_too_long_for_a_ring_gets_a_larger_ring_or_none(run_bytes: int) -> None:
    former = data_bytes_for(run_bytes // 2)
    if longest_run(former) < run_bytes <= longest_run(DATA_BYTES_MAX):
        assert data_bytes_for(run_bytes) > former
