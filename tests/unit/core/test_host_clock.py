from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stampede_rt_channel_host.core import HostTime

SECOND = 1_000_000_000


def test_host_time_starts_at_the_wall_clock_and_advances_with_the_monotonic_one() -> None:
    clock = HostTime(5, 100 * SECOND)
    assert clock.read(5 + SECOND, 101 * SECOND) == 101 * SECOND
    assert clock.offset_nanos == 0


def test_a_wall_clock_that_steps_ahead_is_followed_slowly_until_it_is_reached() -> None:
    clock = HostTime(0, 0)
    assert clock.read(SECOND, SECOND + SECOND) == SECOND + 500_000
    assert clock.offset_nanos == SECOND - 500_000
    assert clock.read(3000 * SECOND, 3001 * SECOND) == 3001 * SECOND
    assert clock.offset_nanos == 0


def test_a_wall_clock_that_steps_back_never_turns_host_time_back() -> None:
    clock = HostTime(0, 3600 * SECOND)
    times = [clock.read(step * SECOND // 10, step * SECOND // 10) for step in range(1, 100)]
    assert times == sorted(times)
    assert times[-1] == 3600 * SECOND + 99 * SECOND // 10 - 99 * 50_000


def test_a_monotonic_reading_from_before_counts_as_the_last_one() -> None:
    clock = HostTime(10, 1000)
    assert clock.read(20, 1010) == 1010
    assert clock.read(15, 5000) == 1010


@pytest.mark.parametrize("slew_ppm", [0, -1, 1_000_000])
def test_a_slew_that_would_stop_or_reverse_time_is_refused(slew_ppm: int) -> None:
    with pytest.raises(ValueError, match=f"slew_ppm is {slew_ppm}"):
        HostTime(0, 0, slew_ppm=slew_ppm)


@given(st.lists(st.tuples(st.integers(0, 10**10), st.integers(-(10**13), 10**13)), max_size=30))
def test_host_time_keeps_within_the_slew_of_elapsed_time_whatever_the_wall_clock_does(
    steps: list[tuple[int, int]],
) -> None:
    monotonic, clock = 0, HostTime(0, 0)
    before = 0
    for elapsed, wall in steps:
        monotonic += elapsed
        host = clock.read(monotonic, wall)
        assert abs(host - before - elapsed) <= elapsed * 500 // 1_000_000
        assert clock.offset_nanos == wall - host
        before = host
