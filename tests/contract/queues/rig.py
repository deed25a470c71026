"""Connections and queues for the tests of this folder."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import stampede_rt as st
from stampede_rt import aio
from tests.support.awaitable_blocking import awaitable
from tests.support.waiting import pause

numbers = itertools.count()


class Rig:
    """Connections of one client to the cluster, and queues with names that no other test uses."""

    def __init__(self, address: str, pool: ThreadPoolExecutor | None) -> None:
        self.address = address
        self.pool = pool
        self.connections: list[Any] = []
        self.rt: Any = None

    async def connect(self, **named: Any) -> Any:
        if self.pool is None:
            made = await aio.connect(self.address, **named)
        else:
            made = awaitable(await asyncio.to_thread(st.connect, self.address, **named), self.pool)
        self.connections.append(made)
        return made

    def name(self) -> str:
        return f"contract/q{next(numbers)}-{st.now()}"

    async def queue(self, name: str | None = None, **stated: Any) -> Any:
        return await self.rt.queue(name or self.name(), **stated)


async def until(queue: Any, condition: Callable[[st.QueueStats], bool]) -> st.QueueStats:
    """Return the first counters for which `condition` holds. Waits for at most 45 s."""
    async with asyncio.timeout(45):
        while not condition(stats := await queue.stats()):
            adds_up(stats)
            await pause()
        return adds_up(stats)


def adds_up(stats: st.QueueStats) -> st.QueueStats:
    gone = stats.consumed + stats.dropped + stats.dead_lettered + stats.expelled
    assert stats.accepted == stats.held + gone
    return stats


async def lease_from_now_on(queue: Any, lease: str) -> None:
    """Set the lease of later deliveries, so that only the leases of earlier ones end soon."""
    await queue.configure(lease=lease)
    await until(queue, lambda stats: stats.policy.lease_nanos == int(lease[:-1]) * 10**9)
