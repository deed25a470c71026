"""The kinds of cycles: each opens something at a real cluster, uses it, and closes it again."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Any

import stampede_rt as st
from stampede_rt import aio
from stampede_rt_local.cluster import LocalCluster
from tests.integration.proxies.readers import eventually

Cycle = Callable[[], None]
_numbers = itertools.count()
PROXIES_PER_CYCLE = 50  # a host learns of removed copies only every 2 s, so a cycle waits once for many proxies


def subscribing(transport: Any) -> Callable[[LocalCluster], AbstractContextManager[Cycle]]:
    """Subscribe, read one item, and unsubscribe."""

    @contextmanager
    def kind(cluster: LocalCluster) -> Iterator[Cycle]:
        with st.connect(cluster.address, transport=transport) as rt:
            channel = filled(rt)

            def cycle() -> None:
                with channel.subscribe(st.OLDEST) as items:
                    assert next(items).payload == b"an item"

            yield cycle

    return kind


def filled(rt: Any) -> Any:
    channel = rt.channel(f"cycles/{next(_numbers)}", host="h1")
    channel.put(b"an item")
    return channel


def awaiting(transport: Any) -> Callable[[LocalCluster], AbstractContextManager[Cycle]]:
    """Subscribe, read one item, and unsubscribe, with the awaited client."""

    @contextmanager
    def kind(cluster: LocalCluster) -> Iterator[Cycle]:
        with asyncio.Runner() as runner, st.connect(cluster.address) as blocking:
            name = filled(blocking).name
            rt = runner.run(_connected(cluster.address, transport))
            channel = runner.run(rt.channel(name))

            async def cycle() -> None:
                async with channel.subscribe(st.OLDEST) as items:
                    assert (await anext(items)).payload == b"an item"

            yield lambda: runner.run(cycle())
            runner.run(rt.aclose())

    return kind


async def _connected(address: str, transport: Any) -> Any:
    return await aio.connect(address, transport=transport)


@contextmanager
def connecting(cluster: LocalCluster) -> Iterator[Cycle]:
    """Connect, put and read an item, and close the connection."""
    with st.connect(cluster.address) as other:
        name = other.channel(f"cycles/{next(_numbers)}", host="h1", max_items=10).name

        def cycle() -> None:
            with st.connect(cluster.address) as rt:
                channel: Any = rt.channel(name)
                channel.put(b"an item")
                assert channel.newest().payload == b"an item"

        yield cycle


@contextmanager
def awaited_connecting(cluster: LocalCluster) -> Iterator[Cycle]:
    """Connect, put and read an item, and close the connection, with the awaited client."""
    with asyncio.Runner() as runner, st.connect(cluster.address) as other:
        name = other.channel(f"cycles/{next(_numbers)}", host="h1", max_items=10).name

        async def cycle() -> None:
            async with aio.connect(cluster.address, transport="grpc") as rt:
                channel: Any = await rt.channel(name)
                await channel.put(b"an item")
                assert (await channel.newest()).payload == b"an item"

        yield lambda: runner.run(cycle())


@contextmanager
def opening(cluster: LocalCluster) -> Iterator[Cycle]:
    """Make a channel and a queue, put an item and a message, and delete both."""
    with st.connect(cluster.address) as rt:

        def cycle() -> None:
            name = f"cycles/opened/{next(_numbers)}"
            channel, queue = rt.channel(name, host="h1"), rt.queue(name, host="h1")
            channel.put(b"an item")
            queue.put(b"a message")
            channel.delete()
            queue.delete()

        yield cycle


@contextmanager
def proxying(cluster: LocalCluster) -> Iterator[Cycle]:
    """Add and remove a proxy of each of 50 channels, and wait until all have ended."""
    with st.connect(cluster.address, transport="grpc") as rt:
        channels = [filled(rt) for _ in range(PROXIES_PER_CYCLE)]
        names = {channel.name for channel in channels}

        def cycle() -> None:
            for channel in channels:
                assert rt.proxy(channel, "h2").held == 1
                rt.remove_proxy(channel, "h2")
            eventually(lambda: names.isdisjoint(rt.hosted_channels("h2")), "the proxies have ended")

        yield cycle


KINDS: dict[str, Callable[[LocalCluster], AbstractContextManager[Cycle]]] = {
    "subscribe, gRPC": subscribing("grpc"),
    "subscribe, sockets": subscribing("socket"),
    "subscribe, shared memory": subscribing("shared"),
    "subscribe, await, sockets": awaiting("socket"),
    "subscribe, await, gRPC": awaiting("grpc"),
    "connect": connecting,
    "connect, await": awaited_connecting,
    "make channel and queue": opening,
    "add proxy": proxying,
}
OPENED_PER_CYCLE = {"add proxy": PROXIES_PER_CYCLE}
"""The number of things that one cycle opens and closes, if it is more than one."""
