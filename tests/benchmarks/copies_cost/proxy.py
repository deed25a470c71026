"""The CPU time that a proxy costs the owner of a channel, compared with the CPU time of one more subscriber."""

from __future__ import annotations

import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from typing import Any

import stampede_rt as st
from stampede_rt.cluster.transport_choice import Transport
from stampede_rt_bench.measuring import Spread
from stampede_rt_bench.tables import Table, spread
from stampede_rt_local.process import ServiceProcess
from tests.benchmarks.copies_cost.figures import cpu_s
from tests.support.cluster import running_cluster
from tests.support.waiting import wait_until

SUBSCRIBERS = 2  # in all cases
SECONDS = 3.0  # the time of each case
WORKLOADS = {
    "30 frames/s of 18 KB": (18_000, 30, Transport.GRPC),
    "1000 items/s of 64 B": (64, 1000, Transport.GRPC),
    "1000 items/s of 64 B, clients over sockets": (64, 1000, Transport.SOCKET),
}
NONE, SUBSCRIBER, PROXY = "none", "a subscriber", "a proxy"


def measure(rounds: int) -> Table:
    """Make the table. A round has three cases: neither, one more subscriber, one proxy."""
    table = Table(["work", "owner alone, us/put", "a subscriber adds, us/put", "a proxy adds, us/put", "ratio", "goal"])
    with running_cluster(hosts=2, supernodes=1) as cluster:
        for name, (item_bytes, rate, transport) in WORKLOADS.items():
            found: dict[str, list[float]] = defaultdict(list)
            with st.connect(cluster.address, transport=transport) as rt, _channel(rt, item_bytes) as channel:
                for at in range(rounds):
                    for case in (NONE, SUBSCRIBER, PROXY)[:: -1 if at % 2 else 1]:
                        with _added(rt, channel, case):
                            found[case].append(_cpu_us(cluster.hosts[0], channel, bytes(item_bytes), rate))
            table.rows.append([name, *_row(found)])
    table.notes = [f"CPU time of the owner's process for each put; it has {SUBSCRIBERS} subscribers in each case."]
    return table


def _row(found: dict[str, list[float]]) -> Iterator[str]:
    added = {case: Spread.of(_differences(found[case], found[NONE])) for case in (SUBSCRIBER, PROXY)}
    yield spread(Spread.of(found[NONE]), 1)
    yield spread(added[SUBSCRIBER], 1)
    yield spread(added[PROXY], 1)
    yield f"{added[PROXY].over(added[SUBSCRIBER]):.2f}"
    yield "at most 1"


def _differences(some: list[float], others: list[float]) -> list[float]:
    return [one - other for one, other in zip(some, others, strict=True)]


@contextmanager
def _channel(rt: Any, item_bytes: int) -> Iterator[Any]:
    """A channel at h1 with readers that stay there."""
    channel = rt.channel(f"owned/{item_bytes}", host="h1", max_items=1000)
    with _subscribed(channel), _subscribed(channel):
        yield channel


@contextmanager
def _added(rt: Any, channel: Any, case: str) -> Iterator[None]:
    """The subscriber or the proxy of this case."""
    with _subscribed(channel) if case == SUBSCRIBER else nullcontext():
        if case == PROXY:
            rt.proxy(channel, "h2")
        yield
    if case == PROXY:
        rt.remove_proxy(channel, "h2")
        wait_until(lambda: channel.name not in rt.hosted_channels("h2", "owned/*"), "the proxy has ended")


@contextmanager
def _subscribed(channel: Any) -> Iterator[None]:
    """A subscriber at the owner, which takes all items."""
    subscription = channel.subscribe(stale_ok=False)
    thread = threading.Thread(target=lambda: [None for _ in subscription], daemon=True)
    thread.start()
    try:
        yield
    finally:
        subscription.close()
        thread.join(20)


def _cpu_us(owner: ServiceProcess, channel: Any, payload: bytes, rate: float) -> float:
    """Put at this rate, and return the owner's CPU time for each put, in us."""
    paced(lambda: channel.put(payload), rate, SECONDS / 4)
    before_s = cpu_s(owner)
    puts = paced(lambda: channel.put(payload), rate, SECONDS)
    return (cpu_s(owner) - before_s) / puts * 1e6


def paced(put: Callable[[], Any], rate: float, seconds: float) -> int:
    """Put at this rate, and return the number of puts. After a late put the next puts keep the period."""
    due_s, puts = time.monotonic(), 0
    end_s = due_s + seconds
    while time.monotonic() < end_s:
        put()
        puts += 1
        due_s = max(due_s + 1 / rate, time.monotonic())
        time.sleep(max(0.0, due_s - time.monotonic()))
    return puts
