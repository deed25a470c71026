"""Attacks by a client that takes as much as it gets of one quota."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import grpc

import stampede_rt as st
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.v1 import raw_run_pb2, time_pb2
from stampede_rt.v1.channel_service_pb2_grpc import ChannelServiceStub
from stampede_rt.wire.runs import encode_run
from tests.benchmarks.attacks.attacked_cluster import GOOD_CHANNEL, AttackedCluster, all_of, for_ever
from tests.benchmarks.attacks.memory import MIB, NAME, stub

CONNECTIONS, STREAMS_OF_ONE = 5, 1000
GET_STREAMS, GETS_OF_ONE = 30, 1000
PUT_STREAMS, PUTS_PER_REQUEST = 64, 16
CALLERS = 64
FAR_NANOS = 3600 * 10**9


async def many_streams(attacked: AttackedCluster, on_begun: Callable[[], None]) -> None:
    """5000 streams of puts, on which nothing is put."""
    calls: list[Any] = []
    for _ in range(CONNECTIONS):
        one = ChannelServiceStub(attacked.channel(attacked.target))
        calls += [one.Put(metadata=attacked.metadata) for _ in range(STREAMS_OF_ONE)]
    await all_of(*(call.wait_for_connection() for call in calls))
    on_begun()
    await for_ever()


async def blocked_gets(attacked: AttackedCluster, on_begun: Callable[[], None]) -> None:
    """30,000 gets wait for an item of the good clients' channel an hour ahead. Refused gets are sent again."""
    known = await attacked.bound(GOOD_CHANNEL)
    start = time_pb2.Bound(instant_unix_nano=st.now() + FAR_NANOS)
    request = pb.GetRequest(
        interval=time_pb2.Interval(start=start, end=time_pb2.Bound(instant_unix_nano=2**63 - 1)), wait_nanos=-1, **known
    )
    calls: list[Any] = [stub(attacked, ChannelServiceStub).Get(metadata=attacked.metadata) for _ in range(GET_STREAMS)]
    working = [asyncio.ensure_future(_block(call, request)) for call in calls]
    on_begun()
    await all_of(*working)


async def _block(call: Any, request: pb.GetRequest) -> None:
    for call_id in range(1, GETS_OF_ONE + 1):
        request.call_id = call_id
        await call.write(request)
    while (refused := await call.read()) is not grpc.aio.EOF:
        request.call_id = refused.call_id
        await call.write(request)


async def busy_puts(attacked: AttackedCluster, on_begun: Callable[[], None]) -> None:
    """64 streams put 16 items of 100 bytes at a time, and wait only for the acks."""
    async with attacked.connect() as rt:
        await rt.channel(NAME, max_items=1000)
        known = await attacked.bound(NAME)
        on_begun()
        await all_of(*(_put_again_and_again(attacked, known) for _ in range(PUT_STREAMS)))


async def _put_again_and_again(attacked: AttackedCluster, known: dict[str, Any]) -> None:
    method = attacked.channel(attacked.host).stream_stream("/stampede_rt.v1.ChannelService/Put")
    call: Any = method(metadata=attacked.metadata)
    put = raw_run_pb2.RawPutRun(run=encode_run([b"x" * 100], times=None))
    request = raw_run_pb2.RawPutRequest(**known, puts=[put] * PUTS_PER_REQUEST).SerializeToString()
    while True:
        await call.write(request)
        acked = 0
        while acked < PUTS_PER_REQUEST:
            acked += len(pb.PutResponse.FromString(await call.read()).acks)


async def single_calls(attacked: AttackedCluster, on_begun: Callable[[], None]) -> None:
    """64 callers ask for a channel's status again after each answer."""
    known = await attacked.bound(GOOD_CHANNEL)
    on_begun()
    await all_of(*(_ask_again_and_again(attacked, known) for _ in range(CALLERS)))


async def _ask_again_and_again(attacked: AttackedCluster, known: dict[str, Any]) -> None:
    ask: Any = ChannelServiceStub(attacked.channel(attacked.target)).GetChannelStatus
    request = pb.GetChannelStatusRequest(channel_id=known["channel_id"])
    for _ in itertools.count():
        with suppress(grpc.aio.AioRpcError):
            await ask(request, metadata=attacked.metadata, timeout=10)


async def held_bytes(attacked: AttackedCluster, on_begun: Callable[[], None]) -> None:
    """Items of 1 MiB, one after the other, into a channel of the attacker that keeps them for an hour."""
    async with attacked.connect() as rt:
        channel = await rt.channel(NAME, max_age="1h", max_bytes=2**40)
        on_begun()
        while True:
            with suppress(st.StampedeError):
                await channel.put(bytes(MIB), timeout=1.0)


async def archived_bytes(attacked: AttackedCluster, on_begun: Callable[[], None]) -> None:
    """Items of 1 MiB, one after the other, into a channel of the attacker's that is recorded for ever."""
    async with attacked.connect() as rt:
        channel = await rt.channel(NAME, max_items=2, archive="forever")
        on_begun()
        while True:
            with suppress(st.StampedeError):
                await channel.put(bytes(MIB), timeout=1.0)
