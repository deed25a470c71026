"""Commands about copies of channels, and their results (paper, section 4.1). Pure values; see `core.commands`."""

from __future__ import annotations

from dataclasses import dataclass

from stampede_rt_supernode.core.commands import Operation, Success
from stampede_rt_supernode.core.records import HostRecord, ReplicaKind, ReplicaRecord


@dataclass(frozen=True, kw_only=True, slots=True)
class AddReplica(Operation):
    """Add a copy of a channel at a host. `epoch`: the channel's present epoch, as the caller knows it.

    If `host_id` is empty, the directory chooses the host. If `source_host_id` is empty, the owner feeds the copy.
    `acknowledged`, `is_of_queue`: see ReplicaRecord.
    """

    channel_id: bytes
    epoch: int
    host_id: bytes = b""
    kind: ReplicaKind
    source_host_id: bytes = b""
    acknowledged: bool = False
    is_of_queue: bool = False


@dataclass(frozen=True, kw_only=True, slots=True)
class RemoveReplica(Operation):
    """Remove the copy of a channel or queue at a host.

    `epoch`: the present epoch, as the caller knows it; 0: the directory does not compare it, and removes only
    a copy that is not in sync.
    """

    channel_id: bytes
    host_id: bytes
    epoch: int = 0
    is_of_queue: bool = False


@dataclass(frozen=True, kw_only=True, slots=True)
class SetReplicaInSync(Operation):
    """The owner at `epoch` reports whether a warm replica is in sync.

    `host_id` and `boot_incarnation` belong to the replica's host. `change_number` grows with each change.
    `added_index`: the log position at which the replica was added, as the owner knows it; 0: the directory does not
    compare it.
    """

    channel_id: bytes
    epoch: int
    host_id: bytes
    boot_incarnation: int
    in_sync: bool
    change_number: int = 0
    added_index: int = 0
    is_of_queue: bool = False


@dataclass(frozen=True, kw_only=True, slots=True)
class ReplicaAdded(Success):
    """The copy, and its host."""

    replica: ReplicaRecord
    host: HostRecord


@dataclass(frozen=True, kw_only=True, slots=True)
class ReplicaRemoved(Success):
    """The copy is gone."""


@dataclass(frozen=True, kw_only=True, slots=True)
class ReplicaInSyncSet(Success):
    """The copy after the change."""

    replica: ReplicaRecord
