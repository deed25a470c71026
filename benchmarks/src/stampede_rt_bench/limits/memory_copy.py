"""Measures a copy in memory. No transport that copies its bytes can be faster."""

from __future__ import annotations

from functools import partial

from stampede_rt_bench.measuring import NANOS_PER_US, Spread, microseconds
from stampede_rt_bench.workloads.catalogue import LARGE, MEDIUM, SMALL

BYTES_A_RUN = 1 << 30
TIMES_MAX = 200_000


def copy_times_us(rounds: int) -> dict[int, Spread]:
    """Return, by size in bytes, the time of one copy into a new object.

    All sources together are larger than small caches.
    """
    times: dict[int, Spread] = {}
    for size in (SMALL, MEDIUM, LARGE):
        sources = [bytearray(size) for _ in range(max(1, min(64, (16 << 20) // size)))]
        count = max(1, min(TIMES_MAX, BYTES_A_RUN // size // 4) // len(sources))
        all_copies = microseconds(partial(_copy_each, sources), times=count, runs=rounds)
        times[size] = Spread(
            *(value / len(sources) for value in (all_copies.median, all_copies.least, all_copies.most))
        )
    return times


def _copy_each(sources: list[bytearray]) -> None:
    for source in sources:
        bytes(source)


def gigabytes_per_second(size: int, time_us: Spread) -> float:
    """Return the speed at the median time."""
    return size / (time_us.median * NANOS_PER_US)
