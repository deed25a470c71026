"""The time to drain a host with 1,000 channels and 1 GB, compared with the copy of 1 GB over a bare stream of gRPC.

The receiver of the copy keeps all bytes, as the destination of a drain does. So the system provides new memory for
them. A second copy throws each message away, and so uses the same memory for all messages.
"""

from __future__ import annotations

import sys
import time
from collections import deque
from typing import Any

import grpc

import stampede_rt as st
from stampede_rt.transports.grpc_options import CHANNEL_OPTIONS
from stampede_rt_bench.measuring import Spread
from stampede_rt_bench.tables import Table, spread
from tests.benchmarks.bare_server import REQUEST
from tests.benchmarks.copies_cost.figures import ratio
from tests.support.cluster import running_cluster
from tests.support.processes import started

CHANNELS, ITEMS, ITEM_BYTES = 1000, 16, 62_500
TOTAL_BYTES = CHANNELS * ITEMS * ITEM_BYTES
GOAL = 2.0
CALL_S = 60


def measure(rounds: int) -> Table:
    """Make the table. The channels go from one host to the other and back. Drains and bare copies take turns."""
    drains_s, kept_s, thrown_s = list[float](), list[float](), list[float]()
    with running_cluster(hosts=2, supernodes=1) as cluster, st.connect(cluster.address, transport="grpc") as rt:
        _fill(rt)
        for at in range(rounds):
            drains_s.append(_drain_s(rt, ("h1", "h2")[at % 2]))
            kept_s.append(_copy_s(messages_kept=CHANNELS))
            thrown_s.append(_copy_s(messages_kept=1))
    table = Table(["drain, s", "copy, kept, s", "ratio", "goal", "copy, thrown away, s", "its ratio"])
    drain, kept, thrown = (spread(Spread.of(one), 2) for one in (drains_s, kept_s, thrown_s))
    goal = f"at most {GOAL:g}"
    table.rows.append([drain, kept, ratio(drains_s, kept_s), goal, thrown, ratio(drains_s, thrown_s)])
    table.notes = [f"{CHANNELS:,} channels, each with {ITEMS} items of {ITEM_BYTES:,} B; the bare messages have 1 MB."]
    return table


def _fill(rt: Any) -> None:
    for number in range(CHANNELS):
        channel = rt.channel(f"drained/{number}", host="h1", max_items=ITEMS)
        with channel.producer() as producer:
            for _ in range(ITEMS):
                producer.put(bytes(ITEM_BYTES))


def _drain_s(rt: Any, host: str) -> float:
    """Drain the host, with as many calls as needed: one call lasts a minute at most."""
    began = time.perf_counter()
    while rt.drain(host, timeout=f"{CALL_S}s").left_count:
        pass
    return time.perf_counter() - began


def _copy_s(messages_kept: int) -> float:
    """Fetch as many bytes as the channels have from a bare server, in messages of the bytes of one channel."""
    kept: deque[bytes] = deque(maxlen=messages_kept)
    with started([sys.executable, "-m", "tests.benchmarks.bare_server"]) as server:
        assert server.stdout is not None
        target = f"127.0.0.1:{server.stdout.readline().strip()}"
        with grpc.insecure_channel(target, options=CHANNEL_OPTIONS) as channel:
            call: Any = channel.stream_stream("/Bare/Fetch")
            list(call(iter([REQUEST.pack(1, 1, 1)])))  # the connection is there
            began = time.perf_counter()
            kept.extend(call(iter([REQUEST.pack(CHANNELS, ITEMS, ITEM_BYTES)])))
            took = time.perf_counter() - began
    assert sum(map(len, kept)) == TOTAL_BYTES // CHANNELS * messages_kept
    return took
