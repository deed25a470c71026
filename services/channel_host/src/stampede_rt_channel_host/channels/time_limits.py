"""The time limits of many waits. One timer serves all of them. Limits that end together are handled in pieces."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Callable
from typing import Any

from sortedcontainers import SortedList

from stampede_rt_channel_host.core.channel import Pieces, run_to_end

LIMITS_PER_PIECE = 32

TimeLimit = tuple[float, int, Callable[[], None]]
"""The loop time of the end, a serial number, and the function to call then."""


class TimeLimits:
    """The time limits of all blocked gets of a host.

    `begin` does long work for which no caller waits (`PieceScheduler.begin`).
    """

    def __init__(self, begin: Callable[[Pieces[None]], None] = run_to_end) -> None:
        self._begin = begin
        self._limits: Any = SortedList()
        self._orders = itertools.count()
        self._timer: asyncio.TimerHandle | None = None
        self._timer_s = 0.0
        self._is_working = False

    def __len__(self) -> int:
        return len(self._limits)

    def add(self, wait_nanos: int, give_up: Callable[[], None]) -> TimeLimit:
        """Call `give_up` in `wait_nanos` nanoseconds.

        If many limits are due together, the last ones end a moment later.
        """
        limit = asyncio.get_running_loop().time() + wait_nanos / 1e9, next(self._orders), give_up
        self._limits.add(limit)
        self._set_timer()
        return limit

    def remove(self, limit: TimeLimit) -> None:
        """Drop a limit. Idempotent."""
        self._limits.discard(limit)
        if not self._limits:
            self._set_timer()

    def _set_timer(self) -> None:
        """Set the timer for the first limit. A timer that fires too early only looks again."""
        first_s = self._limits[0][0] if self._limits else None
        if self._timer is not None and (first_s is None or first_s < self._timer_s):
            self._timer.cancel()
            self._timer = None
        if self._timer is None and first_s is not None and not self._is_working:
            self._timer, self._timer_s = asyncio.get_running_loop().call_at(first_s, self._fire), first_s

    def _fire(self) -> None:
        self._timer, self._is_working = None, True
        self._begin(self._giving_up(self._timer_s))

    def _giving_up(self, due_s: float) -> Pieces[None]:
        """Call the functions of the due limits, the earliest limit first.

        The loop may fire a timer a little early, so all limits up to `due_s` count as due.
        """
        try:
            while self._give_up_some(max(due_s, asyncio.get_running_loop().time())):
                yield
        finally:
            self._is_working = False
            self._set_timer()

    def _give_up_some(self, now_s: float) -> bool:
        """Call the functions of a few due limits. Returns True if others are due."""
        for _ in range(LIMITS_PER_PIECE):
            if not self._is_due(now_s):
                return False
            _, _, give_up = self._limits.pop(0)
            give_up()
        return self._is_due(now_s)

    def _is_due(self, now_s: float) -> bool:
        return bool(self._limits) and self._limits[0][0] <= now_s
