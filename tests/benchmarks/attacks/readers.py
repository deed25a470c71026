"""Attacks by readers of groups and takers of queues that do only allowed things, but very many of them."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import grpc

import stampede_rt as st
from stampede_rt.v1 import channel_service_pb2, group_directory_service_pb2, group_service_pb2, item_pb2, queue_pb2
from stampede_rt.v1 import queue_service_pb2 as queue_pb
from stampede_rt.v1.group_directory_service_pb2_grpc import GroupDirectoryServiceStub
from stampede_rt.v1.group_service_pb2_grpc import GroupServiceStub
from stampede_rt.v1.queue_service_pb2_grpc import QueueServiceStub
from stampede_rt.wire.runs import encode_run
from tests.benchmarks.attacks.attacked_cluster import GOOD_CHANNEL, AttackedCluster, all_of
from tests.benchmarks.attacks.memory import NAME, queue_known, stub

READERS, READERS_OF_ONE_CONNECTION = 1000, 500
ITEM_SECONDS = 0.01
TAKERS, ENQUEUERS, RUN_ITEMS, CREDIT = 64, 16, 16, 64


async def many_cuts(attacked: AttackedCluster, on_begun: Callable[[], None]) -> None:
    """1000 streams of the cut events of a group with the good clients' channel; all are read."""
    group = await _group_with_good_channel(attacked)
    opened = group_service_pb2.SubscribeCutsOpen(group_id=group.group.group_id, decides=True)
    request = group_service_pb2.SubscribeCutsRequest(open=opened, credit=2**31)
    await _read_many(attacked, "SubscribeCuts", request, on_begun)


async def many_matches(attacked: AttackedCluster, on_begun: Callable[[], None]) -> None:
    """1000 streams of the matches of a group with the good clients' channel; all are read."""
    group = await _group_with_good_channel(attacked)
    good = next(one for one in group.channels if one.name == GOOD_CHANNEL)
    opened = group_service_pb2.SubscribeMatchesOpen(
        group_id=group.group.group_id, per_channel_id=good.channel_id, epoch=good.epoch, tolerance_nanos=10**9
    )
    request = group_service_pb2.SubscribeMatchesRequest(open=opened, credit_bytes=2**60)
    await _read_many(attacked, "SubscribeMatches", request, on_begun)


async def _group_with_good_channel(attacked: AttackedCluster) -> Any:
    async with attacked.connect() as rt:
        await rt.group(NAME, [await rt.channel(GOOD_CHANNEL), await rt.channel(NAME, max_age="5s")])
    async with attacked.channel(attacked.supernode) as channel:
        resolve: Any = GroupDirectoryServiceStub(channel).ResolveGroup  # type: ignore[no-untyped-call]
        return await resolve(group_directory_service_pb2.ResolveGroupRequest(name=NAME), metadata=attacked.metadata)


async def _read_many(attacked: AttackedCluster, method: str, request: Any, on_begun: Callable[[], None]) -> None:
    calls: list[Any] = []
    for _ in range(READERS // READERS_OF_ONE_CONNECTION):
        one = stub(attacked, GroupServiceStub)
        calls += [getattr(one, method)(metadata=attacked.metadata) for _ in range(READERS_OF_ONE_CONNECTION)]
    await all_of(*(call.write(request) for call in calls))
    on_begun()
    await all_of(_put_items(attacked), *map(_read_all, calls))


async def _put_items(attacked: AttackedCluster) -> None:
    """Put items into the other channel of the group, so that the cut of the group advances."""
    async with attacked.connect() as rt:
        channel = await rt.channel(NAME)
        while True:
            with suppress(st.StampedeError):
                await channel.put(b"x" * 100, timeout=1.0)
            await asyncio.sleep(ITEM_SECONDS)


async def _read_all(call: Any) -> None:
    while await call.read() is not grpc.aio.EOF:
        pass


async def busy_takes(attacked: AttackedCluster, on_begun: Callable[[], None]) -> None:
    """64 takers take and acknowledge messages as fast as they come; 16 streams enqueue as fast as they are acked."""
    async with attacked.connect() as rt:
        await rt.queue(NAME, max_items=10_000, on_full="reject")
        known = await queue_known(attacked)
        on_begun()
        takers = (_take_again_and_again(attacked, known, taker_id) for taker_id in range(1, TAKERS + 1))
        await all_of(*takers, *(_enqueue_again_and_again(attacked, known) for _ in range(ENQUEUERS)))


async def _take_again_and_again(attacked: AttackedCluster, known: dict[str, Any], taker_id: int) -> None:
    call = stub(attacked, QueueServiceStub).Take(metadata=attacked.metadata)
    await call.write(queue_pb.TakeRequest(open=queue_pb.TakeOpen(taker_id=taker_id, **known), credit=CREDIT))
    while (response := await call.read()) is not grpc.aio.EOF:
        taken = [delivery_id for run in response.runs for delivery_id in run.delivery_ids]
        if taken:
            settlements = [queue_pb2.Settlement(delivery_id=one, acknowledge=queue_pb2.Acknowledge()) for one in taken]
            await call.write(queue_pb.TakeRequest(settlements=settlements, credit=len(taken)))


async def _enqueue_again_and_again(attacked: AttackedCluster, known: dict[str, Any]) -> None:
    call = stub(attacked, QueueServiceStub).Enqueue(metadata=attacked.metadata)
    run = item_pb2.ItemRun.FromString(encode_run([b"x" * 100], times=None))
    runs = [queue_pb.EnqueueRun(first_number=1, run=run, wait_nanos=0)] * RUN_ITEMS
    request = queue_pb.EnqueueRequest(**known, runs=runs)
    while True:
        await call.write(request)
        acked = 0
        while acked < RUN_ITEMS:
            response: channel_service_pb2.PutResponse = await call.read()
            acked += len(response.acks)
