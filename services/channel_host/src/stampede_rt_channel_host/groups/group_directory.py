"""The host's calls to the directory about groups (paper, sections 3.3 and 4.3)."""

from __future__ import annotations

from stampede_rt.v1 import group_directory_service_pb2 as pb
from stampede_rt.v1 import group_directory_service_pb2_grpc
from stampede_rt_channel_host.cluster.records import resolved_group
from stampede_rt_channel_host.cluster.supernodes import Supernodes
from stampede_rt_channel_host.core.records import ResolvedGroup

CALL_SECONDS_MAX = 4.0


class GroupDirectory:
    """Asks the directory about groups.

    Each method waits for CALL_SECONDS_MAX at most. It raises the error with which the directory answers, or
    Unavailable.
    """

    def __init__(self, supernodes: Supernodes) -> None:
        self._supernodes = supernodes

    async def resolve(self, group_id: bytes) -> ResolvedGroup:
        """The present record of the group, its members and their owners. Raises GROUP_NOT_FOUND."""
        request = pb.ResolveGroupRequest(group_id=group_id)
        response: pb.ResolveGroupResponse = await self._supernodes.call(
            "ResolveGroup",
            request,
            CALL_SECONDS_MAX,
            service=group_directory_service_pb2_grpc.GroupDirectoryServiceStub,
        )
        return resolved_group(response)

    async def groups_of(self, channel_id: bytes) -> list[bytes]:
        """The ids of the groups of which the channel is a member."""
        request = pb.ListGroupsRequest(channel_id=channel_id)
        response: pb.ListGroupsResponse = await self._supernodes.call(
            "ListGroups",
            request,
            CALL_SECONDS_MAX,
            service=group_directory_service_pb2_grpc.GroupDirectoryServiceStub,
        )
        return [one.group_id for one in response.groups]
