"""A copy in memory: what no transport that hands out bytes of its own can come below."""

from __future__ import annotations

from stampede_rt_bench.measuring import NANOS_PER_US, Spread, microseconds
from stampede_rt_bench.works.catalogue import LARGE, MEDIUM, SMALL

BYTES_A_RUN = 1 << 30
TIMES_MAX = 200_000


def copy_times_us(rounds: int) -> dict[int, Spread]:
    """By size in bytes, what one copy into a new object takes; the sources together are larger than small caches."""
    times: dict[int, Spread] = {}
    for size in (SMALL, MEDIUM, LARGE):
        sources = [bytearray(size) for _ in range(max(1, min(64, (16 << 20) // size)))]
        count = max(1, min(TIMES_MAX, BYTES_A_RUN // size // 4) // len(sources))

        def copy(sources: list[bytearray] = sources) -> None:
            for source in sources:
                bytes(source)

        of_all = microseconds(copy, times=count, runs=rounds)
        times[size] = Spread(*(value / len(sources) for value in (of_all.median, of_all.least, of_all.most)))
    return times


def gigabytes_per_second(size: int, time_us: Spread) -> float:
    """At the median."""
    return size / (time_us.median * NANOS_PER_US)
