"""The rows of replicas in the command table. Pure."""

from __future__ import annotations

from typing import Any

from stampede_rt_supernode.core.command_kinds import CommandKind, on_tables
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
    check_remove_replica,
    check_set_in_sync,
    remove_replica,
    set_in_sync,
)


def _channel_and_host(operation: AddReplica | RemoveReplica | SetReplicaInSync) -> str:
    return f"{operation.channel_id.hex()} {operation.host_id.hex()}"


KINDS: tuple[CommandKind[Any, Any], ...] = (
    CommandKind(
        operation=AddReplica,
        result=ReplicaAdded,
        feature_level=1,
        subject=_channel_and_host,
        check=check_add_replica,
        apply=on_tables(add_replica),
    ),
    CommandKind(
        operation=RemoveReplica,
        result=ReplicaRemoved,
        feature_level=1,
        subject=_channel_and_host,
        check=check_remove_replica,
        apply=on_tables(remove_replica),
    ),
    CommandKind(
        operation=SetReplicaInSync,
        result=ReplicaInSyncSet,
        feature_level=1,
        subject=_channel_and_host,
        check=check_set_in_sync,
        apply=on_tables(set_in_sync),
    ),
)
