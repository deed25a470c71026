"""Forked children: every entry point refuses an inherited connection immediately. A child can connect only if its
parent never connected.
"""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Awaitable, Callable
from typing import Any

import pytest

import stampede_rt as st
from stampede_rt import aio
from stampede_rt_local.cluster import LocalCluster
from tests.support.forking.forked_children import in_a_forked_child
from tests.support.sharing.shared_cluster import shared_cluster_fixture

cluster = shared_cluster_fixture(hosts=1)
LIMIT_S = 40


def error_of(call: Callable[[], Any]) -> str:
    """The class of the error that a call raises."""
    try:
        call()
    except BaseException as error:  # noqa: BLE001
        return type(error).__name__
    return "nothing"


def immediate_error_of(call: Callable[[], Awaitable[Any]]) -> str:
    """The class of the error that an awaited call raises before it waits for anything."""

    def step() -> None:
        call().__await__().send(None)

    return error_of(step)


def entry_points(rt: Any, made: dict[str, Any]) -> dict[str, Callable[[], Any]]:
    """The calls that use an inherited connection, by name. The blocking and the awaited client have the same names."""
    camera, group, queue = made["camera"], made["group"], made["queue"]
    return {
        "connection.channel": lambda: rt.channel("forks/other"),
        "connection.group": lambda: rt.group("forks/group"),
        "connection.queue": lambda: rt.queue("forks/queue"),
        "connection.channels": rt.channels,
        "connection.peers": rt.peers,
        "connection.peer": lambda: rt.peer("forks-parent"),
        "connection.send": lambda: rt.send("forks-parent", b"x"),
        "connection.mailbox_stats": lambda: rt.mailbox_stats("forks-parent"),
        "connection.cross_section": lambda: rt.cross_section(camera, [camera]),
        "channel.put": lambda: camera.put(b"x"),
        "channel.get": lambda: camera.get(st.OLDEST, st.NOW),
        "channel.newest": camera.newest,
        "channel.advance": lambda: camera.advance(0),
        "channel.stats": camera.stats,
        "channel.configure": lambda: camera.configure(max_items=5),
        "channel.consume": lambda: camera.consume([]),
        "channel.delete": camera.delete,
        "channel.producer.put": lambda: camera.producer().put(b"x"),
        "producer.put": lambda: made["producer"].put(b"x"),
        "producer.flush": made["producer"].flush,
        "listener.join": lambda: made["listener"].join(1),
        "sampler.join": lambda: made["sampler"].join(1),
        "group.get": lambda: group.get(st.OLDEST, st.NOW),
        "group.newest": group.newest,
        "group.status": group.status,
        "group.refresh": group.refresh,
        "group.delete": group.delete,
        "descriptor.newest": group[camera].newest,
        "queue.put": lambda: queue.put(b"x"),
        "queue.get": lambda: queue.get(timeout=0),
        "queue.stats": queue.stats,
        "queue.delete": queue.delete,
        "mailbox.get": lambda: rt.mailbox.get(timeout=0),
        "message.ack": made["message"].ack,
    }


def test_each_call_in_a_forked_child_fails_immediately_and_the_parent_continues(cluster: LocalCluster) -> None:
    taken = threading.Event()
    with st.connect(cluster.address, name="forks-parent") as rt:
        camera = rt.channel("forks/camera", max_age="100s")
        first = camera.put(b"before")
        group = rt.group("forks/group", [camera])
        queue = rt.queue("forks/queue")
        queue.put(b"work")
        producer = camera.producer()
        producer.put(b"by the producer")
        producer.flush()
        subscription, cuts, matches = camera.subscribe(first.time), group.subscribe(), group.match(camera, "1ms")
        watch, peers = rt.watch(), rt.watch_peers()
        listener = camera.on_item(lambda _: taken.set())
        sampler = camera.sample(lambda: None)
        made = {"camera": camera, "group": group, "queue": queue, "producer": producer, "listener": listener}
        made |= {"sampler": sampler, "message": queue.get()}
        streams = {"subscription": subscription, "cuts": cuts, "matches": matches, "watch": watch, "peers": peers}
        new: dict[str, Callable[[], Any]] = {
            "subscribe": camera.subscribe, "on_item": lambda: camera.on_item(print),
            "sample": lambda: camera.sample(lambda: None), "group.subscribe": group.subscribe,
            "match": lambda: group.match(camera, "1ms"), "watch": rt.watch, "watch_peers": rt.watch_peers,
            "connect": lambda: st.connect(cluster.address),
        }  # fmt: skip

        def in_child() -> dict[str, str]:
            steps = {f"{name}.next": lambda one=one: next(one) for name, one in streams.items()}
            errors = {name: error_of(call) for name, call in (entry_points(rt, made) | new | steps).items()}
            for harmless in (*(one.close for one in streams.values()), listener.cancel, sampler.cancel, rt.close):
                harmless()
            return errors

        errors = in_a_forked_child(in_child)
        assert {name: error for name, error in errors.items() if error != "ForkedProcess"} == {}

        after = camera.put(b"after")
        producer.put(b"by the producer, after")
        producer.flush()
        assert taken.wait(LIMIT_S)
        assert [next(subscription).payload for _ in range(3)] == [b"before", b"by the producer", b"after"]
        assert [item.payload for item in camera.get(after.time, st.NOW, match="start")][-1] == b"by the producer, after"
        assert (producer.accepted, producer.rejections) == (2, 0)
        assert rt.peer("forks-parent").alive


async def test_each_call_in_a_forked_child_of_an_asyncio_program_fails_immediately(cluster: LocalCluster) -> None:
    async with aio.connect(cluster.address, name="forks-aio") as rt:
        camera = await rt.channel("forks/aio", max_age="100s")
        first = await camera.put(b"before")
        group = await rt.group("forks/aio-group", [camera])
        queue = await rt.queue("forks/aio-queue")
        await queue.put(b"work")
        producer = camera.producer()
        listener = await camera.on_item(lambda _: None)
        sampler = await camera.sample(lambda: None)
        made = {"camera": camera, "group": group, "queue": queue, "producer": producer, "listener": listener}
        made |= {"sampler": sampler, "message": await queue.get()}
        async with camera.subscribe(first.time) as subscription:
            streams = {
                "subscription": subscription, "cuts": group.subscribe(), "matches": group.match(camera, "1ms"),
                "watch": rt.watch(), "peers": rt.watch_peers(),
            }  # fmt: skip
            new: dict[str, Callable[[], Any]] = {
                "on_item": lambda: camera.on_item(print), "sample": lambda: camera.sample(lambda: None),
            }  # fmt: skip

            def in_child() -> dict[str, str]:
                steps = {f"{name}.next": one.__anext__ for name, one in streams.items()}
                steps |= {f"{name}.enter": one.__aenter__ for name, one in streams.items()}
                steps |= {"connect": lambda: aio.connect(cluster.address).__aenter__()}
                errors = {name: immediate_error_of(call) for name, call in (entry_points(rt, made) | steps).items()}
                errors |= {name: error_of(call) for name, call in new.items()}
                for one in streams.values():
                    one.close()
                errors["aclose"] = immediate_error_of(rt.aclose)
                return errors

            errors = in_a_forked_child(in_child)
            assert errors.pop("aclose") == "StopIteration", "`aclose` ends without waiting for anything"
            assert {name: error for name, error in errors.items() if error != "ForkedProcess"} == {}
            after = await camera.put(b"after")
            assert [(await anext(subscription)).payload for _ in range(2)] == [b"before", b"after"]
            assert after.seq == first.seq + 1


IN_CHILDREN = """
import asyncio, multiprocessing, os, sys
import stampede_rt as st
from stampede_rt import aio

async def use_aio():
    async with aio.connect() as rt:
        channel = await rt.channel("forks/child", max_age="100s")
        await channel.put(b"by a child")

def use():
    with st.connect() as rt:
        rt.channel("forks/child", max_age="100s").put(b"by a child")

def connect():
    try:
        asyncio.run(use_aio()) if sys.argv[2] == "aio" else use()
    except st.ForkedProcess as error:
        os._exit(7 if "spawn" in str(error) else 8)

def nothing():
    multiprocessing.Event().wait(0.3)

def fork(function):
    children = [multiprocessing.get_context("fork").Process(target=function) for _ in range(12)]
    for child in children:
        child.start()
    for child in children:
        child.join(20)
    print(*{child.exitcode for child in children}, flush=True)

async def fork_with_a_subscription():
    async with aio.connect() as rt:
        channel = await rt.channel("forks/child", max_age="100s")
        async with channel.subscribe() as items:
            await channel.put(b"to the parent")
            await anext(items)
            fork(nothing)

if __name__ == "__main__":
    if sys.argv[1] == "asyncio":
        asyncio.run(fork_with_a_subscription())
    else:
        if sys.argv[1] == "connected before":
            use()
        fork(connect)
        use()
"""


def exit_statuses(cluster: LocalCluster, *arguments: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", IN_CHILDREN, *arguments],
        env=os.environ | {"STAMPEDE_URL": cluster.address, "STAMPEDE_SECRET_FILE": str(cluster.secret_file)},
        capture_output=True, text=True, timeout=LIMIT_S, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


@pytest.mark.parametrize("client", ["sync", "aio"])
def test_forked_children_connect_if_their_parent_never_connected(cluster: LocalCluster, client: str) -> None:
    assert exit_statuses(cluster, "never connected", client) == "0"


@pytest.mark.parametrize("client", ["sync", "aio"])
def test_forked_children_of_a_connected_parent_get_the_error_that_they_cannot_connect(
    cluster: LocalCluster, client: str
) -> None:
    assert exit_statuses(cluster, "connected before", client) == "7"


def test_forked_children_that_do_not_use_the_client_survive_the_fork_of_an_asyncio_program(
    cluster: LocalCluster,
) -> None:
    assert exit_statuses(cluster, "asyncio", "nothing") == "0"
