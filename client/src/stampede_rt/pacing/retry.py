"""When to try again. Pure: the caller reads the clock and brings the randomness."""

from __future__ import annotations

from dataclasses import dataclass

FIRST_DELAY_S = 0.02
DELAY_S_MAX = 1.0


@dataclass(slots=True)
class Backoff:
    """Delays that double up to a bound, each random in its upper half, until `deadline_s` on the caller's clock."""

    deadline_s: float
    _delay_s: float = FIRST_DELAY_S

    def next_delay_s(self, now_s: float, jitter: float) -> float | None:
        """The seconds to wait before the next try, or None if there is no time left. `jitter` lies in [0, 1)."""
        if now_s >= self.deadline_s:
            return None
        delay = self._delay_s * (0.5 + jitter / 2)
        self._delay_s = min(self._delay_s * 2, DELAY_S_MAX)
        return min(delay, self.deadline_s - now_s)
