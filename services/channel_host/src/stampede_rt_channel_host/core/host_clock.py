"""The host's time. It advances with the monotonic clock and follows the wall clock gradually (slewing). Pure.

So a step of the wall clock does not empty a retention window, and items do not stop aging (paper, section 3.1: real
time).
"""

from __future__ import annotations

CATCH_UP_NANOS = 30_000_000_000
"""The time in which host time makes up for an offset.

A small offset slews little: a millisecond changes the rate by 33 ppm.
"""

SLEW_PPM_MAX = 500_000
"""Host time runs at half the rate of the monotonic clock at the least, and at one and a half times that rate at the
most.

So a retention window holds at least two thirds of its age. A clock that was an hour wrong is right after two hours.
With NTP's 500 ppm that would take months.
"""


class HostTime:
    """Nanoseconds since the Unix epoch that never jump and never go back.

    The caller gives it the readings of both clocks, taken together. More frequent readings follow the wall clock more
    closely.
    """

    __slots__ = ("_carry", "_host", "_monotonic", "_offset")

    def __init__(self, monotonic_nanos: int, wall_unix_nano: int) -> None:
        """Starts at the wall clock's time."""
        self._monotonic = monotonic_nanos
        self._host = wall_unix_nano
        self._offset = 0
        # the rest of the correction below a nanosecond, times CATCH_UP_NANOS, so that frequent readings lose nothing
        self._carry = 0

    def read(self, monotonic_nanos: int, wall_unix_nano: int) -> int:
        """The host time at these readings. A monotonic reading before the last one counts as the last one."""
        elapsed = max(0, monotonic_nanos - self._monotonic)
        self._monotonic += elapsed
        straight = self._host + elapsed
        self._host = straight + self._correction(wall_unix_nano - straight, elapsed)
        self._offset = wall_unix_nano - self._host
        return self._host

    @property
    def offset_nanos(self) -> int:
        """The wall clock minus host time at the last reading, in nanoseconds: the offset still to be made up for."""
        return self._offset

    def _correction(self, offset: int, elapsed: int) -> int:
        """The part of an offset to make up for in `elapsed` nanoseconds: its share of the time to catch up, within the
        slew.
        """
        share = self._carry + offset * min(elapsed, CATCH_UP_NANOS)
        made_up = abs(share) // CATCH_UP_NANOS
        self._carry = (abs(share) % CATCH_UP_NANOS) * (1 if share > 0 else -1)
        made_up = min(made_up, abs(offset), elapsed * SLEW_PPM_MAX // 1_000_000)
        return made_up if share > 0 else -made_up
