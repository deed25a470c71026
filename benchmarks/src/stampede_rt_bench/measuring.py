"""Measures a figure: does one operation many times in several runs, and gives the median and spread of the runs."""

from __future__ import annotations

import gc
import statistics
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

PAYLOAD_BYTES = 64
NANOS_PER_US = 1000


@dataclass(frozen=True, kw_only=True)
class Effort:
    """The effort of a measurement.

    `items_max`: the items of the largest channel. `runs`: the runs for each figure. `frames`: the frames of each run
    with a stream.
    """

    items_max: int
    runs: int
    frames: int = 2312

    def sizes(self, least: int = 1000) -> list[int]:
        """Return the powers of ten from `least` to `items_max`."""
        sizes = []
        size = least
        while size <= self.items_max:
            sizes.append(size)
            size *= 10
        return sizes


@dataclass(frozen=True)
class Spread:
    """One figure over several runs: the median, the least and the greatest value."""

    median: float
    least: float
    most: float

    @classmethod
    def of(cls, values: Sequence[float]) -> Spread:
        """Return the spread of one or more values."""
        return cls(statistics.median(values), min(values), max(values))

    def over(self, other: Spread) -> float:
        """Return the ratio of the medians."""
        return self.median / other.median


@contextmanager
def quiet() -> Iterator[None]:
    """Switch off garbage collection in the context. It would visit every item of a large channel in some operation."""
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()


def microseconds(operation: Callable[[], object], *, times: int, runs: int) -> Spread:
    """Return the time of one `operation`: the mean over `times` calls, in each of `runs` runs."""
    means = []
    with quiet():
        operation()
        for _ in range(runs):
            began = time.perf_counter_ns()
            for _ in range(times):
                operation()
            means.append((time.perf_counter_ns() - began) / times / NANOS_PER_US)
    return Spread.of(means)
