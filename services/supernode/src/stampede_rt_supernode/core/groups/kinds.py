"""The rows of groups in the command table. Pure."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from stampede_rt_supernode.core import delayed_opens
from stampede_rt_supernode.core.channels.commands import ChannelDeleted
from stampede_rt_supernode.core.cluster.feature_levels import (
    FREED_GROUPS_LEVEL,
    GROUPS_AND_PEERS_LEVEL,
    OWNERS_LEVEL,
)
from stampede_rt_supernode.core.command_kinds import CommandKind
from stampede_rt_supernode.core.commands import Success
from stampede_rt_supernode.core.groups.commands import (
    DeleteGroup,
    GroupDeleted,
    GroupOpened,
    GroupUpdated,
    OpenGroup,
    UpdateGroup,
)
from stampede_rt_supernode.core.groups.transitions import (
    check_open_group,
    check_update_group,
    delete_group,
    open_group,
    update_group,
)
from stampede_rt_supernode.core.state import DirectoryState
from stampede_rt_supernode.core.validation import check_id


def _check_open_not_late(state: DirectoryState, operation: OpenGroup, as_of_index: int) -> None:
    if state.tables.groups.named(operation.name) is None:
        delayed_opens.check_not_late(
            state.kept_answers,
            ("group", operation.name),
            as_of_index,
            lambda done: _frees(done, operation.name),
        )


def _frees(done: Success, name: str) -> bool:
    """Whether a result means that the group of that name was deleted. A result that names no groups may mean any."""
    if isinstance(done, GroupDeleted):
        return done.name in ("", name)
    return isinstance(done, ChannelDeleted) and (done.freed_groups is None or name in done.freed_groups)


def _open(state: DirectoryState, operation: OpenGroup, time_unix_nano: int) -> GroupOpened:
    has_limits = state.feature_level >= GROUPS_AND_PEERS_LEVEL
    if state.feature_level < OWNERS_LEVEL:
        operation = replace(operation, created_by="")
    if not has_limits:
        operation = replace(operation, created_max=None)
    return open_group(state.tables, operation, has_shares=has_limits)


def _update(state: DirectoryState, operation: UpdateGroup, time_unix_nano: int) -> GroupUpdated:
    return update_group(state.tables, operation, has_shares=state.feature_level >= GROUPS_AND_PEERS_LEVEL)


def _delete(state: DirectoryState, operation: DeleteGroup, time_unix_nano: int) -> GroupDeleted:
    deleted = delete_group(state.tables, operation)
    return deleted if state.feature_level >= FREED_GROUPS_LEVEL else GroupDeleted()


KINDS: tuple[CommandKind[Any, Any], ...] = (
    CommandKind(
        operation=OpenGroup,
        result=GroupOpened,
        feature_level=1,
        subject=lambda one: one.name,
        check=check_open_group,
        check_not_late=_check_open_not_late,
        apply=_open,
    ),
    CommandKind(
        operation=UpdateGroup,
        result=GroupUpdated,
        feature_level=1,
        subject=lambda one: one.group_id.hex(),
        check=check_update_group,
        apply=_update,
    ),
    CommandKind(
        operation=DeleteGroup,
        result=GroupDeleted,
        feature_level=1,
        subject=lambda one: one.group_id.hex(),
        check=lambda one: check_id(one.group_id, "group_id"),
        apply=_delete,
    ),
)
