"""Groups, and what is done to them, to and from the messages that carry them. Thin: no decision is made here."""

from __future__ import annotations

from stampede_rt.errors import InvalidArgument, StampedeError
from stampede_rt.v1 import directory_command_pb2 as pb
from stampede_rt.v1 import group_pb2
from stampede_rt_supernode.core.commands import GroupOperation, GroupSuccess
from stampede_rt_supernode.core.groups.commands import (
    DeleteGroup,
    GroupDeleted,
    GroupOpened,
    GroupUpdated,
    OpenGroup,
    UpdateGroup,
)
from stampede_rt_supernode.core.records import Group, GroupSpec

_BOUNDS_FROM_WIRE = {
    group_pb2.GROUP_BOUND_UNSPECIFIED: "start",
    group_pb2.GROUP_BOUND_START: "start",
    group_pb2.GROUP_BOUND_END: "end",
}
_BOUNDS_TO_WIRE = {"start": group_pb2.GROUP_BOUND_START, "end": group_pb2.GROUP_BOUND_END}
_OLDEST = (group_pb2.GROUP_REFERENCE_UNSPECIFIED, group_pb2.GROUP_REFERENCE_OLDEST)

GROUP_OPERATIONS = ("open_group", "update_group", "delete_group")
GROUP_OUTCOMES = ("group_opened", "group_updated", "group_deleted")


def group_spec_from(spec: group_pb2.GroupSpec) -> GroupSpec:
    """Raises InvalidArgument for a reference or bound unknown to this version, or that contradict each other."""
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
    """The set-up as it travels; None leaves a field out."""
    by_channel = spec.reference_channel_id is not None
    return group_pb2.GroupSpec(
        channel_ids=spec.channel_ids,
        reference=group_pb2.GROUP_REFERENCE_CHANNEL if by_channel else group_pb2.GROUP_REFERENCE_OLDEST,
        reference_channel_id=spec.reference_channel_id or b"",
        bound=_BOUNDS_TO_WIRE[spec.bound],
        idle_after_nanos=spec.idle_after_nanos,
        max_lead_nanos=spec.max_lead_nanos,
    )


def group_record(group: Group) -> group_pb2.GroupRecord:
    """The group as it travels."""
    return group_pb2.GroupRecord(
        group_id=group.group_id,
        name=group.name,
        spec=group_spec_message(group.spec),
        spec_version=group.spec_version,
        incarnation=group.incarnation,
    )


def group_from(record: group_pb2.GroupRecord) -> Group:
    """The group of a record that this codec wrote."""
    return Group(
        group_id=record.group_id,
        name=record.name,
        spec=group_spec_from(record.spec),
        spec_version=record.spec_version,
        incarnation=record.incarnation,
    )


def group_entry(group: Group, witnesses: tuple[bytes, ...]) -> pb.GroupEntry:
    """The group as supernodes keep it."""
    return pb.GroupEntry(record=group_record(group), witness_host_ids=witnesses)


def group_entry_from(entry: pb.GroupEntry) -> tuple[Group, tuple[bytes, ...]]:
    """The group and its witnesses of an entry that this codec wrote."""
    return group_from(entry.record), tuple(entry.witness_host_ids)


def write_group_operation(message: pb.DirectoryCommand, operation: GroupOperation) -> None:
    """Into the command's oneof."""
    match operation:
        case OpenGroup():
            message.open_group.CopyFrom(_open_message(operation))
        case UpdateGroup():
            change = pb.UpdateGroupCommand(
                group_id=operation.group_id,
                add_channel_ids=operation.add_channel_ids,
                remove_channel_ids=operation.remove_channel_ids,
                spec_version=operation.spec_version,
            )
            message.update_group.CopyFrom(change)
        case DeleteGroup(group_id=group_id):
            message.delete_group.CopyFrom(pb.DeleteGroupCommand(group_id=group_id))


def _open_message(operation: OpenGroup) -> pb.OpenGroupCommand:
    return pb.OpenGroupCommand(
        name=operation.name,
        spec=None if operation.spec is None else group_spec_message(operation.spec),
        create=operation.create,
        new_group_id=operation.new_group_id,
        new_incarnation=operation.new_incarnation,
    )


def read_group_operation(message: pb.DirectoryCommand) -> GroupOperation:
    """Of a command whose kind is one of GROUP_OPERATIONS. Raises InvalidArgument."""
    if message.HasField("open_group"):
        return _read_open(message.open_group)
    if message.HasField("update_group"):
        change = message.update_group
        return UpdateGroup(
            group_id=change.group_id,
            add_channel_ids=tuple(change.add_channel_ids),
            remove_channel_ids=tuple(change.remove_channel_ids),
            spec_version=change.spec_version if change.HasField("spec_version") else None,
        )
    return DeleteGroup(group_id=message.delete_group.group_id)


def _read_open(message: pb.OpenGroupCommand) -> OpenGroup:
    return OpenGroup(
        name=message.name,
        spec=group_spec_from(message.spec) if message.HasField("spec") else None,
        create=message.create,
        new_group_id=message.new_group_id,
        new_incarnation=message.new_incarnation,
    )


def group_result_message(result: GroupSuccess) -> pb.DirectoryResult:
    """A result as it travels."""
    match result:
        case GroupOpened(group=group, created=created):
            return pb.DirectoryResult(group_opened=pb.GroupOpenedResult(group=group_record(group), created=created))
        case GroupUpdated(group=group):
            return pb.DirectoryResult(group_updated=pb.GroupUpdatedResult(group=group_record(group)))
        case GroupDeleted():
            return pb.DirectoryResult(group_deleted=pb.GroupDeletedResult())


def read_group_result(message: pb.DirectoryResult) -> GroupSuccess:
    """Of a result whose outcome is one of GROUP_OUTCOMES."""
    match message.WhichOneof("outcome"):
        case "group_opened":
            opened = message.group_opened
            return GroupOpened(group=group_from(opened.group), created=opened.created)
        case "group_updated":
            return GroupUpdated(group=group_from(message.group_updated.group))
        case "group_deleted":
            return GroupDeleted()
        case other:
            raise StampedeError(f"{other} is no result of a group; report this")
