"""Figure 6 of the paper: the frames that readers of one channel do not get, without a proxy, with one and with two.

A producer puts frames of 18 KB at 30 a second. Each reader is a process that subscribes, and the client spreads the
subscriptions over the owner and the proxies. Each host is in a network namespace of its own, and sends at most
LINK_MBIT. So the link of a host is the bottleneck, as in the paper. The paper has frames of 300 KB and links of 1
Gbit/s: such a link carries the frames of 13 readers. A link here carries the frames of LINK_READERS readers.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import stampede_rt as st
from stampede_rt_bench.charts import Axes, Points, draw_lines
from stampede_rt_bench.clusters import SECRET_VARIABLE, cluster_of, secret_found
from stampede_rt_bench.measuring import Effort, Spread
from stampede_rt_bench.peers.ours import NAME, StampedeClient, StampedeRt
from stampede_rt_bench.tables import Table, number, spread
from stampede_rt_bench.workloads.catalogue import FRAMES_PER_SECOND, MEDIUM, frames, size
from stampede_rt_bench.workloads.interface import RunningServer, WorkloadNeeds
from stampede_rt_bench.workloads.processes import ServerFailed
from stampede_rt_bench.workloads.run import RunResult
from stampede_rt_bench.workloads.run import measure as measure_run
from stampede_rt_local.namespaces import NamespaceNetwork, run, unavailable_because
from stampede_rt_local.process import ServiceFailed

READERS = (8, 20, 24, 40, 48, 64)
PROXIES = (0, 1, 2)
SECONDS = 6.0
LINK_MBIT = 100
KEPT_FRAMES = 15  # half a second: a reader that is behind by more has lost frames
LINK_READERS = int(LINK_MBIT * 1e6 / (8 * MEDIUM * FRAMES_PER_SECOND))


@dataclass(frozen=True)
class WithProxies(StampedeRt):
    """One channel, and a proxy of it at each further host. With a `network` each host has a slow link."""

    proxies: int = 0
    network: NamespaceNetwork | None = field(default=None, compare=False)

    @contextmanager
    def served(self, needs: WorkloadNeeds) -> Iterator[RunningServer]:
        """Run a cluster of one supernode and the hosts for the duration of the context. Raises ServerFailed."""
        cluster = cluster_of(1 + self.proxies, self.network)
        with ExitStack() as stack:
            try:
                stack.enter_context(cluster)
                stack.enter_context(secret_found(cluster))
                rt = stack.enter_context(st.connect(cluster.address, transport=self.transport))
                rt.channel(NAME, max_items=KEPT_FRAMES, host="h1")
                for one in range(self.proxies):
                    rt.proxy(NAME, f"h{2 + one}")
            except (ServiceFailed, st.StampedeError) as error:
                raise ServerFailed(str(error)) from error
            secret = {SECRET_VARIABLE: str(cluster.secret_file)}
            pids = [process.pid for process in cluster.processes()]
            yield RunningServer(address=cluster.address, pids=pids, environment=secret)

    def connect(self, served: RunningServer, needs: WorkloadNeeds) -> StampedeClient:
        """Return a client with a new connection."""
        return StampedeClient(served.address, replace(needs, items_max=KEPT_FRAMES), self.transport)


class Case(NamedTuple):
    """The figures of one number of readers and proxies. `cores`: % of a core of the owner, and of each proxy's host."""

    readers: int
    proxies: int
    lost: Spread
    cores: Sequence[Spread]

    @property
    def busiest(self) -> Spread:
        """Return the CPU time of the busiest host."""
        return max(self.cores, key=lambda one: one.median)

    def row(self) -> list[str]:
        """Return the row of the table."""
        proxy_cores = ", ".join(spread(one, 0) for one in self.cores[1:])
        lost, owner = spread(self.lost), spread(self.cores[0], 0)
        return [number(self.readers), number(self.proxies), lost, owner, proxy_cores]


def measure(effort: Effort, chart: Path) -> Table:
    """Make the table and the charts: the lost frames, and the CPU time of the busiest host."""
    why_not = unavailable_because()
    with nullcontext() if why_not else NamespaceNetwork(1 + max(PROXIES)) as network:
        if network is not None:
            slow_down(network)
        cases = [_case(effort, network, readers, proxies) for readers in READERS for proxies in PROXIES]
    title = f"Frames of {size(MEDIUM)} at {FRAMES_PER_SECOND} a second that readers did not get"
    draw_lines(chart, _axes(title, "% of the frames"), _lines(cases, lambda case: case.lost))
    title = "CPU time of the busiest host of the channel"
    draw_lines(
        chart.with_stem(f"{chart.stem}-cpu"), _axes(title, "% of a core"), _lines(cases, lambda one: one.busiest)
    )
    table = Table(["readers", "proxies", "frames lost, %", "CPU of the owner, % of a core", "of each proxy's host"])
    table.rows.extend(case.row() for case in cases)
    table.notes = _notes(effort, why_not)
    return table


def slow_down(network: NamespaceNetwork) -> None:
    """Let each namespace of the network send at most LINK_MBIT. Raises OSError."""
    limit = ["tbf", "rate", f"{LINK_MBIT}mbit", "burst", "64kb", "latency", "50ms"]
    for namespace in network.namespaces:
        run(namespace.command("tc", "qdisc", "add", "dev", "eth0", "root", *limit))


def _case(effort: Effort, network: NamespaceNetwork | None, readers: int, proxies: int) -> Case:
    system, workload = WithProxies(proxies=proxies, network=network), frames(MEDIUM, readers)
    runs = [measure_run(system, workload, SECONDS) for _ in range(effort.runs)]
    lost = Spread.of([100 * one.lost_share for one in runs])
    return Case(readers, proxies, lost, [_cores(runs, host) for host in range(1 + proxies)])


def _cores(runs: Sequence[RunResult], host: int) -> Spread:
    return Spread.of([100 * one.server_cores[host] for one in runs])


def _axes(title: str, y: str) -> Axes:
    return Axes(title=title, x="readers of one channel", y=y, log_x=False)


def _lines(cases: Sequence[Case], value: Callable[[Case], Spread]) -> dict[str, Points]:
    return {
        label: [(case.readers, value(case)) for case in cases if case.proxies == proxies]
        for proxies, label in zip(PROXIES, ("no proxy", "one proxy", "two proxies"), strict=True)
    }


def _notes(effort: Effort, why_not: str | None) -> list[str]:
    where = f"Each host is in a network namespace of its own, and sends at most {LINK_MBIT} Mbit/s."
    if why_not:
        where = f"All processes share this machine's loopback, whose rate has no limit: {why_not}."
    return [
        f"{effort.runs} runs of {SECONDS:g} s; medians (least to most). A frame that is a second late counts as lost.",
        where,
        f"The frames of {LINK_READERS} readers fill such a link; the feed of a proxy counts as one more reader.",
        "Paper: 300 KB over Gigabit Ethernet; 16 readers lose about 17 % of the frames, and a proxy relieves the host.",
    ]
