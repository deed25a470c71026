"""Streams that are reset with INTERNAL_ERROR on the wire while their connection lives, between real processes."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import grpc
import pytest

import stampede_rt as st
from stampede_rt import aio
from stampede_rt.status import from_rpc_error
from stampede_rt.v1 import channel_service_pb2_grpc
from stampede_rt_local.ports import free_ports
from stampede_rt_local.process import ServiceProcess
from stampede_rt_runtime.auth import Secret
from stampede_rt_runtime.dial import dial
from tests.support.awaitable_blocking import AwaitableBlocking
from tests.support.cluster import running_cluster
from tests.support.resetting_relay import ResettingRelay

READY_S = 30.0
ROUNDS = 20


@dataclass(frozen=True)
class World:
    """A host that clients reach through the relay."""

    address: str
    host: str
    relay: ResettingRelay
    secret: Secret

    async def reset(self) -> None:
        """Wait for a stream, and then reset all streams."""
        await asyncio.to_thread(self.relay.wait_for_a_stream)
        await asyncio.to_thread(self.relay.reset)


@pytest.fixture(scope="module")
def world() -> Iterator[World]:
    with running_cluster(hosts=0, supernodes=1) as cluster:
        port, inner_port = free_ports(2)
        words = ["--listen", f"localhost:{inner_port}", "--advertise", f"localhost:{port}", "--name", "relayed"]
        words += ["--frontend", cluster.address, "--secret-file", str(cluster.secret_file)]
        host = ServiceProcess("relayed host", "stampede_rt_channel_host", words)
        with ResettingRelay(port, inner_port) as relay:
            host.start()
            try:
                host.wait_ready(READY_S)
                yield World(cluster.address, f"localhost:{port}", relay, cluster.secret)
            finally:
                host.stop()


@pytest.fixture(params=["aio", "sync"])
async def rt(request: pytest.FixtureRequest, world: World) -> AsyncIterator[Any]:
    if request.param == "aio":
        async with aio.connect(world.address, transport="grpc") as made:
            yield made
        return
    with ThreadPoolExecutor(8) as pool:
        made = await asyncio.to_thread(lambda: st.connect(world.address, transport="grpc"))
        awaitable = AwaitableBlocking(made, pool)
        yield awaitable
        await awaitable.aclose()


async def opened(rt: Any, made: Any) -> Any:
    """A producer or subscription of either client, with methods that are awaited."""
    if not isinstance(rt, AwaitableBlocking):
        return made
    found = await made
    return found if isinstance(found, AwaitableBlocking) else AwaitableBlocking(found, rt._pool)


async def test_a_reset_stream_is_internal_for_grpc_and_unavailable_for_the_client(world: World) -> None:
    """Users met the fault in this form. The other tests of this file cause it, too."""
    async with dial(world.host, secret=world.secret) as channel:
        call = channel_service_pb2_grpc.ChannelServiceStub(channel).Get()
        reading = asyncio.ensure_future(call.read())
        await call.wait_for_connection()
        await world.reset()
        with pytest.raises(grpc.RpcError) as caught:
            await reading
        assert caught.value.code() is grpc.StatusCode.INTERNAL
        error = from_rpc_error(caught.value, world.host)
        assert (type(error), error.retryable) == (st.Unavailable, True)


async def test_puts_and_gets_continue_after_resets(world: World, rt: Any) -> None:
    channel = await rt.channel(f"reset/put-{st.now()}", max_age="60s")
    for number in range(ROUNDS):
        await channel.put(b"%d" % number)
        await world.reset()
        assert (await channel.newest()).payload == b"%d" % number
        await world.reset()
    held = await channel.get(st.OLDEST, st.NEWEST)
    assert [item.payload for item in held] == [b"%d" % number for number in range(ROUNDS)]


async def test_a_producer_has_no_gap_and_no_duplicate_after_resets(world: World, rt: Any) -> None:
    channel = await rt.channel(f"reset/producer-{st.now()}", max_age="60s")
    producer = await opened(rt, channel.producer())
    before = world.relay.resets
    for number in range(ROUNDS):
        await producer.put(b"%d" % number)
        await asyncio.to_thread(world.relay.reset)  # the producer may have no stream just then
    await producer.flush(30)
    assert (producer.accepted, producer.rejections) == (ROUNDS, 0)
    assert world.relay.resets > before
    held = await channel.get(st.OLDEST, st.NEWEST)
    assert [item.payload for item in held] == [b"%d" % number for number in range(ROUNDS)]
    await producer.aclose()


async def test_a_subscription_has_no_gap_and_no_duplicate_after_resets(world: World, rt: Any) -> None:
    channel = await rt.channel(f"reset/read-{st.now()}", max_age="60s")
    async with await opened(rt, channel.subscribe()) as subscription:
        for number in range(ROUNDS):
            await channel.put(b"%d" % number)
            assert (await anext(subscription)).payload == b"%d" % number
            await world.reset()
        assert subscription.dropped == 0


async def test_a_queue_has_no_gap_and_no_duplicate_after_resets(world: World, rt: Any) -> None:
    queue = await rt.queue(f"reset/work-{st.now()}", lease="60s")
    for number in range(ROUNDS):
        await queue.put(b"%d" % number)
        await world.reset()
        message = await queue.get(timeout=20)
        assert message.payload == b"%d" % number
        await message.ack()
        await world.reset()
    stats = await queue.stats()
    assert (stats.accepted, stats.held) == (ROUNDS, 0)
