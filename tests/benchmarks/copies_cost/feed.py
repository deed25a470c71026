"""The lag of a proxy whose channel gets 100,000 items of 64 B a second."""

from __future__ import annotations

import multiprocessing
import time
from typing import Any

import stampede_rt as st
from stampede_rt_bench.measuring import Spread
from stampede_rt_bench.tables import Table, number, spread
from stampede_rt_local.cluster import LocalCluster
from tests.support.cluster import running_cluster

RATE, BATCH = 100_000, 500  # items a second, and items put together
SECONDS = 8.0
WARM_S = 2.0
LOOK_S = 0.02
ITEMS_MAX = 3 * RATE
GOAL_MS = 100
NAME = "fed"


def measure(rounds: int) -> Table:
    """Make the table. Each round has a new producer's process."""
    rates, medians, most, all_ms, missed = list[float](), list[float](), list[float](), list[float](), 0
    with running_cluster(hosts=2, supernodes=1) as cluster, st.connect(cluster.address, transport="grpc") as rt:
        channel = rt.channel(NAME, host="h1", max_items=ITEMS_MAX)
        channel.put(bytes(64))
        rt.proxy(channel, "h2")
        for _ in range(rounds):
            rate, lags_ms = _round(cluster, channel)
            rates.append(rate)
            medians.append(lags_ms[len(lags_ms) // 2])
            most.append(lags_ms[len(lags_ms) * 99 // 100])
            all_ms += lags_ms
        missed = rt.proxies(channel)[0].missed or 0
    table = Table(["items/s", "lag p50, ms", "lag p99, ms", "longest, ms", "missed", "goal"])
    cells = spread(Spread.of(rates), 0), spread(Spread.of(medians)), spread(Spread.of(most)), number(max(all_ms), 1)
    table.rows.append([*cells, number(missed), f"p99 under {GOAL_MS} ms"])
    table.notes = [
        "Lag: the age of the proxy's newest item when a client has read it there, so the read and the wait for the "
        f"next batch count, too. A producer's process puts {BATCH} items each {1000 * BATCH / RATE:g} ms."
    ]
    return table


def _round(cluster: LocalCluster, channel: Any) -> tuple[float, list[float]]:
    """Return the accepted items a second, and the lags in ms, in order."""
    context = multiprocessing.get_context("spawn")
    producer = context.Process(target=_produce, args=(cluster.address,), daemon=True)
    producer.start()
    lags_ms: list[float] = []
    first = channel.stats().accepted
    while channel.stats().accepted < first + RATE * WARM_S / 2:
        time.sleep(LOOK_S)
    begun_s, before = time.monotonic(), channel.stats().accepted
    while time.monotonic() < begun_s + SECONDS:
        lags_ms += _lag_ms(channel)
        time.sleep(LOOK_S)
    rate = (channel.stats().accepted - before) / (time.monotonic() - begun_s)
    producer.join(60)
    return rate, sorted(lags_ms)


def _lag_ms(channel: Any) -> list[float]:
    found = channel.get(st.OLDEST, st.NEWEST, newest_first=True, limit=1, payloads=False, max_staleness="60s")
    return [] if found.staleness_nanos is None else [(st.now() - found[0].time) / 1e6]


def _produce(address: str) -> None:
    """Put at RATE until the round is over."""
    with st.connect(address, transport="grpc") as rt:
        channel = rt.channel(NAME)
        with channel.producer() as producer:
            begun_s = time.monotonic()
            for batch in range(int((WARM_S + SECONDS + 1) * RATE / BATCH)):
                for _ in range(BATCH):
                    producer.put(bytes(64))
                time.sleep(max(0.0, begun_s + (batch + 1) * BATCH / RATE - time.monotonic()))
