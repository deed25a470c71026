"""Callers that use up all streams that the ports of supernodes allow."""

from __future__ import annotations

import asyncio
import contextlib
import secrets
import signal
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import grpc
import pytest

from stampede_rt.v1 import directory_service_pb2 as pb
from stampede_rt.v1 import directory_service_pb2_grpc, quota_pb2, quota_service_pb2_grpc
from stampede_rt.v1 import quota_service_pb2 as quotas
from stampede_rt_runtime.dial import dial
from stampede_rt_runtime.quotas.limits import LIMIT_MAX
from tests.support.supernode import few_streams
from tests.support.supernode.processes import (
    Cluster,
    Supernode,
    attempts,
    called,
    open_channel,
    register,
    renew,
    resolve,
)

PARALLEL_WATCHES = 64


@contextlib.asynccontextmanager
async def running_cluster(folder: Path) -> AsyncIterator[Cluster]:
    """Three supernodes whose ports serve fewer streams than usual."""
    cluster = Cluster(folder, "--lease-ttl", "1h")
    for one in cluster.supernodes:
        one.module = few_streams.__name__
    try:
        await cluster.start()
        yield cluster
    finally:
        await cluster.close()


async def without_quotas(*supernodes: Supernode) -> None:
    """Remove the quotas of streams, so that one caller can fill ports like many callers together."""
    kinds = (quota_pb2.QUOTA_KIND_STREAMS, quota_pb2.QUOTA_KIND_SUBSCRIPTIONS)
    settings = [quota_pb2.QuotaSetting(who="*", kind=kind, limit=LIMIT_MAX) for kind in kinds]
    request = quotas.SetQuotasRequest(request_id=secrets.token_bytes(16), settings=settings)
    async with dial(supernodes[0].address, secret=None) as channel:
        stub: Any = quota_service_pb2_grpc.QuotaServiceStub(channel)
        await called(stub.SetQuotas(request, timeout=20), supernodes[0])
    for one in supernodes:  # after a confirmed read a supernode knows the new limits
        await called(one.stub.ListHosts(pb.ListHostsRequest(), timeout=20), one)


@contextlib.asynccontextmanager
async def filled(one: Supernode) -> AsyncIterator[list[Any]]:
    """Take all streams of the supernode's port with watches, which stay open during the block."""
    channel = dial(one.address, secret=None)
    stub: Any = directory_service_pb2_grpc.DirectoryServiceStub(channel)
    watches: list[Any] = []

    async def watch() -> None:
        async for _ in attempts():  # a busy machine cannot answer all in time if they begin together
            call = stub.Watch(pb.WatchRequest(name_glob="nothing/*"))
            try:
                await call.read()
            except grpc.aio.AioRpcError as error:
                if error.code() is not grpc.StatusCode.UNAVAILABLE:
                    raise
            else:
                watches.append(call)
                return

    async def replace_ended() -> None:
        """Open watches in place of the watches that a busy machine has ended."""
        for _ in range(PARALLEL_WATCHES):
            await watch()

    try:
        for _ in range(few_streams.LIMITS.streams_max // PARALLEL_WATCHES):
            await asyncio.gather(*(watch() for _ in range(PARALLEL_WATCHES)))
        with pytest.raises(grpc.aio.AioRpcError) as refused:
            await replace_ended()
        watches[:] = [one for one in watches if not one.done()]
        assert refused.value.code() is grpc.StatusCode.RESOURCE_EXHAUSTED
        yield watches
    finally:
        await channel.close()


async def test_watches_that_fill_the_ports_of_two_members_do_not_keep_a_third_from_coming_back(tmp_path: Path) -> None:
    async with running_cluster(tmp_path) as cluster:
        leader = await cluster.leader()
        third, other = cluster.others(leader)
        await register(leader, 1)
        await open_channel(leader, "cam/before")
        await without_quotas(leader, other)
        async with filled(leader) as first, filled(other) as second:
            await third.end(signal.SIGKILL)
            await open_channel(leader, "cam/meanwhile")
            await third.start()
            assert (await resolve(third, "cam/meanwhile")).channel.name == "cam/meanwhile"
            await open_channel(third, "cam/through-it")
            async for _ in attempts():
                if await renew(await cluster.leader(), 1):
                    break
            assert not any(one.done() for one in (*first, *second)), "no watch ended to make room for the third member"
            # The third member counts for the majority: if another member ends, it and the leader go on.
            await other.end(signal.SIGKILL)
            await called(third.stub.ResolveChannel(pb.ResolveChannelRequest(name="cam/before"), timeout=20), third)
            await open_channel(third, "cam/after")
