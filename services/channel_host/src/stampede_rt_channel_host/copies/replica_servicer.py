"""ReplicaService on the wire: feeds to copies at other hosts."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from typing import Any

import grpc

from stampede_rt.v1 import replica_service_pb2 as pb
from stampede_rt_channel_host.channels.requests import opening_of
from stampede_rt_channel_host.channels.store import ChannelStore
from stampede_rt_channel_host.channels.streams import OpenStreams
from stampede_rt_channel_host.copies.feed_callers import FeedCallers
from stampede_rt_channel_host.copies.feed_stream import FeedStream, check_named_host
from stampede_rt_channel_host.copies.outgoing_moves import OutgoingMoves
from stampede_rt_channel_host.core.group import CutFloor
from stampede_rt_runtime.rpc import Context

SERVICE = "stampede_rt.v1.ReplicaService"


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
            request: pb.FeedRequest = opening_of(await context.read(), pb.FeedRequest, "FeedRequest")
            check_named_host(request.open)
            await self._callers.check(context, request.open.host_id)
            await FeedStream(self._store, context, stream, self._floors_of, self._moves).run(request)
