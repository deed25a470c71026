"""The clock of a replay: it moves only when a program waits."""

from __future__ import annotations

from stampede_rt.errors import Unavailable
from stampede_rt.transports.concurrency_async import Signal, monotonic_s


class VirtualClock:
    """An instant that moves forward to the instants for which a program waits.

    `speed` 2.0: a wait of 1 s takes half a second of real time; 0: no real time. With `step` only `step` moves the
    instant. A connection ends its clocks when it closes (`SessionTask`).
    """

    def __init__(self, start: int, speed: float, step: bool) -> None:
        self.now = start
        self._start, self._speed, self._step = start, speed, step
        self._began_s = monotonic_s()
        self._closed = False
        self._moved = Signal()  # is set, and replaced, whenever the instant moves

    async def reach(self, instant: int) -> None:
        """Wait until the clock is at `instant`. Returns immediately if the clock is already there.

        Raises Unavailable when the replay or its connection is closed.
        """
        while True:
            moved = self._moved
            self.check_open()
            if self.now >= instant:
                return
            left_s = self._left_s(instant)
            if left_s is not None and left_s <= 0:
                self.move(instant)
            else:
                await moved.wait(left_s)

    def check_open(self) -> None:
        """Raise Unavailable if the replay or its connection is closed."""
        if self._closed:
            raise Unavailable("this replay, or its connection, is closed; call replay() again")

    def _left_s(self, instant: int) -> float | None:
        """Return the real time until the clock reaches `instant`; None: the clock moves only by `move`."""
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
        """End the waiting calls and all later ones with an error."""
        self._closed = True
        self.move(self.now)

    async def end(self) -> None:
        """Close, because the connection closes."""
        self.close()
