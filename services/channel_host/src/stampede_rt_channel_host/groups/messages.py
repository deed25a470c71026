"""Definitions and times of groups, to and from their protobuf form (`group.proto`)."""

from __future__ import annotations

from stampede_rt.v1 import group_pb2
from stampede_rt_channel_host.core.group import MAX_LEAD_NANOS_DEFAULT, ChannelTimes, GroupDefinition


def definition_of(record: group_pb2.GroupRecord) -> GroupDefinition:
    """How the directory says the group is set up."""
    spec = record.spec
    fixed = spec.reference == group_pb2.GROUP_REFERENCE_CHANNEL
    return GroupDefinition(
        members=frozenset(spec.channel_ids),
        reference=spec.reference_channel_id if fixed else None,
        by_end=spec.bound == group_pb2.GROUP_BOUND_END,
        idle_after_nanos=spec.idle_after_nanos if spec.HasField("idle_after_nanos") else None,
        max_lead_nanos=spec.max_lead_nanos if spec.HasField("max_lead_nanos") else MAX_LEAD_NANOS_DEFAULT,
        incarnation=record.incarnation,
        spec_version=record.spec_version,
    )


def times_to_message(channel_id: bytes, times: ChannelTimes, silent_nanos: int) -> group_pb2.ChannelTimes:
    """What an owner tells of a channel."""
    return group_pb2.ChannelTimes(
        channel_id=channel_id,
        epoch=times.epoch,
        incarnation=times.incarnation,
        newest_unix_nano=times.newest,
        newest_end_unix_nano=times.newest_end,
        advance_unix_nano=times.advance,
        silent_nanos=silent_nanos,
    )


def times_from_message(told: group_pb2.ChannelTimes) -> ChannelTimes:
    """What an owner has told."""
    return ChannelTimes(
        epoch=told.epoch,
        incarnation=told.incarnation,
        newest=told.newest_unix_nano if told.HasField("newest_unix_nano") else None,
        newest_end=told.newest_end_unix_nano if told.HasField("newest_end_unix_nano") else None,
        advance=told.advance_unix_nano if told.HasField("advance_unix_nano") else None,
    )
