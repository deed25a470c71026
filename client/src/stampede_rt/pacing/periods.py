"""Computes when periodic work is due. Pure: the caller reads the clock."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(slots=True)
class Periods:
    """Due times `start + k * every`, counted from the start, so that delays do not add up.

    If the work is late by less than a period, the caller still does it. `missed` counts the due times that the caller
    skips, because the next due time has come as well.
    """

    start_nanos: int
    every_nanos: int
    missed: int = 0
    _next: int = 0

    def wait_nanos(self, now_nanos: int) -> int:
        """Return the nanoseconds until the next due time; 0 if the time has come."""
        return max(0, self.start_nanos + self._next * self.every_nanos - now_nanos)

    def begin(self, now_nanos: int) -> None:
        """Note that the due work begins at `now_nanos`. Earlier due times without work count as missed."""
        current = max(self._next, (now_nanos - self.start_nanos) // self.every_nanos)
        self.missed += current - self._next
        self._next = current + 1
