"""When the waiting of many ends: one timer for all of them, and those that end together are looked at in pieces."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Callable
from typing import Any

from sortedcontainers import SortedList

from stampede_rt_channel_host.core.channel import Pieces, run_to_end

LIMITS_PER_PIECE = 32

TimeLimit = tuple[float, int, Callable[[], None]]
"""When, on the loop's clock, the how manieth, and what is called then."""


class TimeLimits:
    """Of all blocked gets of a host. `begin` does long work that nobody waits for (`PieceScheduler.begin`)."""

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
        """Call `give_up` in so many nanoseconds; when many are due, the last ones a moment later."""
        limit = asyncio.get_running_loop().time() + wait_nanos / 1e9, next(self._orders), give_up
        self._limits.add(limit)
        self._arm()
        return limit

    def remove(self, limit: TimeLimit) -> None:
        """It is not to be called any more. Idempotent."""
        self._limits.discard(limit)
        if not self._limits:
            self._arm()

    def _arm(self) -> None:
        """One timer, for the first of them. One that fires too early only looks again."""
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
        """Those that are due, the first one first. The loop may fire a timer a little before its time: at least up to
        `due_s`."""
        try:
            while self._give_up_some(max(due_s, asyncio.get_running_loop().time())):
                yield
        finally:
            self._is_working = False
            self._arm()

    def _give_up_some(self, now_s: float) -> bool:
        """True if others are due."""
        for _ in range(LIMITS_PER_PIECE):
            if not self._is_due(now_s):
                return False
            _, _, give_up = self._limits.pop(0)
            give_up()
        return self._is_due(now_s)

    def _is_due(self, now_s: float) -> bool:
        return bool(self._limits) and self._limits[0][0] <= now_s
