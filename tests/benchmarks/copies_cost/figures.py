"""The ratio of two operations that took turns, and the CPU time of a service."""

from __future__ import annotations

import time
from collections.abc import Sequence

from stampede_rt_bench.measuring import Spread
from stampede_rt_bench.tables import Cell, spread
from stampede_rt_local.process import ServiceProcess

_SCHEDULED = 2  # the number of the scheduler's clock of a process (clock_getcpuclockid(3))


def ratio(ours: Sequence[float], plain: Sequence[float]) -> Cell:
    """Return the spread of the ratios of the rounds."""
    return spread(Spread.of([one / other for one, other in zip(ours, plain, strict=True)]), 2)


def cpu_s(host: ServiceProcess) -> float:
    """Return the CPU time of a service so far, in seconds. Linux's clock of a process has steps of nanoseconds."""
    return time.clock_gettime(~host.pid << 3 | _SCHEDULED)
