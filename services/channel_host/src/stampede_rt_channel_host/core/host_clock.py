"""The time a host lives by: it advances with the monotonic clock and follows the wall clock by slewing. Pure.

A stepped wall clock neither empties a retention window nor freezes one (paper, section 3.1: real time).
"""

from __future__ import annotations

CATCH_UP_NANOS = 30_000_000_000
"""An offset melts away within about this time; the smaller, the more gently: a millisecond bends time by 33 ppm."""

SLEW_PPM_MAX = 500_000
"""Never more than half as fast or slow again as the monotonic clock: a window then holds two thirds of its age, at the
least, and a clock that was an hour wrong is right after two, not after the months that NTP's 500 ppm would take."""


class HostTime:
    """Nanoseconds since the Unix epoch that never step and never run backwards.

    The caller feeds it both clocks' readings, taken together; the oftener, the closer it follows.
    """

    __slots__ = ("_carry", "_host", "_monotonic", "_offset")

    def __init__(self, monotonic_nanos: int, wall_unix_nano: int) -> None:
        """Starts at the wall clock's time."""
        self._monotonic = monotonic_nanos
        self._host = wall_unix_nano
        self._offset = 0
        self._carry = 0  # less than a nanosecond of correction, times CATCH_UP_NANOS: quick readings lose nothing

    def read(self, monotonic_nanos: int, wall_unix_nano: int) -> int:
        """Host time at these readings. A monotonic reading before the last one counts as that one."""
        elapsed = max(0, monotonic_nanos - self._monotonic)
        self._monotonic += elapsed
        straight = self._host + elapsed
        self._host = straight + self._correction(wall_unix_nano - straight, elapsed)
        self._offset = wall_unix_nano - self._host
        return self._host

    @property
    def offset_nanos(self) -> int:
        """How far the wall clock was ahead of host time at the last reading; what is still to be slewed."""
        return self._offset

    def _correction(self, offset: int, elapsed: int) -> int:
        """The part of an offset that is made up for in `elapsed`: its share of the time to catch up, as the slew
        allows."""
        share = self._carry + offset * min(elapsed, CATCH_UP_NANOS)
        made_up = abs(share) // CATCH_UP_NANOS
        self._carry = (abs(share) % CATCH_UP_NANOS) * (1 if share > 0 else -1)
        made_up = min(made_up, abs(offset), elapsed * SLEW_PPM_MAX // 1_000_000)
        return made_up if share > 0 else -made_up
