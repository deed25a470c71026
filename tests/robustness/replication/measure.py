"""Measures commits and confirmed reads of three members with real stores: `python -m ...replication.measure`."""

from __future__ import annotations

import asyncio
import statistics
import tempfile
import time
from collections.abc import Awaitable, Callable
from pathlib import Path

from stampede_rt_supernode.replication import RaftTiming, ReplicatedLog
from tests.support.supernode.live_cluster import LiveCluster, running

ONE_BY_ONE = 300
SECONDS = 3.0


async def latency(call: Callable[[], Awaitable[object]]) -> str:
    """Median and 99th percentile of calls made one after the other."""
    took = []
    for _ in range(ONE_BY_ONE):
        began = time.perf_counter()
        await call()
        took.append((time.perf_counter() - began) * 1000)
    return f"p50 {statistics.median(took):.2f} ms, p99 {sorted(took)[ONE_BY_ONE * 99 // 100]:.2f} ms"


async def throughput(log: ReplicatedLog, callers: int) -> float:
    """Acknowledged writes per second of `callers` parallel callers."""
    done, end = 0, time.perf_counter() + SECONDS

    async def write(caller: int) -> None:
        nonlocal done
        number = 0
        while time.perf_counter() < end:
            number += 1
            await log.propose(b"%d of %d in %d" % (number, caller, id(log) + callers), timeout=10.0)
            done += 1

    await asyncio.gather(*(write(caller) for caller in range(callers)))
    return done / SECONDS


async def measure(folder: Path) -> None:
    async with LiveCluster(3, folder, timing=RaftTiming()) as cluster:
        leader, follower = await cluster.leader(), (await cluster.followers())[0]
        for name, log in (("leader", running(leader)), ("follower", running(follower))):
            commands = (b"%s %d" % (name.encode(), number) for number in range(ONE_BY_ONE))
            print(f"{name}: write {await latency(lambda log=log, c=commands: log.propose(next(c), timeout=10.0))}")  # type: ignore[misc]
            print(f"{name}: read  {await latency(lambda log=log: log.confirm_read(timeout=10.0))}")  # type: ignore[misc]
            for callers in (16, 64):
                print(f"{name}: {await throughput(log, callers):.0f} writes/s from {callers} callers")


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as scratch:
        asyncio.run(measure(Path(scratch)))
