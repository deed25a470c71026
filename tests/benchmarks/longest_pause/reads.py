"""Cases of reads: gets, subscriptions, pages of items and of channels."""

from __future__ import annotations

import asyncio

from stampede_rt.v1 import channel_pb2
from stampede_rt.v1 import gatekeeper_service_pb2 as gate_pb
from tests.benchmarks.longest_pause.client import client_process
from tests.benchmarks.longest_pause.filling import fill, in_order, interleaved, opened
from tests.benchmarks.longest_pause.sizes import (
    PAGE_ITEMS,
)
from tests.benchmarks.longest_pause.watch import PATIENCE_SECONDS, Work
from tests.support.channel_host.rig import MAX_INSTANT, MIN_INSTANT, Rig, between


async def large_get(rig: Rig, items: int) -> tuple[str, Work]:
    channel, hosted = await opened(rig)
    interleaved(hosted, rig, items)
    return f"get of {items:,} items of two producers that interleave, no payloads", client_process(rig, channel, "get")


async def given_up_get(rig: Rig, items: int) -> tuple[str, Work]:
    """The host gathers the answer. The reader leaves when the first message has come."""
    channel, hosted = await opened(rig)
    interleaved(hosted, rig, items)

    async def work() -> None:
        call = rig.channels.Get()
        interval = between(MIN_INSTANT, MAX_INSTANT)
        await call.write(channel.get_request(interval=interval, without_payloads=True))
        async with asyncio.timeout(PATIENCE_SECONDS):
            await call.read()
        call.cancel()
        for _ in range(2 * items // 256):
            await asyncio.sleep(0)

    return f"the same get, given up when the first message of {items:,} items has come", work


async def subscription(rig: Rig, items: int) -> tuple[str, Work]:
    channel, hosted = await opened(rig)
    in_order(hosted, rig, items)
    return f"subscribe from the oldest of {items:,} single puts on", client_process(rig, channel, "subscribe")


async def page(rig: Rig, items: int) -> tuple[str, Work]:
    channel, hosted = await opened(rig)
    now = rig.now()
    for _ in range(items):
        fill(hosted, now, [now])
    after = {"time_unix_nano": now, "seq": items - 2 * PAGE_ITEMS}

    async def work() -> None:
        got = await channel.get(limit=PAGE_ITEMS, after=after)
        assert len(got.runs) == PAGE_ITEMS

    return f"a page of {PAGE_ITEMS} in a bucket of {items:,} equal times", work


async def listing(rig: Rig, channels: int) -> tuple[str, Work]:
    for number in range(channels):
        await rig.open(f"c/{number:06}", channel_pb2.ChannelSpec())

    async def work() -> None:
        page = await rig.gate.ListHostedChannels(gate_pb.ListHostedChannelsRequest())
        assert len(page.channels) == min(channels, 1000)

    return f"a page of 1000 of {channels:,} channels", work
