"""Runs Python's garbage collector in small portions.

An item or record is freed with its last reference. Only objects in a reference cycle need the collector. Python starts
the collector when there are many more objects than at its last run. A full channel drops an old item for each new one,
so the number of objects hardly grows, and Python starts the collector rarely. Between two runs the channel replaces all
its items. The collector has then not seen any of them, and scans all of them in one go. Therefore the event loop starts
the collector, too. It does so more often when the program creates more objects (decision 0122).
"""

from __future__ import annotations

import asyncio
import gc
import time

_THRESHOLDS = (1_000, 5, 2**30)
"""With these values Python still starts the collector if the number of objects grows, but never collects
all objects.
"""
INTERVAL_SECONDS_MIN = 0.002
INTERVAL_SECONDS_MAX = 0.02
LONG_SECONDS = 0.0005
"""A collection that takes longer halves the interval to the next one. A collection that takes less than a quarter of
this time doubles the interval.
"""
FULL_INTERVAL_SECONDS = 600.0
"""A collection of all objects takes 0.15 s for each million objects, so it is rare."""


class CollectionPace:
    """Decides which generation is collected next, and when. Pure: times are in seconds, `now_s` is monotonic."""

    def __init__(self, now_s: float) -> None:
        self.interval_s = INTERVAL_SECONDS_MAX
        self._young_s = 0.0  # the time of the collections of generation 0 since the last one of generation 1
        self._moved_s = 0.0  # the time of the collections of generation 1 since the last one of all objects
        self._full_s = 0.0  # the time of the last collection of all objects
        self._full_at_s = now_s

    def next_generation(self, now_s: float) -> int:
        """The generation to collect next; 2 means all objects.

        A collection of all objects is rare, and needs many new objects: they must have taken more than a quarter of the
        time of the last collection of all objects.
        """
        if now_s - self._full_at_s >= FULL_INTERVAL_SECONDS and self._moved_s > self._full_s / 4:
            return 2
        return 1 if self._young_s >= LONG_SECONDS else 0

    def took(self, generation: int, seconds: float, now_s: float) -> None:
        """Note the CPU time that a collection has taken."""
        if generation == 2:
            self._full_s, self._full_at_s, self._moved_s, self._young_s = seconds, now_s, 0.0, 0.0
            return
        if generation == 1:
            self._moved_s += seconds
            self._young_s = 0.0
        else:
            self._young_s += seconds
        if seconds > LONG_SECONDS:
            self.interval_s = max(self.interval_s / 2, INTERVAL_SECONDS_MIN)
        elif seconds < LONG_SECONDS / 4:
            self.interval_s = min(self.interval_s * 2, INTERVAL_SECONDS_MAX)


class GarbageCollection:
    """Collects on the event loop for the duration of the block.

    In the block, objects that existed at its beginning are never collected.
    """

    def __init__(self) -> None:
        self._pace = CollectionPace(time.monotonic())
        self._timer: asyncio.TimerHandle | None = None
        self._thresholds = gc.get_threshold()

    async def __aenter__(self) -> GarbageCollection:
        """Take the collector over from Python."""
        gc.freeze()
        self._thresholds = gc.get_threshold()
        gc.set_threshold(*_THRESHOLDS)
        gc.enable()
        self._set_timer()
        return self

    async def __aexit__(self, *_: object) -> None:
        """Give the collector back to Python."""
        if self._timer is not None:
            self._timer.cancel()
        gc.set_threshold(*self._thresholds)
        gc.unfreeze()

    def collect(self) -> None:
        """Perform the collection that is due now."""
        generation, begun_s = self._pace.next_generation(time.monotonic()), time.thread_time()
        gc.collect(generation)
        self._pace.took(generation, time.thread_time() - begun_s, time.monotonic())

    def _set_timer(self) -> None:
        self._timer = asyncio.get_running_loop().call_later(self._pace.interval_s, self._fire)

    def _fire(self) -> None:
        self.collect()
        self._set_timer()
