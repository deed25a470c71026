"""The cost of a wide group for its hosts: `python -m tests.benchmarks.wide_groups`.

64 channels at 100 items/s each, spread over 1, 2, 3, 4 and 6 hosts, without a group and in one group with
`reference="oldest"`. Each host is a process of its own (see `fed_host`). One supernode and one front-end run beside the
hosts. The difference in CPU time is the cost of the group: following the channels, exchanging times, computing cuts.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

import stampede_rt as st
from stampede_rt_bench.clusters import SECRET_VARIABLE, running
from stampede_rt_bench.measuring import Spread
from stampede_rt_bench.tables import Table, spread
from tests.benchmarks.fed_host import NO_GROUP, FedRates

CHANNELS, ITEMS_PER_SECOND = 64, 100
HOSTS = (1, 2, 3, 4, 6)
WARM_SECONDS = 1.0
PATIENCE_SECONDS = 10.0
GROUP = "wide"
COLUMNS = ("hosts", "pairs", "items/s", "CPU us/item", "a group adds", "messages/s", "lag of the cut, ms")


class FedHosts:
    """The hosts, named h1, h2, ..., which all get the same commands at the same time."""

    def __init__(self, processes: Sequence[subprocess.Popen[str]]) -> None:
        self._processes = processes

    def feed(self, seconds: float, group: st.Group | None = None) -> list[FedRates]:
        """Feed every channel for `seconds`, and observe the group's cut. Returns the work of each host meanwhile."""
        watched = NO_GROUP if group is None else group.info.group_id.hex()
        for process in self._processes:
            assert process.stdin is not None
            print(1 / ITEMS_PER_SECOND, seconds, watched, file=process.stdin, flush=True)
        return [FedRates(**json.loads(_line(process))) for process in self._processes]


@contextmanager
def fed_hosts(count: int, *flags: str) -> Iterator[FedHosts]:
    """Yield `count` hosts that are ready. At the end of the block it ends them."""
    with ExitStack() as ends:
        processes = []
        for number in range(1, count + 1):
            words = ["-m", "tests.benchmarks.fed_host", "--name", f"h{number}", "--listen", "localhost:0", *flags]
            process = subprocess.Popen(
                [sys.executable, *words], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
            )
            ends.callback(_end, process)
            processes.append(process)
        for process in processes:
            _line(process)  # the process is ready
        yield FedHosts(processes)


def _line(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None
    if not (line := process.stdout.readline()):
        raise RuntimeError(f"a host ended with exit code {process.wait(PATIENCE_SECONDS)}; its output is above")
    return line


def _end(process: subprocess.Popen[str]) -> None:
    process.terminate()
    try:
        process.communicate(timeout=PATIENCE_SECONDS)
    except subprocess.TimeoutExpired:
        process.kill()
        process.communicate()


@dataclass(frozen=True)
class Cost:
    """The sum over all hosts of one run. The lag of the cut is the lag of the slowest host."""

    items_per_second: float
    cpu_us_per_item: float
    messages_per_second: float
    cut_lag_ms: float

    @classmethod
    def of(cls, feds: Sequence[FedRates]) -> Cost:
        """The sum over the hosts."""
        items, wall_s = sum(fed.items for fed in feds), max(fed.wall_s for fed in feds)
        return cls(
            items_per_second=items / wall_s,
            cpu_us_per_item=sum(fed.cpu_s for fed in feds) / items * 1e6,
            messages_per_second=sum(fed.messages for fed in feds) / wall_s,
            cut_lag_ms=max(fed.cut_lag_ms or 0.0 for fed in feds),
        )


def measure(hosts: int, seconds: float, warm_seconds: float = WARM_SECONDS) -> tuple[Cost, Cost]:
    """The same channels on the same hosts, first without a group, then in one. Raises RuntimeError if no cut came."""
    with running(hosts=0) as address, st.connect(address) as rt:
        flags = ("--frontend", address, "--secret-file", os.environ[SECRET_VARIABLE], "--log-level", "warning")
        with fed_hosts(hosts, *flags) as fed:
            channels = [
                rt.channel(f"c{number:02}", max_items=1000, host=f"h{number % hosts + 1}") for number in range(CHANNELS)
            ]
            for channel in channels:
                channel.put(b"so that the host hosts the channel")
            fed.feed(warm_seconds)
            alone = Cost.of(fed.feed(seconds))
            group = rt.group(GROUP, channels, reference="oldest")
            for channel in channels[:hosts]:
                group[channel].newest(timeout=PATIENCE_SECONDS)  # so that every host has the group and its cut
            fed.feed(warm_seconds, group)
            feds = fed.feed(seconds, group)
    if any(one.cut_lag_ms is None for one in feds):
        raise RuntimeError(f"not all of {hosts} hosts had a cut of the group")
    return alone, Cost.of(feds)


def table(hosts: Sequence[int], seconds: float, runs: int) -> Table:
    """A row for each number of hosts."""
    found = Table(COLUMNS)
    for count in hosts:
        print(f"{count} hosts ...", file=sys.stderr, flush=True)
        costs = [measure(count, seconds) for _ in range(runs)]
        alone, grouped = ([cost[place] for cost in costs] for place in (0, 1))
        found.rows.append(
            [
                str(count),
                str(count * (count - 1) // 2),
                spread(Spread.of([one.items_per_second for one in grouped]), 0),
                spread(Spread.of([one.cpu_us_per_item for one in alone]), 1),
                spread(Spread.of([more.cpu_us_per_item - less.cpu_us_per_item for less, more in costs]), 1),
                spread(Spread.of([one.messages_per_second for one in grouped]), 0),
                spread(Spread.of([one.cut_lag_ms for one in grouped]), 1),
            ]
        )
    found.notes = [f"{runs} runs of {seconds:g} s; medians (least to most); CPU and messages of all hosts together."]
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--hosts", type=int, nargs="+", default=HOSTS)
    arguments = parser.parse_args()
    table(arguments.hosts, arguments.seconds, arguments.runs).print()


if __name__ == "__main__":
    main()
