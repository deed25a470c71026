"""Computes when to try again. Pure: the caller reads the clock and gives the random numbers."""

from __future__ import annotations

from dataclasses import dataclass

FIRST_DELAY_S = 0.02
DELAY_S_MAX = 1.0
OPEN_STREAMS_S = 1.0
"""The time for which a call tries again at a quota of open streams.

The server may still count streams whose connection has broken.
"""


@dataclass(slots=True)
class Backoff:
    """The delays between tries, until `deadline_s` on the caller's clock.

    The longest possible delay doubles from try to try, from FIRST_DELAY_S to DELAY_S_MAX. Each delay is random: between
    half of the longest possible delay and all of it.
    """

    deadline_s: float
    _delay_s: float = FIRST_DELAY_S

    def end_within(self, time_s: float, now_s: float) -> None:
        """Begin no further try later than `time_s` seconds from now."""
        self.deadline_s = min(self.deadline_s, now_s + time_s)

    def next_delay_s(self, now_s: float, jitter: float) -> float | None:
        """Return the seconds to wait before the next try, or None if no time is left. `jitter` is random, in [0, 1)."""
        if now_s >= self.deadline_s:
            return None
        delay = self._delay_s * (0.5 + jitter / 2)
        self._delay_s = min(self._delay_s * 2, DELAY_S_MAX)
        return min(delay, self.deadline_s - now_s)
