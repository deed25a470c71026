"""How a figure is taken: the same operation many times, several runs, the median and the spread between runs."""

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
    """How large channels get at the most, how many runs a figure is the median of, and frames in a run of a stream."""

    items_max: int
    runs: int
    frames: int = 2312

    def sizes(self, least: int = 1000) -> list[int]:
        """Powers of ten from `least` to `items_max`."""
        sizes = []
        size = least
        while size <= self.items_max:
            sizes.append(size)
            size *= 10
        return sizes


@dataclass(frozen=True)
class Spread:
    """One figure over several runs: the median, the least and the most."""

    median: float
    least: float
    most: float

    @classmethod
    def of(cls, values: Sequence[float]) -> Spread:
        """Of at least one value."""
        return cls(statistics.median(values), min(values), max(values))

    def over(self, other: Spread) -> float:
        """The ratio of the medians."""
        return self.median / other.median


@contextmanager
def quiet() -> Iterator[None]:
    """No garbage collection inside, which would walk every item of a large channel at some operation's cost."""
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()


def microseconds(operation: Callable[[], object], *, times: int, runs: int) -> Spread:
    """What one `operation` takes: the mean over `times` of them, in each of `runs` runs."""
    means = []
    with quiet():
        operation()
        for _ in range(runs):
            began = time.perf_counter_ns()
            for _ in range(times):
                operation()
            means.append((time.perf_counter_ns() - began) / times / NANOS_PER_US)
    return Spread.of(means)
