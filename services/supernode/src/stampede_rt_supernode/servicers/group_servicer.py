"""Serves GroupDirectoryService (proto/stampede_rt/v1/group_directory_service.proto). Each method checks the request,
asks the core or the log, and encodes the response.
"""

# ruff: noqa: N802  # methods have the names of the RPCs
from __future__ import annotations

import secrets
from collections.abc import Sequence

from stampede_rt.v1 import group_directory_service_pb2 as pb
from stampede_rt.v1 import group_directory_service_pb2_grpc
from stampede_rt_runtime.access.control import allowed_to, caller_name, check_known, creation_limit
from stampede_rt_runtime.access.rules import AccessKind, AccessVerb
from stampede_rt_runtime.quotas.limits import Quota
from stampede_rt_runtime.rpc import Context, errors_as_status
from stampede_rt_supernode.codecs.group_codec import group_record, group_spec_from
from stampede_rt_supernode.codecs.host_codec import host_record
from stampede_rt_supernode.codecs.record_codec import channel_record
from stampede_rt_supernode.core import page_tokens
from stampede_rt_supernode.core.command_table import check_operation
from stampede_rt_supernode.core.directory import Directory
from stampede_rt_supernode.core.groups.commands import (
    DeleteGroup,
    GroupDeleted,
    GroupOpened,
    GroupUpdated,
    OpenGroup,
    UpdateGroup,
)
from stampede_rt_supernode.core.groups.queries import GroupView, group_page, group_view
from stampede_rt_supernode.core.groups.transitions import open_group_unchanged
from stampede_rt_supernode.core.lookups import group_by_id, group_by_name
from stampede_rt_supernode.core.records import ID_BYTES, GroupRecord
from stampede_rt_supernode.servicers.calls import DirectoryCalls
from stampede_rt_supernode.servicers.listing import SearchStep, list_shown


class GroupDirectoryServicer(group_directory_service_pb2_grpc.GroupDirectoryServiceServicer):
    """One supernode's answers about groups."""

    def __init__(self, calls: DirectoryCalls) -> None:
        self._calls = calls

    @errors_as_status
    async def OpenGroup(self, request: pb.OpenGroupRequest, context: Context) -> pb.OpenGroupResponse:
        """Open a group. If nothing changes, a confirmed read answers the first attempt without a log entry."""
        as_of = self._calls.applied_index()
        check_known(AccessKind.GROUP, request.name)
        operation = OpenGroup(
            name=request.name,
            spec=group_spec_from(request.spec) if request.HasField("spec") else None,
            create=request.create,
            new_group_id=secrets.token_bytes(ID_BYTES),
            new_incarnation=secrets.randbits(64) or 1,
            created_by=caller_name(),
            created_max=creation_limit(Quota.GROUPS),
        )
        check_operation(operation)

        async def check(operation: OpenGroup) -> None:
            if self._calls.check_opening(AccessKind.GROUP, operation):
                await self._check_members(context, request.spec.channel_ids)

        opened = await self._calls.open(
            context,
            operation,
            GroupOpened,
            request.request_id,
            as_of_index=as_of,
            unchanged=open_group_unchanged,
            check=check,
        )
        group = opened.group
        view = await self._calls.read(context, lambda directory: group_view(directory.tables, group), stale_ok=True)
        return pb.OpenGroupResponse(
            group=group_record(group),
            channels=[channel_record(channel) for channel in view.channels],
            hosts=[host_record(host) for host in view.hosts],
            created=opened.created,
        )

    @errors_as_status
    async def ResolveGroup(self, request: pb.ResolveGroupRequest, context: Context) -> pb.ResolveGroupResponse:

        def find(directory: Directory) -> tuple[GroupView, int]:
            tables = directory.tables
            by_id = request.WhichOneof("key") == "group_id"
            group = group_by_id(tables, request.group_id) if by_id else group_by_name(tables, request.name)
            return group_view(tables, group), directory.applied_index

        if request.WhichOneof("key") == "name":
            check_known(AccessKind.GROUP, request.name)
        view, index = await self._calls.read(context, find, stale_ok=request.stale_ok)
        check_known(AccessKind.GROUP, view.group.name, by_id=True)
        return pb.ResolveGroupResponse(
            group=group_record(view.group),
            channels=[channel_record(channel) for channel in view.channels],
            hosts=[host_record(host) for host in view.hosts],
            applied_index=index,
        )

    @errors_as_status
    async def UpdateGroup(self, request: pb.UpdateGroupRequest, context: Context) -> pb.UpdateGroupResponse:
        operation = UpdateGroup(
            group_id=request.group_id,
            add_channel_ids=tuple(request.add_channel_ids),
            remove_channel_ids=tuple(request.remove_channel_ids),
            spec_version=request.spec_version if request.HasField("spec_version") else None,
        )
        check_operation(operation)  # first, because it limits the number of channels that the next checks look at
        await self._calls.check_thing(context, AccessVerb.CONFIGURE, AccessKind.GROUP, request.group_id)
        await self._check_members(context, operation.add_channel_ids)
        updated = await self._calls.submit(context, operation, GroupUpdated, request.request_id)
        return pb.UpdateGroupResponse(group=group_record(updated.group))

    @errors_as_status
    async def DeleteGroup(self, request: pb.DeleteGroupRequest, context: Context) -> pb.DeleteGroupResponse:
        await self._calls.check_thing(context, AccessVerb.DELETE, AccessKind.GROUP, request.group_id)
        await self._calls.submit(context, DeleteGroup(group_id=request.group_id), GroupDeleted, request.request_id)
        return pb.DeleteGroupResponse()

    @errors_as_status
    async def ListGroups(self, request: pb.ListGroupsRequest, context: Context) -> pb.ListGroupsResponse:
        listing = f"groups\0{request.name_glob}\0{request.channel_id.hex()}"

        def search(directory: Directory, after: str, most: int) -> SearchStep[GroupRecord, str]:
            page = group_page(directory.tables, request.name_glob, request.channel_id, after, most)
            return SearchStep([(group.name, group) for group in page.groups], page.last_name)

        may_list = allowed_to(AccessVerb.LIST, AccessKind.GROUP)
        page = await list_shown(
            self._calls,
            context,
            search,
            lambda group: may_list(group.name),
            page_tokens.read_listing(request.page_token, listing),
            request.page_size,
            stale_ok=request.stale_ok,
        )
        return pb.ListGroupsResponse(
            groups=map(group_record, page.things),
            next_page_token=page_tokens.write_listing(listing, page.last),
            applied_index=page.applied_index,
        )

    async def _check_members(self, context: Context, channel_ids: Sequence[bytes]) -> None:
        """Check that the caller may read the channels, because a group shows the times of its channels' items.

        Raises PermissionDenied.
        """
        await self._calls.check_things(context, AccessVerb.READ, AccessKind.CHANNEL, channel_ids)
