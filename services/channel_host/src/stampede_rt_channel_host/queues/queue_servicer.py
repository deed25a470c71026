"""QueueService on the wire.

Methods that carry runs take and return bytes. So the host stores a producer's run as it came, and sends a stored run as
it is. The other methods use the generated messages.
"""

from __future__ import annotations

from collections.abc import AsyncIterator
from functools import partial

import grpc

from stampede_rt.errors import InvalidArgument
from stampede_rt.v1 import queue_service_pb2 as pb
from stampede_rt_channel_host.channels.streams import OpenStreams
from stampede_rt_channel_host.queues.access import check_queue_access, check_queue_known
from stampede_rt_channel_host.queues.enqueue_stream import EnqueueStream
from stampede_rt_channel_host.queues.queue_status import queue_status
from stampede_rt_channel_host.queues.queue_store import QueueStore
from stampede_rt_channel_host.queues.replica_acks import wait_for_replicas
from stampede_rt_channel_host.queues.requests import (
    check_queue_id,
    check_taker_id,
    page_size_of,
    pending_message,
    result_message,
    settlements_of,
)
from stampede_rt_channel_host.queues.take_stream import TakeStream
from stampede_rt_runtime.access.rules import AccessVerb
from stampede_rt_runtime.rpc import Context, errors_as_status, unary

SERVICE = "stampede_rt.v1.QueueService"


class QueueServicer:
    """Each method passes its request to the object that performs it. No method catches errors: they become statuses."""

    def __init__(self, store: QueueStore, streams: OpenStreams) -> None:
        self._store = store
        self._streams = streams

    def add_to(self, server: grpc.aio.Server) -> None:
        """Add the methods of QueueService to `server`."""
        handlers = {
            "Enqueue": grpc.stream_stream_rpc_method_handler(self.enqueue),
            "Take": grpc.stream_stream_rpc_method_handler(self.take),
            "Settle": unary(self.settle, pb.SettleRequest, pb.SettleResponse),
            "ListPending": unary(self.list_pending, pb.ListPendingRequest, pb.ListPendingResponse),
            "GetQueueStatus": unary(self.get_queue_status, pb.GetQueueStatusRequest, pb.GetQueueStatusResponse),
        }
        server.add_generic_rpc_handlers((grpc.method_handlers_generic_handler(SERVICE, handlers),))
        server.add_registered_method_handlers(SERVICE, handlers)

    async def enqueue(self, requests: AsyncIterator[bytes], context: Context) -> None:
        """QueueService.Enqueue."""
        async with self._streams.serve(context) as stream:
            await EnqueueStream(self._store, context, stream).run()

    async def take(self, requests: AsyncIterator[bytes], context: Context) -> None:
        """QueueService.Take."""
        async with self._streams.serve(context) as stream:
            await TakeStream(self._store, context, stream).run()

    @errors_as_status
    async def settle(self, request: pb.SettleRequest, context: Context) -> pb.SettleResponse:
        """QueueService.Settle."""
        check_queue_id(request.queue_id)
        check_taker_id(request.taker_id)
        if not request.settlements:
            raise InvalidArgument("the request has no settlements; give 1 to 1024")
        settlements = settlements_of(request.settlements)
        hosted = await self._store.use(request.queue_id, request.epoch)
        check = partial(check_queue_access, AccessVerb.TAKE, hosted.record)
        with self._store.takers.using(request.queue_id, request.taker_id, "taker", check):
            results = hosted.settle(request.taker_id, settlements)
        await wait_for_replicas(hosted)
        return pb.SettleResponse(results=map(result_message, results))

    @errors_as_status
    async def list_pending(self, request: pb.ListPendingRequest, context: Context) -> pb.ListPendingResponse:
        """QueueService.ListPending."""
        check_queue_id(request.queue_id)
        page_size = page_size_of(request)
        hosted = await self._store.use(request.queue_id, request.epoch or None)
        check_queue_known(hosted.record)
        found = hosted.pending(request.after_delivery_id, page_size)
        return pb.ListPendingResponse(deliveries=map(pending_message, found), more=len(found) == page_size)

    @errors_as_status
    async def get_queue_status(self, request: pb.GetQueueStatusRequest, context: Context) -> pb.GetQueueStatusResponse:
        """QueueService.GetQueueStatus."""
        check_queue_id(request.queue_id)
        hosted = await self._store.use(request.queue_id, request.epoch or None)
        check_queue_known(hosted.record)
        return pb.GetQueueStatusResponse(status=queue_status(hosted, self._store.now()))
