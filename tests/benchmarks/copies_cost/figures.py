"""The ratio of two operations that took turns, and the CPU time of a service."""

from __future__ import annotations

from collections.abc import Sequence

from stampede_rt_bench.measuring import Spread
from stampede_rt_bench.tables import Cell, spread
from stampede_rt_bench.workloads.processes import cpu_seconds
from stampede_rt_local.process import ServiceProcess


def ratio(ours: Sequence[float], plain: Sequence[float]) -> Cell:
    """Return the spread of the ratios of the rounds."""
    return spread(Spread.of([one / other for one, other in zip(ours, plain, strict=True)]), 2)


def cpu_s(host: ServiceProcess) -> float:
    """Return the CPU time of a service so far."""
    return cpu_seconds([host.pid])
