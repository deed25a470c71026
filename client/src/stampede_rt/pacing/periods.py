"""When something periodic is due. Pure: the caller brings the clock's readings."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(slots=True)
class Periods:
    """Due times `start + k * every`, counted from the start, so that no delay adds up.

    What is late by less than a period is still done; periods that have passed as a whole are skipped and counted.
    """

    start_nanos: int
    every_nanos: int
    missed: int = 0
    _next: int = 0

    def wait_nanos(self, now_nanos: int) -> int:
        """How long until the next one is due; 0 if it is."""
        return max(0, self.start_nanos + self._next * self.every_nanos - now_nanos)

    def begin(self, now_nanos: int) -> None:
        """The due one is being done at `now_nanos`; those before it that nobody did are missed."""
        current = max(self._next, (now_nanos - self.start_nanos) // self.every_nanos)
        self.missed += current - self._next
        self._next = current + 1
