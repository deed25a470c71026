"""A limit of bytes a second, with bursts. Pure: the caller passes the time."""

from __future__ import annotations


class TokenBucket:
    """Lets `rate` bytes a second through, and at most `burst` in one step."""

    def __init__(self, rate: float, burst: float, now_s: float) -> None:
        self._rate, self._burst = rate, burst
        self._tokens_left, self._at_s = burst, now_s

    def spend(self, size: int, now_s: float) -> float:
        """Take `size` bytes. Returns the seconds that the caller must wait before it sends them; 0: none."""
        self._tokens_left = min(self._burst, self._tokens_left + (now_s - self._at_s) * self._rate)
        self._at_s = now_s
        self._tokens_left -= size
        return max(0.0, -self._tokens_left / self._rate)
