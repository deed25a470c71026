"""The cost of 32 readers of one channel for its host, and of one stalled reader for the others.

`python -m tests.benchmarks.fan_out [--readers 32] [--rounds 8] [--seconds 3]` takes three minutes. A producer puts 30
times a second: one item of 18 KB, or a run of 64 items of 64 B. The readers are spread over four processes. A round has
two parts of the same length: in one of them a further reader subscribes, takes the items of one second, and then stops
reading. The order of the parts changes from round to round, so that other work on the machine counts for both alike.
The benchmark reads the CPU time and the resident memory of the whole host process, and the age of each put when a
reader gets the put.
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
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import stampede_rt as st
from stampede_rt import aio
from stampede_rt_bench.clusters import secret_found
from stampede_rt_bench.tables import Table
from stampede_rt_local.cluster import LocalCluster

PROCESSES = 4
TRANSPORT = "socket"  # readers of shared memory cost the host nothing
PERIOD_S = 1 / 30
STALLS_AFTER = 30  # items that the stalled reader takes, so that the host sends ahead of it
WARM_S = 2.0
WORKLOADS = {"18 KB": (1, 18_000), "64 x 64 B": (64, 64)}
MIB = 2**20
LONGER_MAX, GROWN_BYTES_MAX = 1.10, 16 * MIB  # the goal for the cost of a stalled reader
TICKS_PER_SECOND, PAGE_BYTES = os.sysconf("SC_CLK_TCK"), os.sysconf("SC_PAGE_SIZE")
AS_READERS, AS_STALLED = "--as-readers", "--as-stalled"

Age = tuple[int, int]  # the time of a put, and its age when a reader had it, in nanoseconds


@dataclass(frozen=True)
class RoundPart:
    """One part of a round.

    The puts from `began` to `ended`, the host's CPU for each reader and put, and the greatest growth of the host's
    memory.
    """

    began: int
    ended: int
    cpu_us: float
    grown_bytes: int


@dataclass(frozen=True)
class Ages:
    """The age of the puts of one part at the readers, in milliseconds: the median and the 99th percentile."""

    p50: float
    p99: float


class Host:
    """The host process, seen from outside."""

    def __init__(self, cluster: LocalCluster) -> None:
        pid = next(one for one in cluster.processes() if one.name.startswith("host")).pid
        self._folder = Path(f"/proc/{pid}")

    def cpu_s(self) -> float:
        """The CPU time of all its threads."""
        fields = (self._folder / "stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / TICKS_PER_SECOND

    def resident_bytes(self) -> int:
        """The resident memory, in bytes."""
        return int((self._folder / "statm").read_text().split()[1]) * PAGE_BYTES


class Putter:
    """Puts `items` items of `size` bytes in each period."""

    def __init__(self, channel: st.Channel, host: Host, items: int, size: int) -> None:
        self._channel = channel
        self._host = host
        self._items = items
        self._payload = bytes(size)

    def put_for(self, seconds: float, readers: int) -> RoundPart:
        """Put items for `seconds`."""
        began, cpu_s, resident = st.now(), self._host.cpu_s(), self._host.resident_bytes()
        puts, most, due_s = 0, resident, time.monotonic()
        until_s = due_s + seconds
        with self._channel.producer() as producer:
            while due_s < until_s:
                stamp = st.now()
                for place in range(self._items):
                    producer.put(self._payload, time=stamp - self._items + 1 + place)
                producer.flush()
                puts, due_s = puts + 1, due_s + PERIOD_S
                most = max(most, self._host.resident_bytes())
                time.sleep(max(0.0, due_s - time.monotonic()))
        cpu_us = (self._host.cpu_s() - cpu_s) / puts / readers * 1e6
        return RoundPart(began=began, ended=st.now(), cpu_us=cpu_us, grown_bytes=most - resident)


class Child:
    """A process with readers that have subscribed, or with the reader that stalls."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process

    def read_line(self) -> str:
        """The next line that the process prints."""
        assert self._process.stdout is not None
        line = self._process.stdout.readline().strip()
        assert line, "the process has ended"
        return line

    def send_line(self, word: str) -> None:
        """Send a line to the process."""
        assert self._process.stdin is not None
        self._process.stdin.write(f"{word}\n")
        self._process.stdin.flush()


def measure(cluster: LocalCluster, workload: str, readers: int, rounds: int, seconds: float) -> Iterator[Sequence[str]]:
    """Take the rounds of one workload, in a new channel. Yields the rows of the table."""
    host = Host(cluster)
    with st.connect(cluster.address, transport=TRANSPORT) as rt, ExitStack() as stack:
        name = f"fan/{time.monotonic_ns()}"
        channel = rt.channel(name, max_age="3s")
        each = readers // PROCESSES
        children = [stack.enter_context(_child(AS_READERS, cluster.address, name, each)) for _ in range(PROCESSES)]
        stalling = stack.enter_context(_child(AS_STALLED, cluster.address, name, 1))
        putter = Putter(channel, host, *WORKLOADS[workload])
        putter.put_for(WARM_S, readers)
        parts: dict[bool, list[RoundPart]] = {False: [], True: []}
        for number in range(rounds):
            for stalled in (True, False) if number % 2 else (False, True):
                stalling.send_line("subscribe" if stalled else "leave")
                putter.put_for(WARM_S, readers)
                parts[stalled].append(putter.put_for(seconds, readers))
        channel.put(b"end")
        ages: list[Age] = [tuple(one) for child in children for one in json.loads(child.read_line())]
    part_ages = {stalled: [ages_of(one, ages) for one in taken] for stalled, taken in parts.items()}
    yield from (_row(workload, stalled, parts[stalled], part_ages[stalled]) for stalled in parts)
    yield _cost(workload, parts[True], part_ages)


def ages_of(part: RoundPart, ages: Sequence[Age]) -> Ages:
    """The ages of the puts that came in this part."""
    found = statistics.quantiles((age / 1e6 for time_ns, age in ages if part.began <= time_ns < part.ended), n=100)
    return Ages(p50=found[49], p99=found[98])


def longer_by_round(ages: Mapping[bool, Sequence[Ages]]) -> list[float]:
    """For each round: the 99th percentile of the ages with the stalled reader, divided by the percentile without it."""
    return [with_it.p99 / without.p99 for with_it, without in zip(ages[True], ages[False], strict=True)]


@contextmanager
def _child(role: str, address: str, channel: str, readers: int) -> Iterator[Child]:
    command = [sys.executable, "-m", "tests.benchmarks.fan_out", role, address, channel, str(readers)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        try:
            child = Child(process)
            assert child.read_line() == "ready"
            yield child
        finally:
            process.kill()


async def _read(address: str, name: str, readers: int) -> None:
    """Be the readers of one process. Print the time of each put, and its age when each reader has it."""
    async with await aio.connect(address, transport=TRANSPORT) as rt:
        channel = await rt.channel(name)
        subscriptions = [channel.subscribe() for _ in range(readers)]
        for subscription in subscriptions:
            await subscription.__aenter__()
        print("ready", flush=True)
        ages_by_reader = await asyncio.gather(*map(_ages, subscriptions))
        print(json.dumps([one for ages in ages_by_reader for one in ages]), flush=True)


async def _ages(subscription: Any) -> list[Age]:
    ages: dict[int, int] = {}
    async for item in subscription:
        if item.payload == b"end":
            break
        if item.end is None:  # the last item of its put
            ages[item.time] = st.now() - item.time
    return list(ages.items())


async def _stall(address: str, name: str) -> None:
    """Be the reader that subscribes and stalls, or leaves, as the lines on standard input say."""
    async with await aio.connect(address, transport=TRANSPORT) as rt:
        channel = await rt.channel(name)
        print("ready", flush=True)
        subscription: Any = None
        while word := (await asyncio.to_thread(sys.stdin.readline)).strip():
            if subscription is not None:
                await subscription.__aexit__(None, None, None)
                subscription = None
            if word == "subscribe":
                subscription = channel.subscribe()
                await subscription.__aenter__()
                for _ in range(STALLS_AFTER):
                    await anext(subscription)


def _row(workload: str, stalled: bool, parts: Sequence[RoundPart], ages: Sequence[Ages]) -> Sequence[str]:
    cpus = _spread([part.cpu_us for part in parts], "{:,.0f}")
    medians, tails = [_spread([getattr(one, name) for one in ages], "{:,.1f}") for name in ("p50", "p99")]
    grown = max(part.grown_bytes for part in parts) / MIB
    return (workload, "yes" if stalled else "no", cpus, medians, tails, f"{grown:,.1f}")


def _cost(workload: str, stalled: Sequence[RoundPart], ages: Mapping[bool, Sequence[Ages]]) -> Sequence[str]:
    longer = longer_by_round(ages)
    ratio, grown = statistics.median(longer), max(part.grown_bytes for part in stalled)
    held = "goal met" if ratio <= LONGER_MAX and grown <= GROWN_BYTES_MAX else "GOAL MISSED"
    return (workload, held, "", "", _spread(longer, "x {:.2f}"), f"{grown / MIB:,.1f}")


def _spread(values: Sequence[float], form: str) -> str:
    """The median, and the middle half of the values."""
    low, middle, high = statistics.quantiles(values, n=4)
    return f"{form.format(middle)} ({form.format(low)} to {form.format(high)})"


def main() -> int:
    """Print the table, or be readers. Returns the exit code."""
    if len(sys.argv) > 1 and sys.argv[1] in (AS_READERS, AS_STALLED):
        role, address, name, readers = sys.argv[1:]
        asyncio.run(_read(address, name, int(readers)) if role == AS_READERS else _stall(address, name))
        return 0
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--readers", type=int, default=32, help="the readers of the channel (default: 32)")
    parser.add_argument("--rounds", type=int, default=8, help="the rounds of each workload, two or more (default: 8)")
    parser.add_argument("--seconds", type=float, default=3.0, help="the length of each part of a round (default: 3)")
    arguments = parser.parse_args()
    table = Table(
        ["put", "one stalled", "host CPU for a reader and put, us", "age p50, ms", "p99, ms", "most grown, MiB"]
    )
    with LocalCluster(hosts=1, supernodes=1, durable=False) as cluster, secret_found(cluster):
        for workload in WORKLOADS:
            table.rows += measure(cluster, workload, arguments.readers, arguments.rounds, arguments.seconds)
    table.notes.append(
        f"{arguments.readers} readers over the transport {TRANSPORT!r}, {arguments.rounds} rounds of two parts of "
        f"{arguments.seconds:g} s; medians of the parts "
        "(middle half). In the rows with the goal: the ratio of the two parts of each round. The goal is at most "
        f"{LONGER_MAX:.2f} times as old at p99, and at most {GROWN_BYTES_MAX // MIB} MiB more."
    )
    table.print()
    return 0


if __name__ == "__main__":
    sys.exit(main())
