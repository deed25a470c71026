"""Puts with ack="host" and with ack="replica", into a channel and a queue: one put, and puts in runs."""

from __future__ import annotations

import statistics
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import stampede_rt as st
from stampede_rt_bench.measuring import Spread
from stampede_rt_bench.tables import Table, spread
from tests.benchmarks.copies_cost.figures import ratio
from tests.support.cluster import running_cluster
from tests.support.waiting import wait_until

PAYLOAD = bytes(64)
SECONDS = 2.0
LATENCY_GOAL, RATE_GOAL = 1.6, 0.7
REPLICATED: dict[str, Any] = {"replicas": 1, "ack": "replica"}
ITEMS_MAX = 20_000
QUEUED = 1000  # puts into a queue, before a taker empties it


def measure(rounds: int) -> Table:
    """Make the table. Each round has both kinds of ack, and the kind that comes first changes from round to round."""
    found: dict[str, dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    with running_cluster(hosts=2, supernodes=1) as cluster, st.connect(cluster.address, transport="grpc") as rt:
        operations = {name: dict(both) for name, both in _operations(rt)}
        for at in range(rounds):
            for name, both in operations.items():
                for ack in sorted(both, reverse=bool(at % 2)):
                    found[name][ack].append(both[ack]())
    table = Table(["operation", 'ack="host"', 'ack="replica"', "ratio, by rounds", "goal"])
    for name, by_ack in found.items():
        goal = f"at most {LATENCY_GOAL}" if name.endswith("us") else f"at least {RATE_GOAL}"
        both_spreads = [spread(Spread.of(by_ack[ack]), 0) for ack in ("host", "replica")]
        table.rows.append([name, *both_spreads, ratio(by_ack["replica"], by_ack["host"]), goal])
    table.notes = [
        f"Items of {len(PAYLOAD)} B; puts of a channel for {SECONDS:g} s in each round, of a queue {QUEUED}."
    ]
    return table


def _operations(rt: Any) -> Iterator[tuple[str, list[tuple[str, Callable[[], float]]]]]:
    """Yield each operation with its two kinds of ack. An operation returns its figure."""
    plain = rt.channel("plain", host="h1", max_items=ITEMS_MAX)
    copied = rt.channel("copied", host="h1", max_items=ITEMS_MAX, **REPLICATED)
    plain_queue, copied_queue = rt.queue("plain", host="h1"), rt.queue("copied", host="h1", **REPLICATED)
    wait_until(lambda: any(one.in_sync for one in copied.stats().copies), "the replica is in sync")
    wait_until(lambda: any(one.in_sync for one in copied_queue.stats().replicas), "the queue's replica is in sync")
    yield "one put, us", [("host", partial(_put_us, plain)), ("replica", partial(_put_us, copied))]
    yield "runs, items/s", [("host", partial(_rate, plain)), ("replica", partial(_rate, copied))]
    queues = ("host", plain_queue), ("replica", copied_queue)
    yield "queue, one put, us", [(ack, partial(_queue_put_us, queue)) for ack, queue in queues]
    yield "queue, take and ack, us", [(ack, partial(_queue_take_us, queue)) for ack, queue in queues]


def _timed_us(operation: Callable[[], Any]) -> float:
    began = time.perf_counter()
    operation()
    return (time.perf_counter() - began) * 1e6


def _put_us(channel: Any) -> float:
    end_s, took = time.monotonic() + SECONDS, []
    while time.monotonic() < end_s:
        took.append(_timed_us(lambda: channel.put(PAYLOAD)))
    return statistics.median(took)


def _rate(channel: Any) -> float:
    began, count = time.perf_counter(), 0
    with channel.producer() as producer:
        while time.perf_counter() - began < SECONDS:
            for _ in range(256):
                producer.put(PAYLOAD)
            count += 256
    return count / (time.perf_counter() - began)


def _queue_put_us(queue: Any) -> float:
    took = [_timed_us(lambda: queue.put(PAYLOAD)) for _ in range(QUEUED)]
    for _ in range(QUEUED):
        queue.get(timeout=10).ack()
    return statistics.median(took)


def _queue_take_us(queue: Any) -> float:
    for _ in range(QUEUED):
        queue.put(PAYLOAD)
    return statistics.median(_timed_us(lambda: queue.get(timeout=10).ack()) for _ in range(QUEUED))
