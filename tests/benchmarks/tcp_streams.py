"""Streams over TCP compared with streams over gRPC, with and without certificates.

    python -m tests.benchmarks.tcp_streams

Prints the CPU time of the client and of the host for one operation of the blocking client, in us, and its median time.
The transports take turns. A loaded machine changes the times much, and the CPU times less.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from unittest import mock

import stampede_rt as st
from stampede_rt_local.cluster import LocalCluster

ROUNDS = 5
TRANSPORTS = ("grpc", "tcp")
WORKLOADS: dict[str, tuple[int, Callable[[st.Channel], object]]] = {
    "put 64 B": (300, lambda channel: channel.put(bytes(64))),
    "newest 18 KB": (300, lambda channel: channel.newest()),
}


def cpu_s(pid: int) -> float:
    """The CPU time of a process."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def measured(workload: Callable[[st.Channel], object], count: int, channel: st.Channel, host: int) -> tuple[float, ...]:
    """Client and host CPU and the median time of an operation, in us."""
    workload(channel)
    times, client, server = list[float](), time.process_time(), cpu_s(host)
    for _ in range(count):
        began = time.perf_counter()
        workload(channel)
        times.append(time.perf_counter() - began)
    client, server = time.process_time() - client, cpu_s(host) - server
    return client / count * 1e6, server / count * 1e6, median(times) * 1e6


def cell(values: tuple[float, ...]) -> str:
    """The median, and the least and the greatest value."""
    return f"{median(values):.0f} ({min(values):.0f}-{max(values):.0f})"


def filled(rt: st.Connection, workload: str) -> st.Channel:
    """A channel with the items that the workload reads."""
    channel = rt.channel(f"bench/{workload.partition(' ')[0]}")
    if workload.startswith("newest"):
        channel.put(bytes(18_000))
    return channel


def run(tls: bool) -> None:
    """Print the rows for a cluster with or without certificates."""
    with LocalCluster(tls=tls, hosts=1, supernodes=1, durable=False, data_ports=True) as cluster:
        host = cluster.hosts[0].pid
        assert host is not None
        variables = {} if tls else {"STAMPEDE_SECRET_FILE": str(cluster.secret_file)}
        with mock.patch.dict(os.environ, variables):
            files = cluster.tls_files()
            connections = {one: st.connect(cluster.address, transport=one, tls=files) for one in TRANSPORTS}
        for workload, (count, operation) in WORKLOADS.items():
            channels = {one: filled(rt, workload) for one, rt in connections.items()}
            rounds = {one: list[tuple[float, ...]]() for one in TRANSPORTS}
            for _ in range(ROUNDS):
                for one in TRANSPORTS:
                    rounds[one].append(measured(operation, count, channels[one], host))
            for one, rows in rounds.items():
                cells = map(cell, zip(*rows, strict=True))
                print(f"| {workload} | {one}{' with TLS' if tls else ''} |", " | ".join(cells), "|", flush=True)
        for rt in connections.values():
            rt.close()


if __name__ == "__main__":
    run(tls=False)
    run(tls=True)
