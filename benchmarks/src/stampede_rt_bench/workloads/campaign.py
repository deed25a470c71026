"""Runs a campaign: several systems run the same workload in turn, in several rounds.

Other load on the machine therefore affects all of them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from stampede_rt_bench.measuring import Spread
from stampede_rt_bench.workloads.catalogue import Kind, Workload
from stampede_rt_bench.workloads.interface import MeasuredSystem
from stampede_rt_bench.workloads.processes import ServerFailed
from stampede_rt_bench.workloads.run import RunFailed, RunResult, measure

FIGURES = (
    "items_per_second", "cpu_us_per_item", "server_cpu_us_per_item", "lost_share", "p50_us", "p99_us", "p999_us",
)  # fmt: skip


@dataclass
class Results:
    """The results by workload and system, and the reasons why some systems could not be measured."""

    runs: dict[Workload, dict[str, list[RunResult]]] = field(default_factory=dict)
    absent: dict[str, str] = field(default_factory=dict)
    failures: list[str] = field(default_factory=list)

    def spread(self, workload: Workload, system: str, figure: str) -> Spread:
        """Return the spread of one figure over the rounds."""
        return Spread.of([getattr(one, figure) for one in self.runs[workload][system]])

    def main_figure(self, workload: Workload, system: str) -> Spread:
        """Return the figure for comparisons: items a second, or the median time."""
        return self.spread(workload, system, "items_per_second" if workload.kind == "stream" else "p50_us")

    def speed(self, workload: Workload, system: str, other: str) -> float:
        """Return how many times as fast `system` is as `other`."""
        mine, theirs = self.main_figure(workload, system).median, self.main_figure(workload, other).median
        return mine / theirs if workload.kind == "stream" else theirs / mine

    def most_readers(self, workloads: Sequence[Workload], system: str, lost_share_max: float) -> int:
        """Return the largest number of readers, among these workloads, with a median loss below `lost_share_max`."""
        held = [
            workload.readers
            for workload in workloads
            if system in self.runs.get(workload, {})
            and self.spread(workload, system, "lost_share").median < lost_share_max
        ]
        return max(held, default=0)


def compare(
    systems: Sequence[MeasuredSystem],
    workloads: Sequence[Workload],
    *,
    rounds: int,
    seconds: float,
    done: Callable[[Results, Workload], None],
    report: Callable[[str], None],
) -> Results:
    """Measure every available system with every workload that it can run. Calls `done` after each workload."""
    results = Results()
    present = []
    for system in systems:
        reason = system.unavailable_because()
        if reason is None:
            present.append(system)
        else:
            results.absent[system.name] = reason
            report(f"{system.name} is not measured: {reason}")
    for workload in workloads:
        able = [system for system in present if _can(system, workload.kind)]
        for turn in range(rounds):
            first = turn % max(1, len(able))
            for system in [*able[first:], *able[:first]]:
                _measure(results, system, workload, seconds, report)
        done(results, workload)
    return results


def _can(system: MeasuredSystem, kind: Kind) -> bool:
    return kind not in system.unsupported


def _measure(
    results: Results, system: MeasuredSystem, workload: Workload, seconds: float, report: Callable[[str], None]
) -> None:
    try:
        measured = measure(system, workload, seconds)
    except (RunFailed, ServerFailed) as error:
        results.failures.append(f"{system.name}, {workload.title}: {error}")
        report(f"failed: {results.failures[-1]}")
        return
    results.runs.setdefault(workload, {}).setdefault(system.name, []).append(measured)
