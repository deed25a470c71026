"""Measures how late the event loop performs a call that is due."""

from __future__ import annotations

import asyncio
import time
from typing import NoReturn

from stampede_rt_runtime.metrics.families import Durations

PERIOD_SECONDS = 0.1
BOUNDS_SECONDS = (0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 10.0)


class LoopLag:
    """Counts the lags of one event loop, ten each second."""

    def __init__(self) -> None:
        self.lags = Durations(BOUNDS_SECONDS)

    async def measure(self) -> NoReturn:
        """Measure until cancelled."""
        while True:  # paced by the sleep
            due_s = time.monotonic() + PERIOD_SECONDS  # the clock of uvloop has whole milliseconds
            await asyncio.sleep(PERIOD_SECONDS)
            self.lags.add(max(0.0, time.monotonic() - due_s))
