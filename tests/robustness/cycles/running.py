"""Runs cycles at a cluster whose services count their things, and finds out which process has grown."""

from __future__ import annotations

import gc
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import pytest

import stampede_rt as st
from stampede_rt_local.cluster import LocalCluster
from tests.robustness.cycles.counted_service import SNAPSHOT_EVERY_ENTRIES
from tests.robustness.cycles.counting import FOLDER_VARIABLE, HeldResources, held_by, held_here, settled
from tests.robustness.cycles.cycling import KINDS, OPENED_PER_CYCLE, Cycle
from tests.support.cluster import running_cluster

ROOT = Path(__file__).parents[3]


@contextmanager
def counted_cluster(folder: Path) -> Iterator[LocalCluster]:
    """A cluster of two hosts, a front-end and a supernode, which count their things into files of the folder."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(FOLDER_VARIABLE, str(folder))
        patch.setenv("PYTHONPATH", str(ROOT))  # where `counted_service` is
        planned = LocalCluster(hosts=2, supernodes=1)
        for process in planned.processes():
            process.arguments.insert(0, process._module)
            process._module = "tests.robustness.cycles.counted_service"
        with running_cluster(planned) as cluster:
            yield cluster


@dataclass
class Report:
    """The things of all processes before and after the cycles. `complaints`: the things that have grown more than they
    may.
    """

    kind: str
    cycles: int
    seconds: float
    before: dict[str, HeldResources]
    after: dict[str, HeldResources] = field(default_factory=dict)
    complaints: list[str] = field(default_factory=list)

    def rows(self) -> Iterator[str]:
        """Yield the rows of a Markdown table, one for each process."""
        for part, now in self.after.items():
            then = self.before[part]
            grown = [now.files - then.files, now.threads - then.threads, now.tasks - then.tasks]
            objects = sum(now.objects.values()) - sum(then.objects.values())
            memory = (now.memory_bytes - then.memory_bytes) / 1024
            counts = " | ".join(f"{one:+d}" for one in (*grown, objects))
            yield f"| {self.kind} | {self.cycles:,} | {self.seconds:.0f} s | {part} | {counts} | {memory:+,.0f} |"


HEADER = """| cycle | cycles | time | process | files | threads | tasks | objects | memory, KiB |
| --- | ---: | ---: | --- | ---: | ---: | ---: | ---: | ---: |"""


def run(cluster: LocalCluster, folder: Path, kind: str, warm_up: int, cycles: int) -> Report:
    """Run cycles to warm up, count, run the other cycles, and count again until nothing has grown, or for 20 s.

    `warm_up` and `cycles` count the opened things. Some kinds open several things in one cycle.
    """
    with KINDS[kind](cluster) as cycle:
        opened = OPENED_PER_CYCLE.get(kind, 1)
        for _ in range(0, warm_up, opened):
            cycle()
        _free_cancelled_calls(cycle)
        before, begun_s = held_by_all(cluster, folder), time.monotonic()
        for _ in range(0, cycles, opened):
            cycle()
        report = Report(kind, cycles, time.monotonic() - begun_s, before)

        def complaints() -> list[str]:
            _free_cancelled_calls(cycle)
            report.after = held_by_all(cluster, folder)
            grown = {part: now.grown_since(before[part], cycles) for part, now in report.after.items()}
            return [f"{kind}: {part} has grown: {', '.join(what)}" for part, what in grown.items() if what]

        report.complaints = settled(complaints)
        return report


def _free_cancelled_calls(cycle: Cycle) -> None:
    """Run the event loop after a garbage collection: the loop closes the generators of cancelled calls of grpc.aio."""
    gc.collect()
    cycle()


def held_by_all(cluster: LocalCluster, folder: Path) -> dict[str, HeldResources]:
    """Count the things of the client, which is this process, and of all services.

    A supernode keeps its answers for some seconds, and longer in its last snapshot. So this function first makes enough
    calls for a new snapshot.
    """
    with st.connect(cluster.address) as rt:
        for _ in range(SNAPSHOT_EVERY_ENTRIES + 10):
            rt.channel("cycles/level")
    return {"client": held_here(), **{process.name: held_by(process, folder) for process in cluster.processes()}}
