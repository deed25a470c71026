"""Converts commands about groups, and their results, from and to messages of the log."""

from __future__ import annotations

from typing import Any

from stampede_rt.v1 import directory_command_pb2 as pb
from stampede_rt_supernode.codecs.group_codec import group_from, group_record, group_spec_from, group_spec_message
from stampede_rt_supernode.codecs.kind_codec import KindCodec
from stampede_rt_supernode.core.groups.commands import (
    DeleteGroup,
    GroupDeleted,
    GroupOpened,
    GroupUpdated,
    OpenGroup,
    UpdateGroup,
)


def _open_message(operation: OpenGroup) -> pb.OpenGroupCommand:
    return pb.OpenGroupCommand(
        name=operation.name,
        spec=None if operation.spec is None else group_spec_message(operation.spec),
        create=operation.create,
        new_group_id=operation.new_group_id,
        new_incarnation=operation.new_incarnation,
        created_by=operation.created_by,
        created_max=operation.created_max,
    )


def _read_open(message: pb.OpenGroupCommand) -> OpenGroup:
    return OpenGroup(
        name=message.name,
        spec=group_spec_from(message.spec) if message.HasField("spec") else None,
        create=message.create,
        new_group_id=message.new_group_id,
        new_incarnation=message.new_incarnation,
        created_by=message.created_by,
        created_max=message.created_max if message.HasField("created_max") else None,
    )


def _update_message(operation: UpdateGroup) -> pb.UpdateGroupCommand:
    return pb.UpdateGroupCommand(
        group_id=operation.group_id,
        add_channel_ids=operation.add_channel_ids,
        remove_channel_ids=operation.remove_channel_ids,
        spec_version=operation.spec_version,
    )


def _read_update(message: pb.UpdateGroupCommand) -> UpdateGroup:
    return UpdateGroup(
        group_id=message.group_id,
        add_channel_ids=tuple(message.add_channel_ids),
        remove_channel_ids=tuple(message.remove_channel_ids),
        spec_version=message.spec_version if message.HasField("spec_version") else None,
    )


def _opened_message(result: GroupOpened) -> pb.GroupOpenedResult:
    return pb.GroupOpenedResult(group=group_record(result.group), created=result.created)


def _read_opened(message: pb.GroupOpenedResult) -> GroupOpened:
    return GroupOpened(group=group_from(message.group), created=message.created)


CODECS: tuple[KindCodec[Any, Any, Any, Any], ...] = (
    KindCodec(
        kind="open_group",
        outcome="group_opened",
        operation=OpenGroup,
        result=GroupOpened,
        write=_open_message,
        read=_read_open,
        write_result=_opened_message,
        read_result=_read_opened,
    ),
    KindCodec(
        kind="update_group",
        outcome="group_updated",
        operation=UpdateGroup,
        result=GroupUpdated,
        write=_update_message,
        read=_read_update,
        write_result=lambda one: pb.GroupUpdatedResult(group=group_record(one.group)),
        read_result=lambda message: GroupUpdated(group=group_from(message.group)),
    ),
    KindCodec(
        kind="delete_group",
        outcome="group_deleted",
        operation=DeleteGroup,
        result=GroupDeleted,
        write=lambda one: pb.DeleteGroupCommand(group_id=one.group_id),
        read=lambda message: DeleteGroup(group_id=message.group_id),
        write_result=lambda one: pb.GroupDeletedResult(name=one.name),
        read_result=lambda message: GroupDeleted(name=message.name),
    ),
)
