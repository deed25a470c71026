"""A group's status at one moment, in protobuf form."""

from __future__ import annotations

from stampede_rt.v1 import group_pb2
from stampede_rt_channel_host.cluster.records import group_message
from stampede_rt_channel_host.core.group import CutMember, VisibleChannel
from stampede_rt_channel_host.groups.hosted_group import HostedGroup
from stampede_rt_channel_host.groups.messages import times_to_message
from stampede_rt_channel_host.groups.store import GroupStore


def group_status(group: HostedGroup, groups: GroupStore) -> group_pb2.GroupStatus:
    """The cut, the members that hold the cut back, and the times of each member."""
    now = groups.channels.now()
    return group_pb2.GroupStatus(
        record=group_message(group.record),
        cut_unix_nano=group.cut.cut,
        waiting_on_channel_ids=group.waiting_on(),
        members=[_member(member, group, groups, now) for member in group.cut.members(now)],
        host_time_unix_nano=now,
    )


def _member(member: CutMember, group: HostedGroup, groups: GroupStore, now: int) -> group_pb2.GroupMemberStatus:
    cut, known, own = group.cut.cut, member.known, groups.own(member.channel_id)
    if known is None:
        return group_pb2.GroupMemberStatus(times=group_pb2.ChannelTimes(channel_id=member.channel_id))
    newest = known.times.newest
    lead = None if cut is None or newest is None else newest - cut
    view = None if own is None else VisibleChannel(own.hosted.channel)
    return group_pb2.GroupMemberStatus(
        times=times_to_message(member.channel_id, known.times, known.silent_nanos(now)),
        cut_unix_nano=member.cut,
        lead_nanos=lead,
        hidden_items=None if view is None else view.hidden_items(cut, now),
        idle=member.is_idle,
        window_too_short=_is_too_short(member, group, lead) if view is None else view.window_too_short(cut, now),
        heard_ago_nanos=known.age_nanos(now),
    )


def _is_too_short(member: CutMember, group: HostedGroup, lead: int | None) -> bool:
    """Whether a member at another host keeps items for less time than its lead over the cut.

    This host knows only the max_age that the member's policy states.
    """
    record = group.channels.get(member.channel_id)
    if record is None or lead is None or record.policy.max_age_nanos is None:
        return False
    return lead > record.policy.max_age_nanos
