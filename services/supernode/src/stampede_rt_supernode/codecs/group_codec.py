"""Converts groups from and to their messages. Makes no decisions."""

from __future__ import annotations

from stampede_rt.errors import InvalidArgument
from stampede_rt.v1 import directory_command_pb2 as pb
from stampede_rt.v1 import group_pb2
from stampede_rt_supernode.core.records import GroupRecord, GroupSpec

_BOUNDS_FROM_WIRE = {
    group_pb2.GROUP_BOUND_UNSPECIFIED: "start",
    group_pb2.GROUP_BOUND_START: "start",
    group_pb2.GROUP_BOUND_END: "end",
}
_BOUNDS_TO_WIRE = {"start": group_pb2.GROUP_BOUND_START, "end": group_pb2.GROUP_BOUND_END}
_OLDEST = (group_pb2.GROUP_REFERENCE_UNSPECIFIED, group_pb2.GROUP_REFERENCE_OLDEST)


def group_spec_from(spec: group_pb2.GroupSpec) -> GroupSpec:
    """The members and settings in a message.

    Raises InvalidArgument if the reference or bound is unknown, or if the message has a `reference_channel_id` although
    no channel is the reference.
    """
    if spec.bound not in _BOUNDS_FROM_WIRE:
        raise InvalidArgument(f"bound is {spec.bound}, which this version does not know; see GroupBound for the values")
    return GroupSpec(
        channel_ids=tuple(spec.channel_ids),
        reference_channel_id=_reference_from(spec),
        bound=_BOUNDS_FROM_WIRE[spec.bound],
        idle_after_nanos=spec.idle_after_nanos if spec.HasField("idle_after_nanos") else None,
        max_lead_nanos=spec.max_lead_nanos if spec.HasField("max_lead_nanos") else None,
    )


def _reference_from(spec: group_pb2.GroupSpec) -> bytes | None:
    if spec.reference == group_pb2.GROUP_REFERENCE_CHANNEL:
        return spec.reference_channel_id
    if spec.reference not in _OLDEST:
        raise InvalidArgument(
            f"reference is {spec.reference}, which this version does not know; see GroupReference for the values"
        )
    if spec.reference_channel_id:
        raise InvalidArgument(
            "reference_channel_id is stated, but the reference is the oldest of all; state GROUP_REFERENCE_CHANNEL, or "
            "leave the id out"
        )
    return None


def group_spec_message(spec: GroupSpec) -> group_pb2.GroupSpec:
    """The message of the members and settings. Leaves out fields that are None."""
    by_channel = spec.reference_channel_id is not None
    return group_pb2.GroupSpec(
        channel_ids=spec.channel_ids,
        reference=group_pb2.GROUP_REFERENCE_CHANNEL if by_channel else group_pb2.GROUP_REFERENCE_OLDEST,
        reference_channel_id=spec.reference_channel_id or b"",
        bound=_BOUNDS_TO_WIRE[spec.bound],
        idle_after_nanos=spec.idle_after_nanos,
        max_lead_nanos=spec.max_lead_nanos,
    )


def group_record(group: GroupRecord) -> group_pb2.GroupRecord:
    """The message of a group."""
    return group_pb2.GroupRecord(
        group_id=group.group_id,
        name=group.name,
        spec=group_spec_message(group.spec),
        spec_version=group.spec_version,
        incarnation=group.incarnation,
        created_by=group.created_by,
    )


def group_from(record: group_pb2.GroupRecord) -> GroupRecord:
    """The group of a record that this codec wrote."""
    return GroupRecord(
        group_id=record.group_id,
        name=record.name,
        spec=group_spec_from(record.spec),
        spec_version=record.spec_version,
        incarnation=record.incarnation,
        created_by=record.created_by,
    )


def group_entry(group: GroupRecord, witnesses: tuple[bytes, ...]) -> pb.GroupEntry:
    """The entry that supernodes keep for a group. `witnesses`: the ids of hosts, see `GroupTable`."""
    return pb.GroupEntry(record=group_record(group), witness_host_ids=witnesses)


def group_entry_from(entry: pb.GroupEntry) -> tuple[GroupRecord, tuple[bytes, ...]]:
    """The group and the host ids of its witnesses, from an entry that this codec wrote."""
    return group_from(entry.record), tuple(entry.witness_host_ids)
