"""The two clocks of a host. Everything below a servicer takes values of them and never reads a clock itself."""

from __future__ import annotations

import time
from typing import Protocol


class HostClock(Protocol):
    """The clocks from which a service reads the time."""

    def time_unix_nano(self) -> int:
        """Wall-clock time, nanoseconds since the Unix epoch; it can jump when the machine's clock is set."""

    def boottime_nanos(self) -> int:
        """Nanoseconds since some fixed moment; never jumps, and counts the time that the machine was suspended."""


# macOS has no CLOCK_BOOTTIME; there CLOCK_MONOTONIC goes on while the machine sleeps.
_BOOTTIME = getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC)


class SystemClock:
    """The machine's clocks."""

    def time_unix_nano(self) -> int:
        """Wall-clock time, nanoseconds since the Unix epoch."""
        return time.time_ns()

    def boottime_nanos(self) -> int:
        """Nanoseconds since the machine started, suspension included: leases are measured by it."""
        return time.clock_gettime_ns(_BOOTTIME)
