"""A copy for which a host waits must come nearer to its source."""

from __future__ import annotations

from stampede_rt_channel_host.core.channel import CATCH_UP_NANOS, LagWatch


def test_a_copy_whose_lag_grows_is_marked_as_lagging_after_a_while() -> None:
    watch = LagWatch()
    assert not watch.stays_behind(100, 0)
    assert not watch.stays_behind(150, CATCH_UP_NANOS - 1)
    assert watch.stays_behind(150, CATCH_UP_NANOS)


def test_a_copy_that_catches_up_or_was_level_is_not_marked_as_lagging() -> None:
    watch = LagWatch()
    for step in range(9):
        assert not watch.stays_behind(100 - step, step * CATCH_UP_NANOS)
    assert not watch.stays_behind(0, 9 * CATCH_UP_NANOS)
    assert not watch.stays_behind(200, 10 * CATCH_UP_NANOS)
    assert watch.stays_behind(200, 11 * CATCH_UP_NANOS)
