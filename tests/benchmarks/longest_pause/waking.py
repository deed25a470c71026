"""Cases of puts for which many readers wait."""

from __future__ import annotations

import asyncio
from typing import Any

from tests.benchmarks.longest_pause.client import client_process
from tests.benchmarks.longest_pause.filling import fill, opened
from tests.benchmarks.longest_pause.sizes import (
    CALLS,
    FOLLOWED_ITEMS,
)
from tests.benchmarks.longest_pause.watch import PATIENCE_SECONDS, Work, until
from tests.support.channel_host.rig import MAX_INSTANT, Rig, S, between, run_of


async def reach(rig: Rig, items: int) -> tuple[str, Work]:
    """Puts of equal times, while a get waits for a later time."""
    channel, hosted = await opened(rig)
    now = rig.now()
    for _ in range(items):
        fill(hosted, now, [now])
    call = rig.channels.Get()
    await call.write(channel.get_request(interval=between(now + 3600 * S, MAX_INSTANT), wait_nanos=-1))
    await channel.until(lambda status: status.waiting_gets == 1)

    async def work() -> None:
        for _ in range(10):
            await channel.put(run_of(b"x", times=[now]))
        call.cancel()

    return f"10 puts into a bucket of {items:,} equal times while a get is blocked", work


async def release(rig: Rig, gets: int) -> tuple[str, Work]:
    """One put answers all blocked gets."""
    channel, _ = await opened(rig)
    calls = [rig.channels.Get() for _ in range(max(1, gets // CALLS))]
    for call in calls:
        for call_id in range(1, CALLS + 1):
            await call.write(channel.get_request(call_id, interval=between(rig.now(), MAX_INSTANT), wait_nanos=-1))
    await channel.until(lambda status: status.waiting_gets == len(calls) * CALLS)

    async def read(call: Any) -> None:
        answered = 0
        while answered < CALLS:
            answered += (await call.read()).HasField("summary")

    async def work() -> None:
        await channel.put(run_of(b"x"))
        async with asyncio.timeout(PATIENCE_SECONDS):
            await asyncio.gather(*map(read, calls))

    return f"a put that releases {len(calls) * CALLS:,} blocked gets", work


async def left_gets(rig: Rig, gets: int) -> tuple[str, Work]:
    """The callers of all blocked gets leave."""
    channel, _ = await opened(rig)
    calls = [rig.channels.Get() for _ in range(max(1, gets // CALLS))]
    for call in calls:
        for call_id in range(1, CALLS + 1):
            await call.write(channel.get_request(call_id, interval=channel.future(), wait_nanos=-1))
    await channel.until(lambda status: status.waiting_gets == len(calls) * CALLS)

    async def work() -> None:
        for call in calls:
            call.cancel()
        await channel.until(lambda status: status.waiting_gets == 0)

    return f"the callers of {len(calls) * CALLS:,} blocked gets leave", work


async def subscribers(rig: Rig, count: int) -> tuple[str, Work]:
    """Puts into a channel with many subscriptions, each of which gets a message."""
    channel, hosted = await opened(rig)
    client = asyncio.create_task(client_process(rig, channel, "follow")())  # type: ignore[arg-type]
    async with asyncio.timeout(PATIENCE_SECONDS):
        await until(lambda: len(hosted.subscriptions) == count)

    async def work() -> None:
        for _ in range(FOLLOWED_ITEMS):
            await channel.put(run_of(b"x"))
        await client

    return f"{FOLLOWED_ITEMS} puts to a channel with {count:,} subscriptions", work
