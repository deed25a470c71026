"""The host's time. It advances with the monotonic clock and follows the wall clock gradually (slewing). Pure.

So a step of the wall clock does not empty a retention window, and items do not stop aging (paper, section 3.1: real
time).
"""

from __future__ import annotations

CATCH_UP_NANOS = 30_000_000_000
"""At its present rate, host time would reach the wall clock in this time.

So a small offset changes the rate little: an offset of a millisecond changes it by 33 ppm.
"""

SLEW_PPM_MAX = 500_000
"""Host time runs at half the rate of the monotonic clock at the least, and at one and a half times that rate at the
most.

So a retention window of an hour of host time covers at least 40 real minutes. After a step of the wall clock by an
hour, host time needs about two hours to follow. With NTP's 500 ppm this would take months.
"""


class HostTime:
    """Host time, in nanoseconds since the Unix epoch. It never jumps and never goes back.

    The caller passes a reading of the monotonic clock and a reading of the wall clock, both taken at the same moment.
    Host time follows the wall clock more closely if the caller reads the clocks more often.
    """

    __slots__ = ("_carry", "_host", "_monotonic", "_offset")

    def __init__(self, monotonic_nanos: int, wall_unix_nano: int) -> None:
        """Host time starts at the wall clock's time."""
        self._monotonic = monotonic_nanos
        self._host = wall_unix_nano
        self._offset = 0
        # the rest of the correction below a nanosecond, times CATCH_UP_NANOS, so that frequent readings lose nothing
        self._carry = 0

    def read(self, monotonic_nanos: int, wall_unix_nano: int) -> int:
        """The host time at these readings. If the monotonic reading is before the last one, the last one counts."""
        elapsed = max(0, monotonic_nanos - self._monotonic)
        self._monotonic += elapsed
        straight = self._host + elapsed
        self._host = straight + self._correction(wall_unix_nano - straight, elapsed)
        self._offset = wall_unix_nano - self._host
        return self._host

    @property
    def offset_nanos(self) -> int:
        """The wall clock minus host time at the last reading, in nanoseconds. Host time still has to make up for it."""
        return self._offset

    def _correction(self, offset: int, elapsed: int) -> int:
        """The nanoseconds by which host time moves towards the wall clock in `elapsed` nanoseconds.

        This is the share `elapsed / CATCH_UP_NANOS` of the offset, limited by SLEW_PPM_MAX.
        """
        share = self._carry + offset * min(elapsed, CATCH_UP_NANOS)
        if -CATCH_UP_NANOS < share < CATCH_UP_NANOS:  # the usual case, in which the lines below would do the same
            self._carry = share
            return 0
        made_up = abs(share) // CATCH_UP_NANOS
        self._carry = (abs(share) % CATCH_UP_NANOS) * (1 if share > 0 else -1)
        made_up = min(made_up, abs(offset), elapsed * SLEW_PPM_MAX // 1_000_000)
        return made_up if share > 0 else -made_up
