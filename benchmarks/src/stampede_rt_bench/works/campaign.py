"""Runs a campaign: several systems do the same work in turn, in several rounds.

Other load on the machine therefore affects all of them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from stampede_rt_bench.measuring import Spread
from stampede_rt_bench.works.catalogue import Kind, Work
from stampede_rt_bench.works.interface import System
from stampede_rt_bench.works.processes import ServerFailed
from stampede_rt_bench.works.run import Measured, RunFailed, measure

FIGURES = (
    "items_per_second", "cpu_us_per_item", "server_cpu_us_per_item", "lost_share", "p50_us", "p99_us", "p999_us",
)  # fmt: skip


@dataclass
class Results:
    """The results by work and system, and the reasons why some could not be measured."""

    runs: dict[Work, dict[str, list[Measured]]] = field(default_factory=dict)
    absent: dict[str, str] = field(default_factory=dict)
    failures: list[str] = field(default_factory=list)

    def spread(self, work: Work, system: str, figure: str) -> Spread:
        """Return the spread of one figure over the rounds."""
        return Spread.of([getattr(one, figure) for one in self.runs[work][system]])

    def headline(self, work: Work, system: str) -> Spread:
        """Return the figure for comparisons: items a second, or the median time."""
        return self.spread(work, system, "items_per_second" if work.kind == "stream" else "p50_us")

    def speed(self, work: Work, system: str, other: str) -> float:
        """Return how many times as fast `system` is as `other`."""
        mine, theirs = self.headline(work, system).median, self.headline(work, other).median
        return mine / theirs if work.kind == "stream" else theirs / mine

    def most_readers(self, works: Sequence[Work], system: str, lost_share_max: float) -> int:
        """Return the largest number of readers, among these works, with a median loss below `lost_share_max`."""
        held = [
            work.readers
            for work in works
            if system in self.runs.get(work, {}) and self.spread(work, system, "lost_share").median < lost_share_max
        ]
        return max(held, default=0)


def compare(
    systems: Sequence[System],
    works: Sequence[Work],
    *,
    rounds: int,
    seconds: float,
    done: Callable[[Results, Work], None],
    say: Callable[[str], None],
) -> Results:
    """Measure every available system with every work that it can do. Calls `done` after each work."""
    results = Results()
    present = []
    for system in systems:
        reason = system.unavailable_because()
        if reason is None:
            present.append(system)
        else:
            results.absent[system.name] = reason
            say(f"{system.name} is not measured: {reason}")
    for work in works:
        able = [system for system in present if _can(system, work.kind)]
        for turn in range(rounds):
            first = turn % max(1, len(able))
            for system in [*able[first:], *able[:first]]:
                _measure(results, system, work, seconds, say)
        done(results, work)
    return results


def _can(system: System, kind: Kind) -> bool:
    return kind not in system.lacks


def _measure(results: Results, system: System, work: Work, seconds: float, say: Callable[[str], None]) -> None:
    try:
        measured = measure(system, work, seconds)
    except (RunFailed, ServerFailed) as error:
        results.failures.append(f"{system.name}, {work.title}: {error}")
        say(f"failed: {results.failures[-1]}")
        return
    results.runs.setdefault(work, {}).setdefault(system.name, []).append(measured)
