"""ReplicaService on the wire: feeds to copies at other hosts."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import suppress
from typing import Any

import grpc

from stampede_rt.v1 import replica_service_pb2 as pb
from stampede_rt_channel_host.channels.requests import opening_of, parse
from stampede_rt_channel_host.channels.store import ChannelStore
from stampede_rt_channel_host.channels.streams import OpenStreams
from stampede_rt_channel_host.channels.subscriptions.credit import requests_of
from stampede_rt_channel_host.copies.feed_callers import FeedCallers
from stampede_rt_channel_host.copies.feed_opening import check_named_host
from stampede_rt_channel_host.copies.feed_stream import FeedStream
from stampede_rt_channel_host.copies.moves.outgoing_moves import OutgoingMoves
from stampede_rt_channel_host.core.group import CutFloor
from stampede_rt_runtime.rpc import Context

SERVICE = "stampede_rt.v1.ReplicaService"
FREE_SECONDS_MAX = 5.0  # a stream waits this long for its next move; the other host keeps it for less


class ReplicaServicer:
    """Serves ReplicaService. `streams` ends all open streams when the host ends."""

    def __init__(
        self, store: ChannelStore, streams: OpenStreams, floors_of: Callable[[bytes], list[CutFloor]],
        moves: OutgoingMoves, callers: FeedCallers,
    ) -> None:  # fmt: skip
        """`floors_of`: see `FeedStream`."""
        self._callers = callers
        self._store = store
        self._floors_of = floors_of
        self._streams = streams
        self._moves = moves

    def add_to(self, server: grpc.aio.Server) -> None:
        """Add the method of ReplicaService to `server`. Its handler reads and writes encoded messages."""
        handlers: dict[str, grpc.RpcMethodHandler[Any, Any]] = {
            "Feed": grpc.stream_stream_rpc_method_handler(self.feed)
        }
        server.add_generic_rpc_handlers((grpc.method_handlers_generic_handler(SERVICE, handlers),))
        server.add_registered_method_handlers(SERVICE, handlers)

    async def feed(self, requests: AsyncIterator[bytes], context: Context) -> None:
        """ReplicaService.Feed: between hosts only."""
        async with self._streams.serve(context) as stream:
            request: pb.FeedRequest | None = opening_of(await context.read(), pb.FeedRequest, "FeedRequest")
            while request is not None:
                check_named_host(request.open)
                await self._callers.check(context, request.open.host_id)
                is_free = await FeedStream(self._store, context, stream, self._floors_of, self._moves).run(request)
                request = await _next_opening(context) if is_free else None


async def _next_opening(context: Context) -> pb.FeedRequest | None:
    """The request that begins the next move in a stream whose last move is over. None: the caller has none."""
    with suppress(TimeoutError):
        async with asyncio.timeout(FREE_SECONDS_MAX):
            async for raw in requests_of(context.read):
                request: pb.FeedRequest = parse(pb.FeedRequest, raw, "FeedRequest")
                if request.HasField("open"):
                    return request
    return None
