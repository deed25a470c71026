"""The rows of channels in the command table. Pure."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from stampede_rt_supernode.core import delayed_opens
from stampede_rt_supernode.core.channels.commands import (
    ChannelDeleted,
    ChannelOpened,
    ChannelUpdated,
    DeleteChannel,
    OpenChannel,
    UpdateChannel,
)
from stampede_rt_supernode.core.channels.transitions import (
    check_open,
    check_update,
    delete_channel,
    open_channel,
    update_channel,
)
from stampede_rt_supernode.core.cluster.feature_levels import FREED_GROUPS_LEVEL, LOADS_LEVEL
from stampede_rt_supernode.core.command_kinds import CommandKind, on_tables, on_tables_with_creator
from stampede_rt_supernode.core.state import DirectoryState
from stampede_rt_supernode.core.validation import check_id


def _check_open_not_late(state: DirectoryState, operation: OpenChannel, as_of_index: int) -> None:
    if state.tables.channel_named(operation.name) is None:
        delayed_opens.check_not_late(
            state.kept_answers,
            ("channel", operation.name),
            as_of_index,
            lambda done: isinstance(done, ChannelDeleted) and done.channel.name == operation.name,
        )


_open_with_creator = on_tables_with_creator(open_channel)


def _open(state: DirectoryState, operation: OpenChannel, time_unix_nano: int) -> ChannelOpened:
    if state.feature_level < LOADS_LEVEL:
        operation = replace(operation, beside="")
    return _open_with_creator(state, operation, time_unix_nano)


def _delete(state: DirectoryState, operation: DeleteChannel, time_unix_nano: int) -> ChannelDeleted:
    deleted = delete_channel(state.tables, operation)
    return deleted if state.feature_level >= FREED_GROUPS_LEVEL else replace(deleted, freed_groups=None)


KINDS: tuple[CommandKind[Any, Any], ...] = (
    CommandKind(
        operation=OpenChannel,
        result=ChannelOpened,
        feature_level=1,
        subject=lambda one: one.name,
        check=check_open,
        check_not_late=_check_open_not_late,
        apply=_open,
    ),
    CommandKind(
        operation=UpdateChannel,
        result=ChannelUpdated,
        feature_level=1,
        subject=lambda one: one.channel_id.hex(),
        check=check_update,
        apply=on_tables(update_channel),
    ),
    CommandKind(
        operation=DeleteChannel,
        result=ChannelDeleted,
        feature_level=1,
        subject=lambda one: one.channel_id.hex(),
        check=lambda one: check_id(one.channel_id, "channel_id"),
        apply=_delete,
    ),
)
