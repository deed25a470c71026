"""GroupService on the wire (paper, sections 3.3 and 4.1).

Each method hands its call over to the part of the host that does the work. It catches no errors itself.
"""

from __future__ import annotations

from collections.abc import AsyncIterator
from typing import Any

import grpc

from stampede_rt.v1 import group_service_pb2 as pb
from stampede_rt_channel_host.channels.streams import OpenStreams
from stampede_rt_channel_host.cluster.cut_floors import floor_to_message
from stampede_rt_channel_host.groups.cut_events import CutEvents
from stampede_rt_channel_host.groups.group_status import group_status
from stampede_rt_channel_host.groups.match_stream import MatchStream
from stampede_rt_channel_host.groups.sharing_hosts import Dial
from stampede_rt_channel_host.groups.store import GroupStore
from stampede_rt_runtime.access.control import check_access, check_known
from stampede_rt_runtime.access.rules import AccessKind, AccessVerb
from stampede_rt_runtime.rpc import Context, errors_as_status, unary

SERVICE = "stampede_rt.v1.GroupService"
# The longest wait of GetGroupStatus for silent hosts. Then it answers without them, and names their members.
SETTLE_SECONDS = 1.0


class GroupServicer:
    """Serves GroupService. `streams` ends all open streams when the host ends.

    A stream that carries runs has no response serializer: its handler writes encoded messages.
    """

    def __init__(self, groups: GroupStore, dial: Dial, streams: OpenStreams) -> None:
        self._groups = groups
        self._dial = dial
        self._streams = streams

    def add_to(self, server: grpc.aio.Server) -> None:
        """Add the methods of GroupService to `server`."""
        handlers: dict[str, grpc.RpcMethodHandler[Any, Any]] = {
            "ExchangeTimes": grpc.stream_stream_rpc_method_handler(
                self.exchange_times,
                request_deserializer=pb.ExchangeTimesRequest.FromString,
                response_serializer=pb.ExchangeTimesResponse.SerializeToString,
            ),
            "GetCut": unary(self.get_cut, pb.GetCutRequest, pb.GetCutResponse),
            "SubscribeCuts": grpc.stream_stream_rpc_method_handler(
                self.subscribe_cuts, request_deserializer=pb.SubscribeCutsRequest.FromString
            ),
            "SubscribeMatches": grpc.stream_stream_rpc_method_handler(
                self.subscribe_matches, request_deserializer=pb.SubscribeMatchesRequest.FromString
            ),
            "GetGroupStatus": unary(self.get_group_status, pb.GetGroupStatusRequest, pb.GetGroupStatusResponse),
        }
        server.add_generic_rpc_handlers((grpc.method_handlers_generic_handler(SERVICE, handlers),))
        server.add_registered_method_handlers(SERVICE, handlers)

    async def exchange_times(self, requests: AsyncIterator[pb.ExchangeTimesRequest], context: Context) -> None:
        """GroupService.ExchangeTimes: between hosts only."""
        async with self._streams.serve(context):
            await self._groups.exchange.sharing_hosts.accept(context)

    async def subscribe_cuts(self, requests: AsyncIterator[pb.SubscribeCutsRequest], context: Context) -> None:
        """GroupService.SubscribeCuts."""
        async with self._streams.serve(context) as stream:
            await CutEvents(self._groups, context, stream).run()

    async def subscribe_matches(self, requests: AsyncIterator[pb.SubscribeMatchesRequest], context: Context) -> None:
        """GroupService.SubscribeMatches."""
        async with self._streams.serve(context) as stream:
            await MatchStream(self._groups, self._dial, context, stream).run()

    @errors_as_status
    async def get_cut(self, request: pb.GetCutRequest, context: Context) -> pb.GetCutResponse:
        """GroupService.GetCut: the cut, as soon as it has reached `cut_floor_unix_nano` of the request.

        If the caller's wait ends first, the answer says `stalled`, and gives the cut that this host has.
        """
        self._groups.check_serving()
        group = await self._groups.find(request.group_id)
        check_access(AccessVerb.READ, AccessKind.GROUP, group.record.name)
        floor = request.cut_floor_unix_nano if request.HasField("cut_floor_unix_nano") else None
        reached = await group.reach(floor, max(0, request.wait_nanos) / 1e9)
        waiting_on = group.waiting_on()
        reached_floor = group.floor()
        message = None if reached_floor is None else floor_to_message(reached_floor)
        return pb.GetCutResponse(floor=message, stalled=not reached, waiting_on_channel_ids=waiting_on)

    @errors_as_status
    async def get_group_status(self, request: pb.GetGroupStatusRequest, context: Context) -> pb.GetGroupStatusResponse:
        """GroupService.GetGroupStatus: the cut, the members that hold the cut back, and the times of each member."""
        group = await self._groups.find(request.group_id)
        check_known(AccessKind.GROUP, group.record.name)
        await group.reach(None, SETTLE_SECONDS)
        return pb.GetGroupStatusResponse(status=group_status(group, self._groups))
