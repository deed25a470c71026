"""Converts commands about channels, and their results, from and to messages of the log."""

from __future__ import annotations

from typing import Any

from stampede_rt.v1 import directory_command_pb2 as pb
from stampede_rt_supernode.codecs.host_codec import host_entry, host_from
from stampede_rt_supernode.codecs.kind_codec import KindCodec
from stampede_rt_supernode.codecs.record_codec import channel_from, channel_record, policy_from, spec_of
from stampede_rt_supernode.core.channels.commands import (
    ChannelDeleted,
    ChannelOpened,
    ChannelUpdated,
    DeleteChannel,
    OpenChannel,
    UpdateChannel,
)


def _open_message(operation: OpenChannel) -> pb.OpenChannelCommand:
    return pb.OpenChannelCommand(
        name=operation.name,
        spec=spec_of(operation.policy),
        create=operation.create,
        host_name=operation.host_name,
        beside=operation.beside,
        new_channel_id=operation.new_channel_id,
        new_incarnation=operation.new_incarnation,
        created_by=operation.created_by,
        created_max=operation.created_max,
        waited_for_index=operation.waited_for_index,
    )


def _read_open(message: pb.OpenChannelCommand) -> OpenChannel:
    return OpenChannel(
        name=message.name,
        policy=policy_from(message.spec),
        create=message.create,
        host_name=message.host_name,
        beside=message.beside,
        new_channel_id=message.new_channel_id,
        new_incarnation=message.new_incarnation,
        created_by=message.created_by,
        created_max=message.created_max if message.HasField("created_max") else None,
        waited_for_index=message.waited_for_index,
    )


def _update_message(operation: UpdateChannel) -> pb.UpdateChannelCommand:
    return pb.UpdateChannelCommand(
        channel_id=operation.channel_id, epoch=operation.epoch, spec=spec_of(operation.policy)
    )


def _read_update(message: pb.UpdateChannelCommand) -> UpdateChannel:
    return UpdateChannel(channel_id=message.channel_id, epoch=message.epoch, policy=policy_from(message.spec))


def _opened_message(result: ChannelOpened) -> pb.ChannelOpenedResult:
    return pb.ChannelOpenedResult(
        channel=channel_record(result.channel), host=host_entry(result.host), created=result.created
    )


def _read_opened(message: pb.ChannelOpenedResult) -> ChannelOpened:
    return ChannelOpened(channel=channel_from(message.channel), host=host_from(message.host), created=message.created)


def _deleted_message(deleted: ChannelDeleted) -> pb.ChannelDeletedResult:
    freed = None if deleted.freed_groups is None else pb.FreedGroups(names=deleted.freed_groups)
    return pb.ChannelDeletedResult(channel=channel_record(deleted.channel), freed_groups=freed)


def _read_deleted(message: pb.ChannelDeletedResult) -> ChannelDeleted:
    freed = tuple(message.freed_groups.names) if message.HasField("freed_groups") else None
    return ChannelDeleted(channel=channel_from(message.channel), freed_groups=freed)


CODECS: tuple[KindCodec[Any, Any, Any, Any], ...] = (
    KindCodec(
        kind="open_channel",
        outcome="channel_opened",
        operation=OpenChannel,
        result=ChannelOpened,
        write=_open_message,
        read=_read_open,
        write_result=_opened_message,
        read_result=_read_opened,
    ),
    KindCodec(
        kind="update_channel",
        outcome="channel_updated",
        operation=UpdateChannel,
        result=ChannelUpdated,
        write=_update_message,
        read=_read_update,
        write_result=lambda one: pb.ChannelUpdatedResult(channel=channel_record(one.channel)),
        read_result=lambda message: ChannelUpdated(channel=channel_from(message.channel)),
    ),
    KindCodec(
        kind="delete_channel",
        outcome="channel_deleted",
        operation=DeleteChannel,
        result=ChannelDeleted,
        write=lambda one: pb.DeleteChannelCommand(channel_id=one.channel_id),
        read=lambda message: DeleteChannel(channel_id=message.channel_id),
        write_result=_deleted_message,
        read_result=_read_deleted,
    ),
)
