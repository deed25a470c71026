"""What 32 readers of one channel cost its host: `python -m tests.benchmarks.fan_out [--readers 32] [--seconds 8]`.

A cluster of processes. A producer puts 30 times a second: one item of 18 KB, or a run of 64 items of 64 B. The readers
are spread over four processes. In every second run one more reader subscribes, takes a second of items and then reads
no more. The benchmark reads the CPU time and the resident memory of the whole host process, and the age of each put
when a reader has it.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import stampede_rt as st
from stampede_rt import aio
from stampede_rt_bench.clusters import SECRET_VARIABLE
from stampede_rt_bench.tables import Table
from stampede_rt_local.cluster import LocalCluster

PROCESSES = 4
PERIOD_S = 1 / 30
STALLS_AFTER = 30  # items that the stalled reader takes, so that the host sends ahead of it
WORKS = {"18 KB": (1, 18_000), "64 x 64 B": (64, 64)}
MIB = 2**20
TICKS_PER_SECOND, PAGE_BYTES = os.sysconf("SC_CLK_TCK"), os.sysconf("SC_PAGE_SIZE")
AS_READERS, AS_STALLED = "--as-readers", "--as-stalled"


@dataclass(frozen=True)
class Result:
    """One run: the host's CPU for each reader and put, the ages of the puts at the readers, and the host's memory."""

    cpu_us: float
    ages_ms: Sequence[float]
    grown_bytes: int


def measure(cluster: LocalCluster, work: str, readers: int, seconds: float, *, stalled: bool) -> Result:
    """Take one run, in a new channel."""
    items, size = WORKS[work]
    host = next(one for one in cluster.processes() if one.name.startswith("host")).pid
    assert host is not None
    with st.connect(cluster.address) as rt, ExitStack() as stack:
        name = f"fan/{time.monotonic_ns()}"
        channel = rt.channel(name, max_age="3s")
        children = [
            stack.enter_context(_child(AS_READERS, cluster.address, name, readers // PROCESSES))
            for _ in range(PROCESSES)
        ]
        if stalled:
            stack.enter_context(_child(AS_STALLED, cluster.address, name, 1))
        _put_for(channel, 2.0, items, size)
        cpu_s, before_bytes = _cpu_s(host), _resident_bytes(host)
        puts, began = _put_for(channel, seconds, items, size), st.now() - round(seconds * 1e9)
        cpu_s, after_bytes = _cpu_s(host) - cpu_s, _resident_bytes(host)
        channel.put(b"end")
        ages = [age for child in children for time_ns, age in _told(child) if time_ns >= began]
    return Result(cpu_s / puts / readers * 1e6, [age / 1e6 for age in ages], after_bytes - before_bytes)


def _put_for(channel: st.Channel, seconds: float, items: int, size: int) -> int:
    """Put in each period. Returns the number of puts."""
    puts, due_s = 0, time.monotonic()
    until_s = due_s + seconds
    with channel.producer() as producer:
        while due_s < until_s:
            stamp = st.now()
            for place in range(items):
                producer.put(bytes(size), time=stamp - items + 1 + place)
            producer.flush()
            puts, due_s = puts + 1, due_s + PERIOD_S
            time.sleep(max(0.0, due_s - time.monotonic()))
    return puts


@contextmanager
def _child(role: str, address: str, channel: str, readers: int) -> Iterator[subprocess.Popen[str]]:
    """A process with readers that have subscribed."""
    command = [sys.executable, "-m", "tests.benchmarks.fan_out", role, address, channel, str(readers)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None
        assert child.stdout.readline() == "ready\n"
        try:
            yield child
        finally:
            child.kill()


def _told(child: subprocess.Popen[str]) -> list[tuple[int, int]]:
    assert child.stdout is not None
    found: list[tuple[int, int]] = json.loads(child.stdout.readline())
    return found


def _cpu_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICKS_PER_SECOND


def _resident_bytes(pid: int) -> int:
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * PAGE_BYTES


async def _read(role: str, address: str, name: str, readers: int) -> None:
    """Be the readers of one process. Print the time of each put, and its age when each reader has it."""
    async with await aio.connect(address) as rt:
        channel = await rt.channel(name)
        subscriptions = [channel.subscribe() for _ in range(readers)]
        for subscription in subscriptions:
            await subscription.__aenter__()
        print("ready", flush=True)
        if role == AS_STALLED:
            for _ in range(STALLS_AFTER):
                await anext(subscriptions[0])
            await asyncio.Event().wait()
        told = await asyncio.gather(*map(_ages, subscriptions))
        print(json.dumps([one for ages in told for one in ages]), flush=True)


async def _ages(subscription: Any) -> list[tuple[int, int]]:
    ages: dict[int, int] = {}
    async for item in subscription:
        if item.payload == b"end":
            break
        if item.end is None:  # the last item of its put
            ages[item.time] = st.now() - item.time
    return list(ages.items())


def _row(work: str, stalled: bool, runs: Sequence[Result]) -> Sequence[str]:
    cpus = [run.cpu_us for run in runs]
    halves = [statistics.quantiles(run.ages_ms, n=100) for run in runs]
    grown = max(run.grown_bytes for run in runs) / MIB
    cpu = f"{statistics.median(cpus):,.0f} ({min(cpus):,.0f} to {max(cpus):,.0f})"
    ages = [f"{statistics.median(one[place] for one in halves):,.1f}" for place in (49, 98)]
    return (work, "yes" if stalled else "no", cpu, *ages, f"{grown:,.1f}")


def main() -> int:
    """Print the table, or be readers. Returns the exit code."""
    if len(sys.argv) > 1 and sys.argv[1] in (AS_READERS, AS_STALLED):
        role, address, name, readers = sys.argv[1:]
        asyncio.run(_read(role, address, name, int(readers)))
        return 0
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--readers", type=int, default=32, help="the readers of the channel (default: 32)")
    parser.add_argument("--seconds", type=float, default=8.0, help="the length of each run (default: 8)")
    parser.add_argument("--runs", type=int, default=3, help="the runs of each case (default: 3)")
    asked = parser.parse_args()
    table = Table(["put", "one stalled", "host CPU a reader and put, us", "age p50, ms", "p99, ms", "grown, MiB"])
    with LocalCluster(hosts=1, supernodes=1, durable=False) as cluster:
        os.environ[SECRET_VARIABLE] = str(cluster.secret_file)
        for work in WORKS:
            taken: dict[bool, list[Result]] = {False: [], True: []}
            for number in range(2 * asked.runs):
                stalled = bool(number % 2)
                taken[stalled].append(measure(cluster, work, asked.readers, asked.seconds, stalled=stalled))
            table.rows += [_row(work, stalled, runs) for stalled, runs in taken.items()]
    table.notes.append(f"{asked.readers} readers, {asked.runs} runs of {asked.seconds:g} s; medians (least to most).")
    table.print()
    return 0


if __name__ == "__main__":
    sys.exit(main())
