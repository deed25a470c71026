"""The pauses before a host process starts again."""

from __future__ import annotations

from stampede_rt_channel_host.supervisor import (
    PAUSE_SECONDS_MAX,
    PAUSE_SECONDS_MIN,
    STEADY_SECONDS,
    STOP_SECONDS_MAX,
    RestartPauses,
    Supervisor,
)


def test_the_pauses_of_a_process_that_fails_immediately_grow_up_to_a_bound() -> None:
    pauses = RestartPauses()
    found = [pauses.after(0.1) for _ in range(10)]
    assert found[:3] == [PAUSE_SECONDS_MIN, 2 * PAUSE_SECONDS_MIN, 4 * PAUSE_SECONDS_MIN]
    assert found == sorted(found)
    assert found[-1] == PAUSE_SECONDS_MAX


def test_a_process_that_ran_for_long_starts_again_after_the_shortest_pause() -> None:
    pauses = RestartPauses()
    for _ in range(10):
        pauses.after(0.1)
    assert pauses.after(STEADY_SECONDS) == PAUSE_SECONDS_MIN


def test_a_process_that_drains_its_channels_is_killed_only_after_its_drain_time() -> None:
    assert Supervisor([["host"]], drain_seconds=20).stop_seconds_max == 20 + STOP_SECONDS_MAX
