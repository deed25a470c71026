"""`stampede bench capacity`: what one host on this machine can do. docs/capacity.md explains the figures."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from stampede_rt_bench.capacity.memory import measure_memory
from stampede_rt_bench.capacity.report import CapacityReport
from stampede_rt_bench.machine import describe
from stampede_rt_bench.peers.ours import StampedeRt
from stampede_rt_bench.printing import finish, print_progress, show
from stampede_rt_bench.workloads.campaign import Results, compare
from stampede_rt_bench.workloads.catalogue import LARGE, MEDIUM, SMALL, Workload, size, workloads

MEMORY = "memory"
STREAMS = {
    "stream-64b": "64 B in runs, to a reader",
    "stream-18kb": "18 KB, to a reader",
    "stream-300kb": "300 KB, to a reader",
    "latency-300": "64 B at 300 items/s, to a reader",
}


def capacity_workloads() -> list[Workload]:
    """Return the workloads: acknowledged puts of each size, and streams from a producer to a reader."""
    puts = [
        Workload(name=f"put-{size(count).replace(' ', '').lower()}", title=f"{size(count)}, each put waits for its ack",
             kind="put", item_bytes=count)
        for count in (SMALL, MEDIUM, LARGE)
    ]  # fmt: skip
    streams = {workload.name: workload for workload in workloads(())}
    return puts + [
        Workload(name=name, title=title, kind=one.kind, item_bytes=one.item_bytes, rate=one.rate)
        for name, title in STREAMS.items()
        for one in [streams[name]]
    ]


def measure_capacity(arguments: argparse.Namespace) -> int:
    """Measure one host, which this function starts, and write the report. Returns 1 if a run failed. Raises OSError."""
    folder: Path = arguments.out
    folder.mkdir(parents=True, exist_ok=True)
    system, only = StampedeRt(), arguments.work
    report = CapacityReport(command=_command(arguments), machine=describe(("grpcio",)), system=system.name)
    if not only or MEMORY in only:
        print_progress("memory: channels and items in a new host")
        report.memory = measure_memory(arguments.items, arguments.rounds)
        report.write(folder)

    def done(results: Results, workload: Workload) -> None:
        print_progress(f"measured: {workload.title}")
        report.results = results
        report.machine["load after"] = f"{os.getloadavg()[0]:.1f}"
        report.write(folder)  # after each workload, so that an interrupted run keeps its figures

    chosen = [workload for workload in capacity_workloads() if not only or workload.name in only]
    compare([system], chosen, rounds=arguments.rounds, seconds=arguments.seconds, done=done, report=print_progress)
    for table in report.tables():
        show(table, arguments.output, "")
    finish(report.values(), f"\nThe report is in {folder}: capacity.md and capacity.json.", arguments.output)
    return 1 if report.results.failures else 0


def _command(arguments: argparse.Namespace) -> str:
    words = f"--seconds {arguments.seconds:g} --rounds {arguments.rounds} --items {arguments.items}"
    return f"stampede bench capacity {words}" + "".join(f" --work {name}" for name in arguments.work or [])
