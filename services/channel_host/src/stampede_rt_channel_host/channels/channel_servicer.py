"""ChannelService on the wire.

Methods that carry runs take and return bytes. So the host stores a producer's run as it came, and sends a stored run as
it is. The other methods use the generated messages.
"""

from __future__ import annotations

from collections.abc import AsyncIterator
from functools import partial

import grpc
from grpc.aio import EOF

from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt_channel_host.channels.channel_status import channel_status
from stampede_rt_channel_host.channels.channel_users import users_of
from stampede_rt_channel_host.channels.consuming import consuming
from stampede_rt_channel_host.channels.copy_state import Freshness
from stampede_rt_channel_host.channels.gets.get_stream import GetStream
from stampede_rt_channel_host.channels.group_access import GroupAccess
from stampede_rt_channel_host.channels.puts.put_stream import PutStream
from stampede_rt_channel_host.channels.requests import opening_of, parse
from stampede_rt_channel_host.channels.store import ChannelStore
from stampede_rt_channel_host.channels.streams import OpenStreams
from stampede_rt_channel_host.channels.subscriptions.subscription import Subscription
from stampede_rt_runtime.access.control import allowed_to, check_access, check_known, own_name
from stampede_rt_runtime.access.rules import AccessKind, AccessVerb
from stampede_rt_runtime.rpc import Context, errors_as_status, unary

SERVICE = "stampede_rt.v1.ChannelService"


class ChannelServicer:
    """Each method passes its request to the object that performs it. No method catches errors: they become statuses."""

    def __init__(self, store: ChannelStore, groups: GroupAccess, streams: OpenStreams) -> None:
        self._store = store
        self._groups = groups
        self._streams = streams

    def add_to(self, server: grpc.aio.Server) -> None:
        """Add the methods of ChannelService to `server`."""
        handlers = {
            "Put": grpc.stream_stream_rpc_method_handler(self.put),
            "Get": grpc.stream_stream_rpc_method_handler(self.get),
            "Subscribe": grpc.stream_stream_rpc_method_handler(self.subscribe),
            "ShareMemory": grpc.stream_stream_rpc_method_handler(self.share_memory),
            "Advance": unary(self.advance, pb.AdvanceRequest, pb.AdvanceResponse),
            "Consume": unary(self.consume, pb.ConsumeRequest, pb.ConsumeResponse),
            "GetChannelStatus": unary(self.get_channel_status, pb.GetChannelStatusRequest, pb.GetChannelStatusResponse),
        }
        server.add_generic_rpc_handlers((grpc.method_handlers_generic_handler(SERVICE, handlers),))
        server.add_registered_method_handlers(SERVICE, handlers)

    async def put(self, requests: AsyncIterator[bytes], context: Context) -> None:
        """ChannelService.Put."""
        async with self._streams.serve(context) as stream:
            await PutStream(self._store, context, stream).run()

    async def get(self, requests: AsyncIterator[bytes], context: Context) -> None:
        """ChannelService.Get."""
        async with self._streams.serve(context) as stream:
            await GetStream(self._store, self._groups, context, stream).run()

    async def subscribe(self, requests: AsyncIterator[bytes], context: Context) -> None:
        """ChannelService.Subscribe."""
        async with self._streams.serve(context) as stream:
            request: pb.SubscribeRequest = opening_of(await context.read(), pb.SubscribeRequest, "SubscribeRequest")
            demand = Freshness() if request.open.stale_ok else None
            hosted = self._store.find_readable(request.open.channel_id, request.open.epoch, demand)
            check_access(AccessVerb.READ, AccessKind.CHANNEL, hosted.record.name)
            await Subscription(hosted, self._store, self._groups, context, stream).run(request)

    async def share_memory(self, requests: AsyncIterator[bytes], context: Context) -> None:
        """ChannelService.ShareMemory."""
        async with self._streams.serve(context):
            raw = await context.read()
            request = pb.ShareMemoryRequest() if raw is EOF else parse(pb.ShareMemoryRequest, raw, "ShareMemoryRequest")
            hosted = self._store.find(request.channel_id, request.epoch)
            check_access(AccessVerb.READ, AccessKind.CHANNEL, hosted.record.name)
            await self._store.rings.serve(hosted, context)

    @errors_as_status
    async def advance(self, request: pb.AdvanceRequest, context: Context) -> pb.AdvanceResponse:
        """ChannelService.Advance."""
        await wait_until_decided(self._store, request.channel_id, request.epoch)
        hosted = self._store.find(request.channel_id, request.epoch)
        check_access(AccessVerb.ADVANCE, AccessKind.CHANNEL, hosted.record.name)
        if hosted.recording is not None:
            hosted.recording.check_advance(request.time_unix_nano)
        return pb.AdvanceResponse(advance_unix_nano=hosted.advance(request.time_unix_nano))

    @errors_as_status
    async def consume(self, request: pb.ConsumeRequest, context: Context) -> pb.ConsumeResponse:
        """ChannelService.Consume."""
        await wait_until_decided(self._store, request.channel_id, request.epoch)
        hosted = self._store.find(request.channel_id, request.epoch)
        check = partial(check_access, AccessVerb.CONSUME, AccessKind.CHANNEL, hosted.record.name)
        with self._store.consumers.using(request.channel_id, request.consumer_id, "consumer", check):
            return await self._store.scheduler.do(consuming(self._store, request, own_name()))

    @errors_as_status
    async def get_channel_status(
        self, request: pb.GetChannelStatusRequest, context: Context
    ) -> pb.GetChannelStatusResponse:
        """ChannelService.GetChannelStatus."""
        if request.epoch:
            hosted = self._store.find_readable(request.channel_id, request.epoch, Freshness())
        else:
            hosted = self._store.find_any_epoch(request.channel_id)
        check_known(AccessKind.CHANNEL, hosted.record.name)
        name, readers = hosted.record.name, self._store.readers
        making = channel_status(hosted, self._store.now, readers.dropped(name), self._store.multicasts)
        status = await self._store.scheduler.do(making)
        users = None
        if allowed_to(AccessVerb.READ, AccessKind.CHANNEL)(name):
            users = await self._store.scheduler.do(users_of(hosted, readers))
        return pb.GetChannelStatusResponse(status=status, users=users)


async def wait_until_decided(store: ChannelStore, channel_id: bytes, epoch: int) -> None:
    """While a move holds the changes of the channel, wait. Raises the errors of `find`, and Overloaded after 5 s."""
    hosted = store.find(channel_id, epoch)
    if hosted.moving is not None:
        await hosted.moving.decided()
