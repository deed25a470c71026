"""Attacks on a host's memory by clients with the secret."""

from __future__ import annotations

import itertools
import os
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import suppress
from typing import Any

import grpc

import stampede_rt as st
from stampede_rt.transports.grpc_options import ENQUEUE_METHOD, PUT_METHOD
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.v1 import item_pb2, queue_directory_service_pb2, raw_run_pb2, time_pb2
from stampede_rt.v1 import queue_service_pb2 as queue_pb
from stampede_rt.v1.channel_service_pb2_grpc import ChannelServiceStub
from stampede_rt.v1.queue_directory_service_pb2_grpc import QueueDirectoryServiceStub
from stampede_rt.v1.queue_service_pb2_grpc import QueueServiceStub
from stampede_rt.values.timeline import MAX_INSTANT, MIN_INSTANT
from stampede_rt.wire.request_pieces import messages_of
from stampede_rt.wire.runs import encode_run
from tests.benchmarks.attacks.attacked_cluster import NAME_VARIABLE, AttackedCluster, Uploads, all_of, for_ever

MIB = 2**20
NAME = os.environ.get(NAME_VARIABLE, "hostile")
STREAMS, GETS, REFUSED, TWICE = 60, 1280, 800, 150
UNKNOWN_BYTES = 200 * 2**10
WAITING, WAITING_BYTES = 40, 15 * MIB
HELD_ITEMS = 16
ATTRIBUTED_ITEMS = 20_000
HOUR_NANOS = 3600 * 10**9
FIELD_999 = bytes(((999 << 3 | 2) & 127 | 128, (999 << 3 | 2) >> 7))  # bytes of a field that the contract lacks


def stub(attacked: AttackedCluster, kind: Any) -> Any:
    """The stub of the host, over a connection of its own."""
    return kind(attacked.channel(attacked.host))


async def put_all(
    attacked: AttackedCluster, name: str, runs: Sequence[bytes] | Any, *, runs_per_request: int = 1
) -> None:
    """Put runs on one stream, without puts that wait. Ignores refusals."""
    known = await attacked.bound(name)

    async def requests() -> AsyncIterator[bytes]:
        numbered = enumerate(runs, start=1)
        while some := [*itertools.islice(numbered, runs_per_request)]:
            puts = [raw_run_pb2.RawPutRun(first_number=number, wait_nanos=0, run=run) for number, run in some]
            for message in messages_of(raw_run_pb2.RawPutRequest(**known, puts=puts).SerializeToString()):
                yield message

    async with attacked.channel(attacked.target) as channel:
        call = channel.stream_stream("/stampede_rt.v1.ChannelService/Put")
        with suppress(grpc.aio.AioRpcError):
            async for _ in call(requests(), metadata=attacked.metadata):
                pass


async def repeated_fields(attacked: AttackedCluster, on_begun: Callable[[], None]) -> None:
    """150 puts in which the payload field comes twice: first with 4 MiB, and then with the payload that counts."""
    twice = item_pb2.ItemRun(payloads=bytes(4 * MIB)).SerializeToString() + encode_run([b"one"], times=None)
    await _put_and_stay(attacked, itertools.repeat(twice, TWICE), on_begun)


async def attributes(attacked: AttackedCluster, on_begun: Callable[[], None]) -> None:
    """20,000 items of one byte, with the most attributes that an item may have."""
    run = encode_run([b"x"], times=None, attributes={"k": "x" * 16_000})
    await _put_and_stay(attacked, itertools.repeat(run, ATTRIBUTED_ITEMS), on_begun)


async def refused_runs(attacked: AttackedCluster, on_begun: Callable[[], None]) -> None:
    """800 runs of 1 MiB whose payload lengths are wrong."""
    bad = item_pb2.ItemRun(payload_length_bytes=[1], payloads=bytes(MIB)).SerializeToString()
    await _put_and_stay(attacked, itertools.repeat(bad, REFUSED), on_begun)


async def late_clock(attacked: AttackedCluster, on_begun: Callable[[], None]) -> None:
    """800 items of 1 MiB by a producer whose clock is an hour behind."""
    late = encode_run([bytes(MIB)], times=[st.now() - HOUR_NANOS])
    await _put_and_stay(attacked, itertools.repeat(late, REFUSED), on_begun)


async def _put_and_stay(attacked: AttackedCluster, runs: Any, on_begun: Callable[[], None]) -> None:
    async with attacked.connect() as rt:
        await rt.channel(NAME, max_age="10s")
        on_begun()
        await put_all(attacked, NAME, runs)
        await for_ever()


async def waiting_puts(attacked: AttackedCluster, on_begun: Callable[[], None]) -> None:
    """40 puts of 15 MiB into a full channel, each on its own connection. All of them wait without limit."""
    async with attacked.connect() as rt:
        await rt.channel(NAME, max_items=1, consumers=1)
        known = await attacked.bound(NAME)
        await put_all(attacked, NAME, [encode_run([b"first"], times=None)])
        run = item_pb2.ItemRun.FromString(encode_run([bytes(WAITING_BYTES)], times=None))
        request = pb.PutRequest(**known, puts=[pb.PutRun(first_number=1, run=run)])
        await _put_and_wait(attacked, PUT_METHOD, request, on_begun)


async def waiting_enqueues(attacked: AttackedCluster, on_begun: Callable[[], None]) -> None:
    """Like `waiting_puts`, but with a queue."""
    async with attacked.connect() as rt:
        await (await rt.queue(NAME, max_items=1)).put(b"first")
        known = await queue_known(attacked)
        run = item_pb2.ItemRun.FromString(encode_run([bytes(WAITING_BYTES)], times=None))
        request = queue_pb.EnqueueRequest(**known, runs=[queue_pb.EnqueueRun(first_number=1, run=run)])
        await _put_and_wait(attacked, ENQUEUE_METHOD, request, on_begun)


async def queue_known(attacked: AttackedCluster) -> dict[str, Any]:
    """The fields that name the queue in requests to its host."""
    async with attacked.channel(attacked.supernode) as channel:
        resolve: Any = QueueDirectoryServiceStub(channel).ResolveQueue  # type: ignore[no-untyped-call]
        request = queue_directory_service_pb2.ResolveQueueRequest(name=NAME)
        record = (await resolve(request, metadata=attacked.metadata)).queue
    return {"queue_id": record.queue_id, "epoch": record.epoch}


async def _put_and_wait(attacked: AttackedCluster, method: str, request: Any, on_begun: Callable[[], None]) -> None:
    uploads, messages = Uploads(attacked, method), [*messages_of(request.SerializeToString())]
    for _ in range(WAITING):
        uploads.begin(messages)
    await uploads.until_stuck()
    on_begun()
    await for_ever()


async def silent_subscriptions(attacked: AttackedCluster, on_begun: Callable[[], None]) -> None:
    """60 subscriptions with unlimited credit, whose readers never read."""
    async with attacked.connect() as rt:
        await _held(await rt.channel(NAME, max_age="1h"))
        opened = pb.SubscribeOpen(**await attacked.bound(NAME), start=time_pb2.Bound(instant_unix_nano=MIN_INSTANT))
        request = pb.SubscribeRequest(open=opened, credit_bytes=2**60)
        calls = [stub(attacked, ChannelServiceStub).Subscribe(metadata=attacked.metadata) for _ in range(STREAMS)]
        on_begun()
        await all_of(*(call.write(request) for call in calls))
        await for_ever()


async def silent_gets(attacked: AttackedCluster, on_begun: Callable[[], None]) -> None:
    """60 streams with 16 gets of all items each, whose answers no reader reads."""
    async with attacked.connect() as rt:
        known = await held_channel(attacked, rt)
        calls = [stub(attacked, ChannelServiceStub).Get(metadata=attacked.metadata) for _ in range(STREAMS)]
        on_begun()
        for call_id in range(1, 17):
            request = pb.GetRequest(call_id=call_id, interval=everything(), **known)
            await all_of(*(call.write(request) for call in calls))
        await for_ever()


async def silent_takers(attacked: AttackedCluster, on_begun: Callable[[], None]) -> None:
    """60 takers of a queue, with credit for all messages, that never read."""
    async with attacked.connect() as rt:
        queue = await rt.queue(NAME, copies=STREAMS)
        for _ in range(HELD_ITEMS):
            await queue.put(bytes(MIB))
        known = await queue_known(attacked)
        calls = [stub(attacked, QueueServiceStub).Take(metadata=attacked.metadata) for _ in range(STREAMS)]
        on_begun()
        for taker_id, call in enumerate(calls, start=1):
            opened = queue_pb.TakeOpen(taker_id=taker_id, **known)
            await call.write(queue_pb.TakeRequest(open=opened, credit=1000))
        await for_ever()


async def unknown_fields(attacked: AttackedCluster, on_begun: Callable[[], None]) -> None:
    """1280 gets that wait, with 200 KiB each of fields that the contract does not have."""
    async with attacked.connect() as rt:
        await rt.channel(NAME)
        known = await attacked.bound(NAME)
        ahead = time_pb2.Interval(
            start=time_pb2.Bound(instant_unix_nano=st.now() + HOUR_NANOS),
            end=time_pb2.Bound(instant_unix_nano=MAX_INSTANT),
        )
        get = pb.GetRequest(call_id=1, interval=ahead, wait_nanos=-1, **known).SerializeToString()
        raw = get + FIELD_999 + _varint(UNKNOWN_BYTES) + bytes(UNKNOWN_BYTES)
        on_begun()
        calls = [
            attacked.channel(attacked.target).stream_stream("/stampede_rt.v1.ChannelService/Get")(
                metadata=attacked.metadata
            )
            for _ in range(GETS)
        ]
        await all_of(*(call.write(raw) for call in calls))
        await for_ever()


async def held_channel(attacked: AttackedCluster, rt: Any) -> dict[str, Any]:
    """The fields that name a channel with 16 MiB in requests to its host."""
    await _held(await rt.channel(NAME, max_age="1h"))
    return await attacked.bound(NAME)


async def _held(channel: Any) -> None:
    """Put items of 16 MiB in all."""
    for _ in range(HELD_ITEMS):
        await channel.put(bytes(MIB))


def everything() -> time_pb2.Interval:
    return time_pb2.Interval(
        start=time_pb2.Bound(instant_unix_nano=MIN_INSTANT), end=time_pb2.Bound(instant_unix_nano=MAX_INSTANT)
    )


def _varint(value: int) -> bytes:
    return bytes((value >> place & 127) | 128 for place in range(0, 28, 7)) + bytes((value >> 28,))
