"""Subscriptions over UDP multicast have the items, order and errors of ordinary ones, on both clients."""

from __future__ import annotations

import asyncio
import inspect
from collections.abc import Callable
from typing import Any

import pytest

import stampede_rt as st
from tests.contract.surfaces import Surface, take
from tests.support.waiting import pause

pytestmark = pytest.mark.parametrize("surface", ["aio", "sync"], indirect=True)
ITEMS = 30


async def until(condition: Callable[[], Any], channel: Any) -> None:
    async with asyncio.timeout(45):
        while not condition():
            await channel.stats()
            await pause()


async def following(channel: Any, subscription: Any) -> list[bytes]:
    """Put and take items until they come from datagrams. Returns their payloads."""
    payloads = list[bytes]()
    async with asyncio.timeout(45):
        while not subscription.multicast.following:
            await channel.put(b"until it is heard")
            payloads += [item.payload for item in await take(subscription, 1)]
    return payloads


async def test_datagrams_deliver_each_item_once_in_order_and_unchanged(surface: Surface) -> None:
    channel = await surface.channel()
    async with channel.subscribe(via="multicast") as subscription:
        await following(channel, subscription)
        put = [await channel.put(b"%d" % number * 700, attributes={"n": str(number)}) for number in range(ITEMS)]
        got = await take(subscription, ITEMS)
        assert [(one.seq, one.time) for one in got] == [(one.seq, one.time) for one in put]
        assert [(one.payload, dict(one.attributes)) for one in got] == [
            (b"%d" % number * 700, {"n": str(number)}) for number in range(ITEMS)
        ]
        counts = subscription.multicast
        assert counts.items > 0
        assert counts.forged == 0
        sent = (await channel.stats()).multicast
        assert (sent.readers, sent.group) == (1, counts.group)
        assert sent.datagrams >= counts.datagrams > 0
    async with asyncio.timeout(45):
        while (await channel.stats()).multicast is not None:
            await pause()


async def test_held_items_are_delivered_before_items_of_datagrams(surface: Surface) -> None:
    channel = await surface.channel()
    held = [await channel.put(b"%d" % number) for number in range(ITEMS)]
    async with channel.subscribe(held[10].time, via="multicast") as subscription:
        got = await take(subscription, ITEMS - 10)
        assert [item.seq for item in got] == [item.seq for item in held[10:]]
        await following(channel, subscription)
        last = await channel.put(b"last")
        assert [item.seq for item in await take(subscription, 1)] == [last.seq]


async def test_an_item_too_large_for_datagrams_is_fetched_from_the_host(surface: Surface) -> None:
    channel = await surface.channel()
    async with channel.subscribe(via="multicast") as subscription:
        await following(channel, subscription)
        for payload in (b"small", bytes(3 * 2**20), b"small again"):
            await channel.put(payload)
        got = await take(subscription, 3)
        assert [len(item.payload) for item in got] == [5, 3 * 2**20, 11]
        assert subscription.multicast.repairs > 1  # the reader made the first request when it changed to the datagrams
        await channel.put(b"after")
        assert [item.payload for item in await take(subscription, 1)] == [b"after"]


async def test_a_slow_reader_gets_the_held_items_and_learns_how_many_retention_collected(
    surface: Surface,
) -> None:
    channel = await surface.channel(max_items=10)
    async with channel.subscribe(via="multicast") as subscription:
        await following(channel, subscription)
        first = await channel.put(b"first")
        assert [item.seq for item in await take(subscription, 1)] == [first.seq]
        for number in range(300):  # more than the socket of the reader takes
            await channel.put(b"%d" % number * 4000)
        got = []
        async with asyncio.timeout(45):
            while not got or got[-1].payload != b"299" * 4000:
                got += await take(subscription, 1)
        seqs = [item.seq for item in got]
        assert seqs == sorted(set(seqs))
        assert len(seqs) + subscription.dropped == 300


async def test_a_deleted_channel_ends_the_multicast_with_the_reason(surface: Surface) -> None:
    channel = await surface.channel()
    async with channel.subscribe(via="multicast") as subscription:
        await following(channel, subscription)
        await channel.delete()
        with pytest.raises(st.ChannelNotFound):
            await take(subscription, 1)


async def test_a_callback_gets_its_items_from_datagrams(surface: Surface) -> None:
    channel = await surface.channel()
    seqs = list[int]()
    handle = await channel.on_item(lambda item: seqs.append(item.seq), via="multicast")
    put = [(await channel.put(b"%d" % number)).seq for number in range(ITEMS)]
    await until(lambda: len(seqs) >= ITEMS, channel)
    assert seqs == put
    async with asyncio.timeout(45):
        while not handle.multicast.following:
            await channel.put(b"until it is heard")
    handle.cancel()
    joined = handle.join(10) if inspect.iscoroutinefunction(handle.join) else asyncio.to_thread(handle.join, 10)
    assert await joined


async def test_two_readers_of_one_program_get_all_items(surface: Surface) -> None:
    channel = await surface.channel()
    async with channel.subscribe(via="multicast") as one, channel.subscribe(via="multicast") as other:
        await asyncio.gather(take(one, ITEMS), take(other, ITEMS), *(channel.put(b"x") for _ in range(ITEMS)))
        assert (await channel.stats()).multicast.readers == 2


async def test_arguments_that_do_not_fit_are_refused(surface: Surface) -> None:
    channel = await surface.channel()
    for wrong in ({"mode": "newest"}, {"payloads": False}):
        with pytest.raises(st.InvalidArgument, match="multicast"):
            async with channel.subscribe(via="multicast", **wrong):
                pass
    with pytest.raises(st.InvalidArgument, match="via is 'udp'"):
        async with channel.subscribe(via="udp"):
            pass
