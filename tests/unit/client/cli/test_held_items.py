"""The earliest instant of the items that a command records and then plays."""

from __future__ import annotations

import pytest

from stampede_rt.cli.held_items import since_of
from stampede_rt.values.peering import CLOCKS_APART_NANOS, ClockOffset

SECOND = 10**9


def test_without_a_start_or_a_known_clock_all_items_are_read() -> None:
    assert since_of(None, 100 * SECOND, clock(0)) == "oldest"
    assert since_of(5, 100 * SECOND, None) == "oldest"


@pytest.mark.parametrize("ahead_s", [-3600, 0, 3600])
def test_a_machine_whose_clock_is_wrong_reads_all_items_from_the_start_on(ahead_s: int) -> None:
    now = 10**6 * SECOND  # the time at the hosts
    since = since_of(now - 60 * SECOND, now + ahead_s * SECOND, clock(ahead_s))
    assert int(since.removesuffix(" ns")) >= 60 * SECOND + CLOCKS_APART_NANOS


def clock(ahead_s: int) -> ClockOffset:
    return ClockOffset(offset_nanos=ahead_s * SECOND, uncertainty_nanos=1, supernode="s1")
