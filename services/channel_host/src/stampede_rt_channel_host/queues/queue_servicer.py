"""QueueService on the wire. Methods that carry runs take and give bytes, so that a producer's run is stored as it came
and sent as it is; the others use the generated messages."""

from __future__ import annotations

from collections.abc import AsyncIterator
from typing import Any

import grpc

from stampede_rt.errors import InvalidArgument, StampedeError
from stampede_rt.status import abort
from stampede_rt.v1 import queue_service_pb2 as pb
from stampede_rt_channel_host.channels.streams import OpenStreams
from stampede_rt_channel_host.queues.enqueue_stream import EnqueueStream
from stampede_rt_channel_host.queues.queue_status import queue_status
from stampede_rt_channel_host.queues.queue_store import QueueStore
from stampede_rt_channel_host.queues.requests import (
    check_queue_id,
    check_taker_id,
    page_size_of,
    pending_message,
    result_message,
    settlements_of,
)
from stampede_rt_channel_host.queues.take_stream import TakeStream

SERVICE = "stampede_rt.v1.QueueService"


class QueueServicer:
    """Each method: find the queue, hand over, let errors rise."""

    def __init__(self, store: QueueStore, streams: OpenStreams) -> None:
        self._store = store
        self._streams = streams

    def add_to(self, server: grpc.aio.Server) -> None:
        """Serve on `server`."""
        handlers = {
            "Enqueue": grpc.stream_stream_rpc_method_handler(self.enqueue),
            "Take": grpc.stream_stream_rpc_method_handler(self.take),
            "Settle": _unary(self.settle, pb.SettleRequest, pb.SettleResponse),
            "ListPending": _unary(self.list_pending, pb.ListPendingRequest, pb.ListPendingResponse),
            "GetQueueStatus": _unary(self.get_queue_status, pb.GetQueueStatusRequest, pb.GetQueueStatusResponse),
        }
        server.add_generic_rpc_handlers((grpc.method_handlers_generic_handler(SERVICE, handlers),))
        server.add_registered_method_handlers(SERVICE, handlers)

    async def enqueue(self, requests: AsyncIterator[bytes], context: Any) -> None:
        """QueueService.Enqueue."""
        async with self._streams.serve(context) as stream:
            await EnqueueStream(self._store, context, stream).run()

    async def take(self, requests: AsyncIterator[bytes], context: Any) -> None:
        """QueueService.Take."""
        async with self._streams.serve(context) as stream:
            await TakeStream(self._store, context, stream).run()

    async def settle(self, request: pb.SettleRequest, context: Any) -> pb.SettleResponse:
        """QueueService.Settle."""
        try:
            check_queue_id(request.queue_id)
            check_taker_id(request.taker_id)
            if not request.settlements:
                raise InvalidArgument("the request settles nothing; name 1 to 1024 deliveries")
            settlements = settlements_of(request.settlements)
            hosted = await self._store.use(request.queue_id, request.epoch)
            results = hosted.settle(request.taker_id, settlements)
        except StampedeError as error:
            await abort(context, error)
        return pb.SettleResponse(results=map(result_message, results))

    async def list_pending(self, request: pb.ListPendingRequest, context: Any) -> pb.ListPendingResponse:
        """QueueService.ListPending."""
        try:
            check_queue_id(request.queue_id)
            page_size = page_size_of(request)
            hosted = await self._store.use(request.queue_id, request.epoch or None)
            found = hosted.pending(request.after_delivery_id, page_size)
        except StampedeError as error:
            await abort(context, error)
        return pb.ListPendingResponse(deliveries=map(pending_message, found), more=len(found) == page_size)

    async def get_queue_status(self, request: pb.GetQueueStatusRequest, context: Any) -> pb.GetQueueStatusResponse:
        """QueueService.GetQueueStatus."""
        try:
            check_queue_id(request.queue_id)
            hosted = await self._store.use(request.queue_id, request.epoch or None)
        except StampedeError as error:
            await abort(context, error)
        return pb.GetQueueStatusResponse(status=queue_status(hosted, self._store.now()))


def _unary(method: Any, request: Any, response: Any) -> grpc.RpcMethodHandler[Any, Any]:
    return grpc.unary_unary_rpc_method_handler(
        method, request_deserializer=request.FromString, response_serializer=response.SerializeToString
    )
