# Generated from ../_async by tools/generate.py; do not edit.
"""The present cut of a group, and its present members, as a host of the group knows them."""

from __future__ import annotations

from stampede_rt._sync.channel import Channel
from stampede_rt._sync.group_members import GroupMembers
from stampede_rt.cluster.binding import Binding
from stampede_rt.v1 import group_service_pb2 as group_pb
from stampede_rt.values.timeline import MIN_INSTANT

CUT_WAIT_NANOS = 1_000_000_000  # the wait of a host for a cut that this process has already seen


def present_cut(group: GroupMembers) -> int:
    """Return one cut for a read of all members; MIN_INSTANT if no item is visible yet.

    Raises GroupNotFound, ChannelNotFound, Unavailable.
    """
    request = group_pb.GetCutRequest(
        group_id=group.info.group_id, cut_floor_unix_nano=group.view.cut_floor, wait_nanos=CUT_WAIT_NANOS
    )
    response = _ask(group, group.channels[0], request)
    if not response.HasField("floor"):
        return MIN_INSTANT
    group.view.note_cut(response.floor.cut_unix_nano)
    return int(response.floor.cut_unix_nano)


def confirm_members(group: GroupMembers, member: Channel) -> None:
    """Ask the host of a member whether the group still has the members and settings that this process knows.

    If not, ask the directory for the present ones. Raises GroupNotFound, ChannelNotFound, Unavailable.
    """
    response = _ask(group, member, group_pb.GetCutRequest(group_id=group.info.group_id))
    if not response.HasField("floor"):  # the answer for a group that shows nothing has no version
        group.refresh()


def _ask(group: GroupMembers, member: Channel, request: group_pb.GetCutRequest) -> group_pb.GetCutResponse:
    """Ask the host of a member, and learn the present members if they have changed."""

    def cut_at(binding: Binding, timeout_s: float) -> group_pb.GetCutResponse:
        endpoint = group.session.endpoints.to(binding.target)
        response: group_pb.GetCutResponse = endpoint.call(endpoint.groups.GetCut, request, timeout_s)
        return response

    response = group.session.perform(member._state, cut_at)
    floor = response.floor
    if response.HasField("floor") and (floor.spec_version, floor.incarnation) != (
        group.info.spec_version,
        group.incarnation,
    ):
        group.refresh()
    return response
