"""Measures the memory that a host needs for idle channels and for held items."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Awaitable, Callable, Mapping
from pathlib import Path

from stampede_rt import aio
from stampede_rt_bench.measuring import Spread
from stampede_rt_bench.workloads.catalogue import MEDIUM, SMALL
from stampede_rt_local.cluster import LocalCluster

EMPTY = "a host without channels"
CHANNELS_PER_ITEM, RUN_ITEMS_PER_ITEM, FRAMES_PER_ITEM = 0.05, 10, 0.1
WARM_UP_SHARE = 0.1
PUTS_UNDER_WAY = 100
BYTES_MAX = 1 << 33

Fill = Callable[[aio.Connection, str, int], Awaitable[None]]


def measure_memory(items: int, rounds: int) -> dict[str, Spread]:
    """Return the growth of a host's resident memory in bytes for one thing of each kind. EMPTY: the memory of the host
    alone.

    In each round the host gets `items` items of 64 B one by one, and other things in numbers that take similar memory.
    It keeps all of them. A first small round does not count, because the host then loads code and fills its caches.
    """
    with LocalCluster(hosts=1, supernodes=1, durable=False, log_level="error") as cluster:
        return asyncio.run(_measure(cluster, items, rounds))


async def _measure(cluster: LocalCluster, items: int, rounds: int) -> dict[str, Spread]:
    host = cluster.hosts[0].pid
    found: dict[str, list[float]] = {EMPTY: [float(resident_bytes(host))], **{kind: [] for kind in KINDS}}
    async with aio.connect(cluster.address, secret=cluster.secret_file) as rt:
        await _round(rt, host, "warm-up", max(1, int(items * WARM_UP_SHARE)))
        for number in range(rounds):
            for kind, growth in (await _round(rt, host, str(number), items)).items():
                found[kind].append(growth)
    return {kind: Spread.of(values) for kind, values in found.items()}


async def _round(rt: aio.Connection, host: int, name: str, items: int) -> Mapping[str, float]:
    grown = {}
    for place, (kind, (share, fill)) in enumerate(KINDS.items()):
        count, before = max(1, int(items * share)), resident_bytes(host)
        await fill(rt, f"bench/{name}/{place}", count)
        grown[kind] = (resident_bytes(host) - before) / count
    return grown


async def _open(rt: aio.Connection, name: str, count: int) -> None:
    for number in range(count):  # a host knows a channel from its first item
        await (await rt.channel(f"{name}/{number}", max_items=1)).put(bytes(SMALL))


def _one_by_one(payload_bytes: int) -> Fill:
    async def fill(rt: aio.Connection, name: str, count: int) -> None:
        channel = await rt.channel(name, max_items=count, max_bytes=BYTES_MAX)
        payload = bytes(payload_bytes)
        for first in range(0, count, PUTS_UNDER_WAY):
            await asyncio.gather(*(channel.put(payload) for _ in range(min(PUTS_UNDER_WAY, count - first))))
        await _see_all_held(channel, count)

    return fill


async def _in_runs(rt: aio.Connection, name: str, count: int) -> None:
    channel = await rt.channel(name, max_items=count, max_bytes=BYTES_MAX)
    payload = bytes(SMALL)
    async with channel.producer() as producer:
        for _ in range(count):
            await producer.put(payload)
    await _see_all_held(channel, count)


async def _see_all_held(channel: aio.Channel, count: int) -> None:
    held = (await channel.stats()).held
    if held != count:
        raise AssertionError(f"the host holds {held} items of {channel.name} and not {count}")


def resident_bytes(pid: int) -> int:
    """Return the resident memory of a process."""
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGESIZE")


KINDS: Mapping[str, tuple[float, Fill]] = {
    "a channel with one item of 64 B": (CHANNELS_PER_ITEM, _open),
    "an item of 64 B, put alone": (1, _one_by_one(SMALL)),
    "an item of 64 B, put in a run": (RUN_ITEMS_PER_ITEM, _in_runs),
    "an item of 18 KB": (FRAMES_PER_ITEM, _one_by_one(MEDIUM)),
}
