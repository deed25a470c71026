"""If a connection is closed, all its waiting calls raise the same error."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from typing import Any

import pytest

import stampede_rt as st
from stampede_rt import aio
from stampede_rt_local.cluster import LocalCluster
from tests.support.sharing.shared_cluster import shared_cluster_fixture

cluster = shared_cluster_fixture(hosts=1)
LIMIT_S = 20.0
SECOND = 10**9
SENTENCE = "this connection is closed; call connect() again"
CALLS = ("take", "messages", "items", "cuts", "matches", "newest", "complete", "peers")


def test_every_waiting_thread_gets_an_error_when_the_connection_is_closed(cluster: LocalCluster) -> None:
    rt = st.connect(cluster.address)
    channel, queue = rt.channel("closing/sync", max_age="60s"), rt.queue("closing/sync")
    group = rt.group("closing/sync", [channel])
    waits: dict[str, Callable[[], Any]] = {
        "take": queue.get,
        "messages": lambda: next(iter(rt.queue("closing/sync"))),
        "items": lambda: next(iter(channel.subscribe())),
        "cuts": lambda: next(iter(group.subscribe())),
        "matches": lambda: next(iter(group.match(channel, "1ms"))),
        "newest": lambda: channel.newest(after=st.now(), timeout=LIMIT_S),
        "complete": lambda: channel.get(st.now(), st.now() + 60 * SECOND, complete=True, timeout=LIMIT_S),
        "peers": lambda: next(iter(rt.watch_peers())),
    }
    errors: dict[str, str] = {}

    def wait(name: str) -> None:
        try:
            errors[name] = f"returned {waits[name]()!r}"
        except Exception as error:  # noqa: BLE001  # the test compares it
            errors[name] = f"{type(error).__name__}: {error}"

    threads = [threading.Thread(target=wait, args=(name,), daemon=True) for name in CALLS]
    for thread in threads:
        thread.start()
    with st.connect(cluster.address) as other:
        while (
            other.channel("closing/sync").stats().waiting_gets < 2
            or other.queue("closing/sync").stats().waiting_gets < 2
        ):
            assert not errors
    rt.close()
    for thread in threads:
        thread.join(LIMIT_S)
    assert errors == dict.fromkeys(CALLS, f"Unavailable: {SENTENCE}")


async def test_every_waiting_task_gets_an_error_when_the_connection_is_closed(cluster: LocalCluster) -> None:
    rt = await aio.connect(cluster.address)
    channel, queue = await rt.channel("closing/aio", max_age="60s"), await rt.queue("closing/aio")
    group = await rt.group("closing/aio", [channel])
    waits: dict[str, Any] = {
        "take": queue.get(),
        "messages": anext(await rt.queue("closing/aio")),
        "items": anext(aiter(channel.subscribe())),
        "cuts": anext(aiter(group.subscribe())),
        "matches": anext(aiter(group.match(channel, "1ms"))),
        "newest": channel.newest(after=st.now(), timeout=LIMIT_S),
        "complete": channel.get(st.now(), st.now() + 60 * SECOND, complete=True, timeout=LIMIT_S),
        "peers": anext(aiter(rt.watch_peers())),
    }
    tasks = {name: asyncio.ensure_future(waits[name]) for name in CALLS}
    async with await aio.connect(cluster.address) as other:
        far, far_queue = await other.channel("closing/aio"), await other.queue("closing/aio")
        while (await far.stats()).waiting_gets < 2 or (await far_queue.stats()).waiting_gets < 2:
            assert not any(task.done() for task in tasks.values())
    await rt.aclose()
    async with asyncio.timeout(LIMIT_S):
        outcomes = await asyncio.gather(*tasks.values(), return_exceptions=True)
    errors = {name: f"{type(one).__name__}: {one}" for name, one in zip(CALLS, outcomes, strict=True)}
    assert errors == dict.fromkeys(CALLS, f"Unavailable: {SENTENCE}")


@pytest.mark.parametrize("kind", ["items", "cuts", "matches", "peers"])
async def test_a_stream_that_is_closed_while_it_opens_ends(cluster: LocalCluster, kind: str) -> None:
    async with aio.connect(cluster.address, transport="grpc") as rt:
        channel = await rt.channel("closing/opening", max_age="60s")
        group = await rt.group("closing/opening", [channel])
        made: dict[str, Callable[[], Any]] = {
            "items": channel.subscribe,
            "cuts": group.subscribe,
            "matches": lambda: group.match(channel, "1ms"),
            "peers": rt.watch_peers,
        }
        async with asyncio.timeout(LIMIT_S):
            for turns in range(40):
                stream = made[kind]()
                step = asyncio.ensure_future(anext(stream, None))
                for _ in range(turns):
                    await asyncio.sleep(0)  # gives other tasks one turn
                stream.close()
                assert await step is None
