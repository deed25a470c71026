"""The time a host lives by: it advances with the monotonic clock and follows the wall clock by slewing. Pure.

A stepped wall clock neither empties a retention window nor freezes one (paper, section 3.1: real time).
"""

from __future__ import annotations

SLEW_PARTS_PER_MILLION = 500
"""The most by which host time runs faster or slower than the monotonic clock, as NTP's own slewing does."""


class HostTime:
    """Nanoseconds since the Unix epoch that never step and never run backwards.

    The caller feeds it both clocks' readings, taken together; the oftener, the closer it follows.
    """

    __slots__ = ("_host", "_monotonic", "_offset", "_slew_ppm")

    def __init__(self, monotonic_nanos: int, wall_unix_nano: int, *, slew_ppm: int = SLEW_PARTS_PER_MILLION) -> None:
        """Starts at the wall clock's time. `slew_ppm` lies between 1 and 999,999."""
        if not 0 < slew_ppm < 1_000_000:
            raise ValueError(f"slew_ppm is {slew_ppm}; it is at least 1 and less than 1000000")
        self._monotonic = monotonic_nanos
        self._host = wall_unix_nano
        self._offset = 0
        self._slew_ppm = slew_ppm

    def read(self, monotonic_nanos: int, wall_unix_nano: int) -> int:
        """Host time at these readings. A monotonic reading before the last one counts as that one."""
        elapsed = max(0, monotonic_nanos - self._monotonic)
        self._monotonic += elapsed
        straight = self._host + elapsed
        most = elapsed * self._slew_ppm // 1_000_000
        correction = max(-most, min(most, wall_unix_nano - straight))
        self._host = straight + correction
        self._offset = wall_unix_nano - self._host
        return self._host

    @property
    def offset_nanos(self) -> int:
        """How far the wall clock was ahead of host time at the last reading; what is still to be slewed."""
        return self._offset
