"""The two clocks of a machine. Servicers read them, and pass the times to the core, which reads no clock itself."""

from __future__ import annotations

import time
from typing import Protocol


class HostClock(Protocol):
    """The clocks from which a service reads the time."""

    def time_unix_nano(self) -> int:
        """Wall-clock time in nanoseconds since the Unix epoch. It can jump when the machine's clock is set."""

    def boottime_nanos(self) -> int:
        """Nanoseconds since some fixed moment. Never jumps, and counts the time in which the machine was suspended."""


# macOS has no CLOCK_BOOTTIME; its CLOCK_MONOTONIC continues while the machine sleeps.
_BOOTTIME = getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC)


class SystemClock:
    """The machine's clocks."""

    def time_unix_nano(self) -> int:
        """Wall-clock time, nanoseconds since the Unix epoch."""
        return time.time_ns()

    def boottime_nanos(self) -> int:
        """Nanoseconds since the machine started, suspension included. Leases use this clock."""
        return time.clock_gettime_ns(_BOOTTIME)
