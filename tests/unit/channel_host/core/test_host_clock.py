"""The host's clock follows the monotonic clock, and approaches the wall clock slowly."""

from __future__ import annotations

from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from stampede_rt_channel_host.core.host_clock import HostTime

SECOND = 1_000_000_000


def test_host_time_starts_at_the_wall_clock_and_advances_with_the_monotonic_clock() -> None:
    clock = HostTime(5, 100 * SECOND)
    assert clock.read(5 + SECOND, 101 * SECOND) == 101 * SECOND
    assert clock.offset_nanos == 0


def test_host_time_corrects_a_small_offset_slowly() -> None:
    clock = HostTime(0, 0)
    millisecond = 1_000_000
    assert clock.read(SECOND, SECOND + 30 * millisecond) == SECOND + millisecond
    assert clock.read(2 * SECOND, 2 * SECOND + 31 * millisecond) == 2 * SECOND + 2 * millisecond
    for second in range(3, 400):
        clock.read(second * SECOND, second * SECOND + 30 * millisecond)
    assert clock.offset_nanos < 1000


def test_frequent_readings_correct_an_offset_as_fast_as_rare_ones() -> None:
    clock = HostTime(0, 0)
    for step in range(1, 100_001):
        clock.read(step * 1000, step * 1000 + 1_000_000)
    # The share of 1 ms after 0.1 s, if the time constant is 30 s: 1 - exp(-0.1 / 30), rounded down.
    assert 1_000_000 - clock.offset_nanos == 3327


def test_host_time_catches_up_with_a_wall_clock_step_of_an_hour_in_about_two_hours() -> None:
    clock = HostTime(0, 0)
    assert clock.read(SECOND, 3601 * SECOND) == SECOND + SECOND // 2
    for second in range(2, 7400):
        clock.read(second * SECOND, (second + 3600) * SECOND)
    assert clock.offset_nanos < SECOND


def test_a_wall_clock_that_steps_back_never_turns_host_time_back() -> None:
    clock = HostTime(0, 3600 * SECOND)
    times = [clock.read(step * SECOND, step * SECOND) for step in range(1, 100)]
    assert [after - before for before, after in pairwise(times)] == [SECOND // 2] * 98


def test_a_monotonic_reading_before_the_last_one_counts_as_the_last_one() -> None:
    clock = HostTime(10, 1000)
    assert clock.read(20, 1010) == 1010
    assert clock.read(15, 5000) == 1010


@given(st.lists(st.tuples(st.integers(0, 10**10), st.integers(-(10**13), 10**13)), max_size=30))
def test_host_time_keeps_within_the_slew_of_elapsed_time_at_every_step_of_the_wall_clock(
    steps: list[tuple[int, int]],
) -> None:
    monotonic, clock = 0, HostTime(0, 0)
    before = 0
    for elapsed, wall in steps:
        monotonic += elapsed
        host = clock.read(monotonic, wall)
        assert elapsed - elapsed // 2 <= host - before <= elapsed + elapsed // 2
        assert abs(wall - host) <= max(1, abs(wall - before - elapsed))
        assert clock.offset_nanos == wall - host
        before = host
