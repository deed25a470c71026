"""Measures the processor time of each reset call at a host, and at a bare gRPC server that ignores the calls.

    python -m tests.benchmarks.attacks.reset_cost [--seconds 4] [--rounds 3]

Another process makes calls on ten connections, and resets each call immediately (the attack `resets`). The rounds
go alternately to the host and to the server of `bare.py`. The figures are processor time, so other work on the machine
counts for little. "Loop" is the thread of the event loop; the other threads are gRPC's own.
"""

from __future__ import annotations

import argparse
import asyncio
import statistics
import subprocess
import sys
import time
from pathlib import Path
from typing import NamedTuple

from stampede_rt_bench.tables import Table
from stampede_rt_local.cluster import LocalCluster
from tests.benchmarks.attacks import without_credential
from tests.benchmarks.attacks.attacked_cluster import AttackedCluster
from tests.benchmarks.attacks.bare import SERVE
from tests.support.processes import started
from tests.support.raw_http2 import RawConnection

AS_ATTACKER = "--as-attacker"
STILL_SECONDS = 1.0  # the server finishes its work within this time


class Cost(NamedTuple):
    """The processor time of one reset call, in microseconds."""

    loop_us: float
    others_us: float


def thread_seconds(pid: int) -> dict[int, float]:
    """The processor time of each thread of a process, by its id."""
    found = Path(f"/proc/{pid}/task").iterdir()
    return {int(one.name): int((one / "schedstat").read_text().split()[0]) / 1e9 for one in found}


def measure(pid: int, target: str, seconds: float) -> Cost:
    """Measure one round."""
    before = thread_seconds(pid)
    words = [sys.executable, "-m", "tests.benchmarks.attacks.reset_cost", AS_ATTACKER, target, str(seconds)]
    resets = int(subprocess.run(words, check=True, capture_output=True, text=True).stdout)
    time.sleep(STILL_SECONDS)
    used = {thread: spent - before.get(thread, 0.0) for thread, spent in thread_seconds(pid).items()}
    loop = used.pop(pid)
    return Cost(1e6 * loop / resets, 1e6 * sum(used.values()) / resets)


async def _flood(target: str, seconds: float) -> int:
    """Attack for `seconds`. Returns the number of reset calls."""
    made, call = 0, RawConnection.call

    async def counted(raw: RawConnection, method: str) -> int:
        nonlocal made
        made += 1
        return await call(raw, method)

    RawConnection.call = counted  # type: ignore[method-assign, assignment]
    attacked = AttackedCluster(frontend="", supernode="", host=target, secret="")
    attack = asyncio.create_task(without_credential.resets(attacked, lambda: None))
    await asyncio.wait({attack}, timeout=seconds)
    attack.cancel()
    return made


def main() -> None:
    """Measure the host and the bare server alternately, and print the medians."""
    if sys.argv[1:2] == [AS_ATTACKER]:
        print(asyncio.run(_flood(sys.argv[2], float(sys.argv[3]))))
        return
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.attacks.reset_cost", description=__doc__)
    parser.add_argument("--seconds", type=float, default=4.0, help="the time of a round (default: 4)")
    parser.add_argument("--rounds", type=int, default=3, help="rounds at each server (default: 3)")
    options = parser.parse_args()
    found: dict[str, list[Cost]] = {"host": [], "bare gRPC server": []}
    serve = [sys.executable, "-m", "tests.benchmarks.attacks.bare", SERVE]
    with LocalCluster(hosts=1, supernodes=1, durable=False) as cluster, started(serve) as bare:
        assert bare.stdout is not None
        host, port = cluster.hosts[0], bare.stdout.readline().strip()
        for _ in range(options.rounds):
            found["host"].append(measure(host.pid, host.address, options.seconds))
            found["bare gRPC server"].append(measure(bare.pid, f"127.0.0.1:{port}", options.seconds))
    table = Table(("server", "loop, us a reset call", "other threads", "together"))
    for name, costs in found.items():
        parts = [(one.loop_us, one.others_us, sum(one)) for one in costs]
        table.rows.append([name, *(f"{statistics.median(column):.0f}" for column in zip(*parts, strict=True))])
    table.print()


if __name__ == "__main__":
    main()
