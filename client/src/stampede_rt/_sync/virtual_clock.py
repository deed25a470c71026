# Generated from ../_async by tools/generate.py; do not edit.
"""The clock of a replay: it moves only when a program waits."""

from __future__ import annotations

from collections.abc import Callable

from stampede_rt.transports.concurrency_sync import Signal, monotonic_s


class VirtualClock:
    """An instant that moves forward to the instants for which a program waits.

    `speed` 2.0: a wait of 1 s takes half a second of real time; 0: none. With `step` the instant moves only by `step`.
    `check` raises an error once the connection is closed; a wait calls it.
    """

    def __init__(self, start: int, speed: float, step: bool, check: Callable[[], None]) -> None:
        self.now = start
        self._start, self._speed, self._step = start, speed, step
        self._began_s = monotonic_s()
        self._check = check
        self._moved = Signal()  # is set, and replaced, whenever the instant moves

    def reach(self, instant: int) -> None:
        """Wait until the clock is at `instant`. Returns at once if it is already there."""
        while self.now < instant:
            self._check()
            moved, left_s = self._moved, self._left_s(instant)
            if self.now >= instant:
                return
            if left_s is not None and left_s <= 0:
                self.move(instant)
            else:
                moved.wait(left_s)

    def _left_s(self, instant: int) -> float | None:
        """Return the real time until the clock reaches `instant`; None: only `move` decides."""
        if self._step:
            return None
        if not self._speed:
            return 0.0
        return (instant - self._start) / 1e9 / self._speed - (monotonic_s() - self._began_s)

    def move(self, instant: int) -> None:
        """Move forward to `instant`, and wake the waiting calls."""
        self.now = max(self.now, instant)
        moved, self._moved = self._moved, Signal()
        moved.set()

    def close(self) -> None:
        """Wake the waiting calls, so that they notice that the connection is closed."""
        self.move(self.now)
