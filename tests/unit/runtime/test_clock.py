"""The clock of the system, and the clock that tests set by hand."""

from __future__ import annotations

import time

import pytest

from stampede_rt_runtime.clock import HostClock, SystemClock
from tests.support.clock import ManualClock


def test_the_system_clock_gives_the_time_since_the_epoch() -> None:
    before = time.time_ns()
    now = SystemClock().time_unix_nano()
    assert before <= now <= time.time_ns()


def test_the_boot_time_never_goes_back() -> None:
    clock = SystemClock()
    readings = [clock.boottime_nanos() for _ in range(1000)]
    assert readings == sorted(readings)


def test_setting_the_wall_clock_of_the_system_does_not_change_the_boot_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(time, "time_ns", lambda: 5)
    clock = SystemClock()
    assert clock.time_unix_nano() == 5
    before = time.clock_gettime_ns(time.CLOCK_BOOTTIME)
    assert before <= clock.boottime_nanos() <= time.clock_gettime_ns(time.CLOCK_BOOTTIME)


def test_setting_the_wall_clock_of_a_manual_clock_does_not_change_its_boot_time() -> None:
    clock = ManualClock()
    as_interface: HostClock = clock
    before = as_interface.boottime_nanos()
    clock.set_wall_clock(5)
    assert as_interface.time_unix_nano() == 5
    assert as_interface.boottime_nanos() == before
    clock.advance(7)
    assert (as_interface.time_unix_nano(), as_interface.boottime_nanos()) == (12, before + 7)
