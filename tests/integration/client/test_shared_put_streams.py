"""Puts of all handles go over one stream for each host and thread, and do not disturb each other."""

from __future__ import annotations

import asyncio
import threading
from typing import Any, Literal

import pytest

import stampede_rt as st
from stampede_rt import aio
from stampede_rt_local.cluster import LocalCluster
from tests.support.sharing.shared_cluster import shared_cluster_fixture
from tests.support.waiting import pause, until

cluster = shared_cluster_fixture(hosts=1)
CHANNELS = 60
LIMIT_S = 20.0


def test_many_channels_of_a_thread_need_one_stream_and_no_more_threads(cluster: LocalCluster) -> None:
    with st.connect(cluster.address) as rt:
        channels = [rt.channel(f"shared/{number}", max_items=5) for number in range(CHANNELS)]
        channels[0].put(b"x")
        before, streams = threading.active_count(), rt._session.put_streams._streams
        for channel in channels:
            channel.put(b"x")
        assert threading.active_count() <= before
        assert len(streams) == 1
        another = threading.Thread(target=lambda: [channel.put(b"y") for channel in channels])
        another.start()
        another.join(LIMIT_S)
        assert len(streams) == 2, "a stream belongs to its thread"
        newest = [channel.newest() for channel in channels]
        assert [item.payload for item in newest if item is not None] == [b"y"] * CHANNELS


async def test_many_asyncio_channels_need_one_stream(cluster: LocalCluster) -> None:
    async with await aio.connect(cluster.address) as rt:
        channels = [await rt.channel(f"shared/awaited/{number}", max_items=5) for number in range(CHANNELS)]
        async with asyncio.timeout(LIMIT_S):
            items = await asyncio.gather(*(channel.put(b"%d" % at) for at, channel in enumerate(channels)))
        assert len(rt._session.put_streams._streams) == 1
        assert [await channel.newest() for channel in channels] == items


async def full_channel(rt: aio.Connection, name: str, on_full: Literal["block"] | None = None) -> aio.Channel:
    channel = await rt.channel(name, max_items=1, max_age="1h", on_full=on_full)
    await channel.put(b"first")
    return channel


async def test_an_asyncio_put_that_waits_for_room_delays_no_other_channel(cluster: LocalCluster) -> None:
    async with await aio.connect(cluster.address) as rt:
        full, other = await full_channel(rt, "shared/full", on_full="block"), await rt.channel("shared/other")
        waiting = asyncio.ensure_future(full.put(b"second"))
        async with asyncio.timeout(LIMIT_S):
            await until_a_put_waits(full)
            await other.put(b"passes")
            assert not waiting.done()
            await full.configure(max_items=2)
            assert (await waiting).payload == b"second"


async def test_a_put_waits_for_room_if_another_program_has_set_block(cluster: LocalCluster) -> None:
    """The handle does not know the new policy. Its put first asks for no wait, is refused, and then asks for a wait."""
    async with await aio.connect(cluster.address) as rt, await aio.connect(cluster.address) as elsewhere:
        channel = await full_channel(rt, "shared/changed")
        await (await elsewhere.channel("shared/changed")).configure(on_full="block")
        waiting, other = asyncio.ensure_future(channel.put(b"second")), await rt.channel("shared/unchanged")
        async with asyncio.timeout(LIMIT_S):
            await until_a_put_waits(channel)
            await other.put(b"passes")
            await (await elsewhere.channel("shared/changed")).configure(max_items=2)
            assert (await waiting).payload == b"second"


async def test_a_refused_put_and_a_cancelled_put_do_not_end_the_shared_stream(cluster: LocalCluster) -> None:
    async with await aio.connect(cluster.address) as rt:
        strict = await rt.channel("shared/strict")
        others = [await rt.channel(f"shared/beside/{number}") for number in range(10)]
        for channel in (strict, *others):
            await channel.stats()  # so that the puts need no lookup
        await others[0].put(b"opens the stream")
        (stream,) = rt._session.put_streams._streams.values()
        answers = answers_held_back(stream.exchange)
        puts = [asyncio.ensure_future(other.put(b"x")) for other in others]
        refused, cancelled = (
            asyncio.ensure_future(strict.put(b"x", time=2**62)),
            asyncio.ensure_future(strict.put(b"y")),
        )
        await until(lambda: len(stream.exchange._waiting) == len(puts) + 2)  # all are under way on one stream
        cancelled.cancel()
        answers.set()
        async with asyncio.timeout(LIMIT_S):
            await asyncio.gather(*puts)
            with pytest.raises(st.InFuture):
                await refused
            assert (await others[0].put(b"later")).payload == b"later"
        assert [*rt._session.put_streams._streams.values()] == [stream]
        assert not stream.exchange.broken


def answers_held_back(exchange: Any) -> asyncio.Event:
    """Keep the answers on a client's stream of puts back until the test sets the event. The puts stay under way."""
    released, receive = asyncio.Event(), exchange._receive

    async def receive_later(response: Any) -> None:
        await released.wait()
        await receive(response)

    exchange._receive = receive_later
    return released


async def until_a_put_waits(channel: aio.Channel) -> None:
    while not (await channel.stats()).waiting_puts:
        await pause()
