"""An awaited connection that a program uses on another event loop: each use raises an error about this immediately."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

import pytest

import stampede_rt as st
from stampede_rt import aio
from stampede_rt_local.cluster import LocalCluster
from tests.support.sharing.shared_cluster import shared_cluster_fixture

cluster = shared_cluster_fixture(hosts=1)

Use = Callable[[Any], Awaitable[Any]]


class LoopHandles:
    """A connection and its handles. The program has used each of them on its own loop."""

    def __init__(self, rt: aio.Connection) -> None:
        self.rt = rt

    async def prepare(self) -> None:
        self.channel = await self.rt.channel("loops/channel", max_age="60s")
        self.queue = await self.rt.queue("loops/queue")
        self.group = await self.rt.group("loops/group", [self.channel])
        await self.channel.put(b"0")
        await self.channel.newest()
        self.subscription = self.channel.subscribe(start=st.OLDEST)
        await anext(self.subscription)


USES: dict[str, Use] = {
    "put": lambda of: of.channel.put(b"1"),
    "newest": lambda of: of.channel.newest(),
    "stats": lambda of: of.channel.stats(),
    "channel": lambda of: of.rt.channel("loops/other"),
    "hosts": lambda of: of.rt.hosts(),
    "send": lambda of: of.rt.send("loops/peer", b"1"),
    "enqueue": lambda of: of.queue.put(b"1"),
    "take": lambda of: of.queue.get(timeout=1),
    "next": lambda of: anext(of.subscription),
    "subscribe": lambda of: anext(of.channel.subscribe()),
    "cuts": lambda of: anext(of.group.subscribe()),
    "watch": lambda of: anext(of.rt.watch()),
}


@pytest.mark.parametrize("use", USES)
async def test_a_call_on_another_event_loop_is_refused_and_has_no_effect(cluster: LocalCluster, use: str) -> None:
    async with aio.connect(cluster.address) as rt:
        things = LoopHandles(rt)
        await things.prepare()

        def elsewhere() -> None:
            async def run() -> None:
                async with asyncio.timeout(20):
                    await USES[use](things)

            with pytest.raises(st.WrongEventLoop, match="connect once on each loop"):
                asyncio.run(run())

        await asyncio.to_thread(elsewhere)
        async with asyncio.timeout(20):
            await things.channel.put(b"2")
            assert (await things.channel.newest()).payload == b"2"
            things.subscription.close()


def watched(things: LoopHandles) -> list[tuple[Any, Callable[[], object]]]:
    """Handles that run in the background or can be iterated, each with the method that ends it."""
    handles = [
        things.subscription,
        things.group.subscribe(),
        things.group.match(things.channel, tolerance="1s"),
        things.rt.watch(),
    ]
    running = [things.channel.on_item(print), things.channel.sample(lambda: None)]
    return [(one, one.close) for one in handles] + [(one, one.cancel) for one in running]


@pytest.mark.parametrize("on_a_loop", [True, False])
async def test_a_call_that_ends_a_handle_is_refused_on_another_thread(cluster: LocalCluster, on_a_loop: bool) -> None:
    async with aio.connect(cluster.address) as rt:
        things = LoopHandles(rt)
        await things.prepare()
        ends = watched(things)

        def elsewhere(end: Callable[[], object]) -> None:
            async def run() -> None:
                end()

            with pytest.raises(st.WrongEventLoop, match="call_soon_threadsafe"):
                asyncio.run(run()) if on_a_loop else end()

        for _, end in ends:
            await asyncio.to_thread(elsewhere, end)
        await things.channel.put(b"2")
        assert (await anext(things.subscription)).payload == b"2", (
            "no call from the other loop has ended the subscription"
        )
        loop = asyncio.get_running_loop()
        for _, end in ends:
            await asyncio.to_thread(loop.call_soon_threadsafe, end)
        with pytest.raises(StopAsyncIteration):
            async with asyncio.timeout(20):
                await anext(things.subscription)


def test_a_handle_can_be_ended_after_its_loop_has_ended(cluster: LocalCluster) -> None:
    async def opened() -> Any:
        rt = await aio.connect(cluster.address)
        channel = await rt.channel("loops/left")
        await channel.put(b"1")
        subscription = channel.subscribe(start=st.OLDEST)
        await anext(subscription)
        return rt, subscription

    with asyncio.Runner() as runner:
        rt, subscription = runner.run(opened())
        subscription.close()  # the loop stands still
        runner.run(rt.aclose())
    subscription.close()
