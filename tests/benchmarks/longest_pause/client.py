"""The client in a separate process, and its calls to the host."""

from __future__ import annotations

import asyncio
import sys

import grpc

from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.v1 import time_pb2
from stampede_rt.v1.channel_service_pb2_grpc import ChannelServiceStub
from tests.benchmarks.longest_pause.sizes import (
    FOLLOWED_ITEMS,
    READ_ITEMS,
    SUBSCRIBERS,
)
from tests.benchmarks.longest_pause.watch import PATIENCE_SECONDS, Work
from tests.support.channel_host.rig import MAX_INSTANT, MIN_INSTANT, OpenedChannel, Rig, between


def client_process(rig: Rig, channel: OpenedChannel, verb: str) -> Work:
    """A client in a process of its own."""

    async def work() -> None:
        words = [rig.target, verb, channel.channel_id.hex(), str(channel.epoch)]
        client = await asyncio.create_subprocess_exec(
            sys.executable, "-m", "tests.benchmarks.longest_pause", "--client", *words
        )
        async with asyncio.timeout(PATIENCE_SECONDS):
            assert await client.wait() == 0, "the client failed"

    return work


def ask(target: str, verb: str, channel_id: str, epoch: str) -> None:
    """Call the host as a client does: one get, or the first items of a subscription."""
    with grpc.insecure_channel(target, options=[("grpc.max_receive_message_length", -1)]) as connection:
        stub = ChannelServiceStub(connection)
        about = {"channel_id": bytes.fromhex(channel_id), "epoch": int(epoch)}
        oldest = time_pb2.Bound(instant_unix_nano=MIN_INSTANT)
        if verb == "get":
            interval = between(MIN_INSTANT, MAX_INSTANT)
            get = pb.GetRequest(call_id=1, interval=interval, without_payloads=True, **about)  # type: ignore[arg-type]
            assert [*stub.Get(iter((get,)))][-1].HasField("summary")
            return
        if verb == "follow":
            asyncio.run(follow(target, pb.SubscribeOpen(**about)))  # type: ignore[arg-type]
            return
        opening = pb.SubscribeOpen(start=oldest, **about)  # type: ignore[arg-type]
        items = 0
        for response in stub.Subscribe(iter((pb.SubscribeRequest(open=opening, credit_bytes=2**60),))):
            items += sum(len(one.run.payload_length_bytes) for one in response.runs)
            if items >= READ_ITEMS:
                return


async def follow(target: str, opening: pb.SubscribeOpen) -> None:
    """Many subscriptions, each of which takes a few items."""

    async def one(connection: grpc.aio.Channel) -> None:
        items = 0
        call = ChannelServiceStub(connection).Subscribe(iter((pb.SubscribeRequest(open=opening, credit_bytes=2**60),)))
        async for response in call:
            items += sum(len(one.run.payload_length_bytes) for one in response.runs)
            if items >= FOLLOWED_ITEMS:
                return

    options = [("grpc.use_local_subchannel_pool", 1)]
    connections = [grpc.aio.insecure_channel(target, options=options) for _ in range(20)]
    await asyncio.gather(*(one(connections[at % 20]) for at in range(SUBSCRIBERS)))
    for connection in connections:
        await connection.close()
