"""A host that answers with more than was asked for, or with less: both transports say so, and read no further."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import grpc
import pytest

import stampede_rt as st
from stampede_rt.cluster.call_metadata import CallMetadata
from stampede_rt.transports import grpc_async, grpc_sync
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.v1 import channel_service_pb2_grpc, item_pb2
from tests.support.waiting import until

RUN = item_pb2.ItemRun(time_unix_nano=[1], payload_length_bytes=[1], payloads=b"x", first_seq=1)


class Hostile(channel_service_pb2_grpc.ChannelServiceServicer):
    """Answers each get with items without an end, and each put with no ack."""

    def __init__(self) -> None:
        self.sent = self.ended = 0

    async def Get(self, requests: Any, context: Any) -> AsyncIterator[pb.GetResponse]:  # noqa: N802
        try:
            request = await anext(requests)
            while True:
                self.sent += 1
                yield pb.GetResponse(call_id=request.call_id, runs=[item_pb2.DeliveredRun(run=RUN)])
        finally:
            self.ended += 1

    async def Put(self, requests: Any, context: Any) -> AsyncIterator[pb.PutResponse]:  # noqa: N802
        async for _ in requests:
            yield pb.PutResponse()


@asynccontextmanager
async def hostile() -> AsyncIterator[tuple[Hostile, str]]:
    server, servicer = grpc.aio.server(), Hostile()
    channel_service_pb2_grpc.add_ChannelServiceServicer_to_server(servicer, server)
    port = server.add_insecure_port("127.0.0.1:0")
    await server.start()
    try:
        yield servicer, f"127.0.0.1:{port}"
    finally:
        await server.stop(None)


async def test_a_get_ends_if_the_host_sends_more_items_than_requested() -> None:
    async with hostile() as (host, target):
        endpoint = grpc_async.ServerEndpoint(target, CallMetadata(lambda: None))
        with pytest.raises(st.StampedeError, match="a host sent 4 items, and the request asked for 3 at most"):
            await endpoint.gets().get(pb.GetRequest(limit=3), 10)
        await until(lambda: host.ended, "the host learns that nobody reads")
        await endpoint.aclose()


async def test_a_get_on_a_thread_ends_if_the_host_sends_more_items_than_requested() -> None:
    async with hostile() as (host, target):
        endpoint = await asyncio.to_thread(grpc_sync.ServerEndpoint, target, CallMetadata(lambda: None))

        def get() -> None:
            endpoint.gets().get(pb.GetRequest(limit=3), 10)

        with pytest.raises(st.StampedeError, match="a host sent 4 items, and the request asked for 3 at most"):
            await asyncio.to_thread(get)
        await until(lambda: host.ended, "the host learns that nobody reads")
        await asyncio.to_thread(endpoint.close)


async def test_a_put_that_gets_no_ack_has_an_error() -> None:
    async with hostile() as (_, target):
        endpoint = await asyncio.to_thread(grpc_sync.ServerEndpoint, target, CallMetadata(lambda: None))
        with pytest.raises(st.Unavailable, match="sent 0 acks for one put"):
            await asyncio.to_thread(lambda: endpoint.puts().put(pb.PutRequest().SerializeToString(), 10))
        await asyncio.to_thread(endpoint.close)
