"""Measures the longest pause of an event loop during a piece of work."""

from __future__ import annotations

import asyncio
import gc
import time
from collections.abc import Awaitable, Callable

PATIENCE_SECONDS = 120.0

Work = Callable[[], Awaitable[None]]


class Watch:
    """Turns the loop, and notes the longest pause of its thread, in milliseconds."""

    def __init__(self) -> None:
        self.longest_ms = 0.0

    async def measure(self, work: Work) -> float:
        """Do `work`. Returns the CPU time of all of it, in milliseconds."""
        gc.collect()
        gc.freeze()
        task, begun = asyncio.ensure_future(work()), time.thread_time()
        last = begun
        while not task.done():
            await asyncio.sleep(0)
            now = time.thread_time()
            self.longest_ms, last = max(self.longest_ms, (now - last) * 1000), now
        await task
        gc.unfreeze()
        return (time.thread_time() - begun) * 1000


async def until(condition: Callable[[], bool]) -> None:
    """Wait until the condition holds. Meanwhile only other work runs."""
    while not condition():  # noqa: ASYNC110  (there is no event for it)
        await asyncio.sleep(0)
