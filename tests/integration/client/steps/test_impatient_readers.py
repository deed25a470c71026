"""With asyncio a reader may cancel each step long before its stream is open, for example with a short timeout."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from typing import Any

import pytest

import stampede_rt as st
from stampede_rt import aio
from stampede_rt_local.cluster import LocalCluster
from tests.support.sharing.shared_cluster import shared_cluster_fixture
from tests.support.waiting import until

cluster = shared_cluster_fixture(hosts=1)
LIMIT_S = 10.0


async def impatiently(steps: AsyncIterator[Any]) -> Any:
    """Return the next result of an iterator, for a caller who cancels each step after one turn of the event loop."""
    async with asyncio.timeout(LIMIT_S):
        while True:
            step = asyncio.ensure_future(anext(steps))
            await asyncio.sleep(0)
            step.cancel()
            await asyncio.wait([step])
            if not step.cancelled():
                return step.result()


@pytest.mark.parametrize("transport", ["grpc", "socket"])
async def test_an_impatient_reader_gets_each_item_once_and_in_order(cluster: LocalCluster, transport: str) -> None:
    async with aio.connect(cluster.address, transport=transport) as rt:
        channel = await rt.channel(f"impatient/{transport}", max_age="60s")
        put = [(await channel.put(b"%d" % number)).seq for number in range(20)]
        with_items = channel.subscribe(start=st.OLDEST)
        assert [(await impatiently(with_items)).seq for _ in put] == put
        later = await channel.put(b"later")
        assert (await impatiently(with_items)).seq == later.seq
        with_items.close()
        async with asyncio.timeout(LIMIT_S):
            assert [item async for item in with_items] == []


@pytest.mark.parametrize("transport", ["grpc", "socket", "shared"])
async def test_an_impatient_reader_of_batches_gets_each_item_once_and_in_order(
    cluster: LocalCluster, transport: str
) -> None:
    async with aio.connect(cluster.address, transport=transport) as rt:
        channel = await rt.channel(f"impatient/batches/{transport}", max_age="60s")
        put = [(await channel.put(b"%d" % number)).seq for number in range(20)]
        subscription = channel.subscribe(start=st.OLDEST)
        batches, seqs = subscription.batches(), list[int]()
        while len(seqs) < len(put):
            seqs += (await impatiently(batches)).seqs
        assert seqs == put
        later = await channel.put(b"later")
        assert [*(await impatiently(batches)).seqs] == [later.seq]
        subscription.close()
        async with asyncio.timeout(LIMIT_S):
            assert [batch async for batch in batches] == []


async def test_an_impatient_reader_gets_cut_events_and_matches(cluster: LocalCluster) -> None:
    async with aio.connect(cluster.address) as rt:
        left, right = [await rt.channel(f"impatient/{side}", max_age="60s") for side in ("left", "right")]
        group = await rt.group("impatient/pair", [left, right])
        matches = group.match(per=left, tolerance="10ms", start=st.OLDEST)
        cuts = group.subscribe()
        async with cuts:
            time = (await left.put(b"left")).time
            await right.put(b"right", time=time)
            await asyncio.gather(left.advance(time + 20_000_000), right.advance(time + 20_000_000))
            assert (await impatiently(cuts))[left][0].payload == b"left"
        assert (await impatiently(matches))[right].payload == b"right"
        matches.close()


async def test_an_impatient_watch_sees_a_new_channel(cluster: LocalCluster) -> None:
    async with aio.connect(cluster.address) as rt:
        watch = rt.watch("impatient/watched")
        seen = asyncio.ensure_future(impatiently(watch))
        await until(lambda: watch.connected, "the watch is open")
        await rt.channel("impatient/watched")
        assert (await seen).subject.name == "impatient/watched"
        watch.close()
