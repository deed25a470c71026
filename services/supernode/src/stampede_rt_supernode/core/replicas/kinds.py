"""The rows of replicas in the command table. Pure."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from stampede_rt_supernode.core.cluster.feature_levels import CALLERS_FACTS_LEVEL
from stampede_rt_supernode.core.command_kinds import CommandKind
from stampede_rt_supernode.core.replicas.commands import (
    AddReplica,
    RemoveReplica,
    ReplicaAdded,
    ReplicaInSyncSet,
    ReplicaRemoved,
    SetReplicaInSync,
)
from stampede_rt_supernode.core.replicas.transitions import (
    add_replica,
    check_add_replica,
    check_agrees_with_policy,
    check_remove_replica,
    check_set_in_sync,
    is_left_to_owner,
    remove_replica,
    set_in_sync,
)
from stampede_rt_supernode.core.state import DirectoryState


def _channel_and_host(operation: AddReplica | RemoveReplica | SetReplicaInSync) -> str:
    return f"{operation.channel_id.hex()} {operation.host_id.hex()}"


def _add(state: DirectoryState, operation: AddReplica, time_unix_nano: int) -> ReplicaAdded:
    if state.feature_level < CALLERS_FACTS_LEVEL:
        return add_replica(state.tables, operation, added_index=0)
    check_agrees_with_policy(state.tables, operation)
    return add_replica(state.tables, operation, added_index=state.tables.index)


def _remove(state: DirectoryState, operation: RemoveReplica, time_unix_nano: int) -> ReplicaRemoved:
    if state.feature_level < CALLERS_FACTS_LEVEL:
        operation = replace(operation, epoch=0)
    elif is_left_to_owner(state.tables, operation):
        return ReplicaRemoved()
    return remove_replica(state.tables, operation)


def _set_in_sync(state: DirectoryState, operation: SetReplicaInSync, time_unix_nano: int) -> ReplicaInSyncSet:
    if state.feature_level < CALLERS_FACTS_LEVEL:
        operation = replace(operation, added_index=0)
    return set_in_sync(state.tables, operation)


KINDS: tuple[CommandKind[Any, Any], ...] = (
    CommandKind(
        operation=AddReplica,
        result=ReplicaAdded,
        feature_level=1,
        subject=_channel_and_host,
        check=check_add_replica,
        apply=_add,
    ),
    CommandKind(
        operation=RemoveReplica,
        result=ReplicaRemoved,
        feature_level=1,
        subject=_channel_and_host,
        check=check_remove_replica,
        apply=_remove,
    ),
    CommandKind(
        operation=SetReplicaInSync,
        result=ReplicaInSyncSet,
        feature_level=1,
        subject=_channel_and_host,
        check=check_set_in_sync,
        apply=_set_in_sync,
    ),
)
