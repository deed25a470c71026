"""Shares the time of one event loop among callers, so that one caller with much work does not delay the others. Pure.

A step is the work for one message or one call, or one piece of a long task. While several callers have work, each
caller may use its percentage of the loop's time. If a caller has used more, its next steps wait in a line. Each caller
has its own line, in the order in which the steps came. In each turn of the loop at most one step of each line runs.
Otherwise all steps that became due while the loop was busy or had no processor would run in one turn. A caller that has
been the only one with work for CONTENDED_NANOS does not wait.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

BURST_NANOS = 4_000_000
"""A caller may begin a step this long before it is due by the caller's percentage. At 50 % this is 2 ms of work."""
CONTENDED_NANOS = 100_000_000
"""For this time after one caller has worked right after another, several callers count as having work."""
PAUSE_SECONDS_MIN = 0.0005  # the shortest time after which a line looks again whether it must still wait
_SECOND_NANOS = 10**9

Schedule = Callable[[float, Callable[[], None]], object]
"""Calls a function after a delay in seconds; 0: in the next turn of the event loop."""


class LoopShares:
    """The shares of the callers in the time of one event loop.

    `now` returns nanoseconds of a clock that never goes back.
    """

    def __init__(self, now: Callable[[], int], schedule: Schedule) -> None:
        self.now = now
        self.schedule = schedule
        self.contended_until = 0
        """The time until which several callers count as having work."""
        self.latest = 0
        """The time at which a caller last ended a step."""
        self._last: LoopShare | None = None

    def works(self, loop_share: LoopShare, now: int) -> bool:
        """Note that a caller has worked. Returns whether several callers have work."""
        self.latest = now
        if loop_share is not self._last:
            if self._last is not None:
                self.contended_until = now + CONTENDED_NANOS
            self._last = loop_share
        return now < self.contended_until


class LoopShare:
    """The share of one caller in the time of the event loop: its line of waiting steps, and the time it has used.

    `percent`: the caller's share of the loop's time while other callers have work. With 100 or more, the caller waits
    only after a step that takes longer than BURST_NANOS.
    """

    __slots__ = (
        "_before_nanos",
        "_busy_until",
        "_later_nanos",
        "_line",
        "_second",
        "_shares",
        "_ticking",
        "_used_nanos",
        "percent",
    )  # fmt: skip

    def __init__(self, loop_shares: LoopShares, percent: int) -> None:
        self.percent = percent
        self._shares = loop_shares
        self._line: deque[Callable[[], None]] = deque()
        self._ticking = False
        self._later_nanos = 0  # the time of the present step that is counted at its end
        self._busy_until = 0  # when the next step is due, if the caller uses exactly its percentage
        self._second = 0
        self._used_nanos = self._before_nanos = 0  # the time used in this second, and in the second before

    @property
    def has_line(self) -> bool:
        """Whether a step of the caller waits."""
        return bool(self._line)

    @property
    def must_wait(self) -> bool:
        """Whether the caller's next step must wait in line, see `enqueue`."""
        if self._line:
            return True
        if self._held_for(self._shares.latest) <= 0:
            return False  # waits only get shorter, so an earlier time suffices, and saves the slow call of `now`
        return self._held_for(self._shares.now()) > 0

    def enqueue(self, wake: Callable[[], None]) -> None:
        """Add a step to the caller's line. Calls `wake` when the step may run."""
        self._line.append(wake)
        self._tick_later(self._shares.now())

    def spend(self, nanos: int) -> None:
        """Note the time that a step of the caller took."""
        now = self._shares.now()
        nanos, self._later_nanos = nanos + self._later_nanos, 0
        self._count(nanos, now)
        if self._shares.works(self, now):
            self._busy_until = max(self._busy_until, now) + nanos * 100 // max(1, self.percent)

    def spend_later(self, nanos: int) -> None:
        """Note further time of the present step, whose end calls `spend`."""
        self._later_nanos += nanos

    def _held_for(self, now: int) -> int:
        """The nanoseconds for which the next step must wait; 0 or less: it need not wait."""
        return min(self._busy_until - BURST_NANOS, self._shares.contended_until) - now

    def _tick_later(self, now: int) -> None:
        if not self._ticking:
            self._ticking = True
            held = self._held_for(now)
            self._shares.schedule(max(held / 1e9, PAUSE_SECONDS_MIN) if held > 0 else 0.0, self._tick)

    def _tick(self) -> None:
        """Wake one step, unless the line must still wait. If steps are left, schedule the next call of this method."""
        self._ticking, now = False, self._shares.now()
        if self._held_for(now) <= 0:
            self._line.popleft()()
        if self._line:
            self._tick_later(now)

    def used_percent(self) -> int:
        """The caller's share of the loop's time in the last whole second."""
        self._count(0, self._shares.now())
        return round(100 * self._before_nanos / _SECOND_NANOS)

    def _count(self, nanos: int, now: int) -> None:
        second = now // _SECOND_NANOS
        if second != self._second:
            self._before_nanos = self._used_nanos if second == self._second + 1 else 0
            self._second, self._used_nanos = second, 0
        self._used_nanos += nanos
