"""What can be done to the directory, and what comes of it. Pure, immutable values.

All that is random or read from a clock is stamped into a command by its proposer, so that every replica computes the
same from it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TypeAlias

from stampede_rt.errors import StampedeError, error_for
from stampede_rt_supernode.core.channels.commands import (
    ChannelDeleted,
    ChannelOpened,
    ChannelUpdated,
    DeleteChannel,
    OpenChannel,
    UpdateChannel,
)
from stampede_rt_supernode.core.cluster.commands import BeginTenure, MarkTime, TenureBegun, TimeMarked
from stampede_rt_supernode.core.groups.commands import (
    DeleteGroup,
    GroupDeleted,
    GroupOpened,
    GroupUpdated,
    OpenGroup,
    UpdateGroup,
)
from stampede_rt_supernode.core.hosts.commands import (
    DeregisterHost,
    ExpireHost,
    HostDeregistered,
    HostExpired,
    HostRegistered,
    RegisterHost,
)
from stampede_rt_supernode.core.peers.commands import (
    DeregisterPeer,
    ExpirePeers,
    PeerDeregistered,
    PeerRegistered,
    PeersExpired,
    RegisterPeer,
)
from stampede_rt_supernode.core.queues.commands import (
    DeleteQueue,
    OpenQueue,
    QueueDeleted,
    QueueOpened,
    QueueUpdated,
    UpdateQueue,
)
from stampede_rt_supernode.core.replicas.commands import (
    AddReplica,
    RemoveReplica,
    ReplicaAdded,
    ReplicaInSyncSet,
    ReplicaRemoved,
    SetReplicaInSync,
)

ChannelOperation: TypeAlias = OpenChannel | UpdateChannel | DeleteChannel
HostOperation: TypeAlias = RegisterHost | DeregisterHost | ExpireHost | BeginTenure | MarkTime
GroupOperation: TypeAlias = OpenGroup | UpdateGroup | DeleteGroup
ReplicaOperation: TypeAlias = AddReplica | RemoveReplica | SetReplicaInSync
QueueOperation: TypeAlias = OpenQueue | UpdateQueue | DeleteQueue
PeerOperation: TypeAlias = RegisterPeer | DeregisterPeer | ExpirePeers
Operation: TypeAlias = (
    ChannelOperation | HostOperation | GroupOperation | ReplicaOperation | QueueOperation | PeerOperation
)


@dataclass(frozen=True, kw_only=True, slots=True)
class Command:
    """One entry of the log. Repeating `op_id` repeats the result; `time_unix_nano` is for whoever reads the log.

    `as_of_index`: how far the proposer's state reached when the request came; 0: not told.
    """

    op_id: bytes
    time_unix_nano: int
    operation: Operation
    as_of_index: int = 0


def subject_of(operation: Operation) -> str:
    """What an operation is about, kind and thing: an operation id that comes back with another subject is a mistake."""
    kind = type(operation).__name__
    match operation:
        case OpenChannel(name=name) | OpenGroup(name=name) | OpenQueue(name=name):
            return f"{kind} {name}"
        case UpdateChannel(channel_id=thing) | DeleteChannel(channel_id=thing):
            return f"{kind} {thing.hex()}"
        case RegisterHost(host_id=thing) | DeregisterHost(host_id=thing) | ExpireHost(host_id=thing):
            return f"{kind} {thing.hex()}"
        case BeginTenure(tenure=tenure) | MarkTime(tenure=tenure):
            return f"{kind} {tenure}"
        case UpdateGroup(group_id=thing) | DeleteGroup(group_id=thing):
            return f"{kind} {thing.hex()}"
        case AddReplica() | RemoveReplica() | SetReplicaInSync():
            return f"{kind} {operation.channel_id.hex()} {operation.host_id.hex()}"
        case UpdateQueue(queue_id=thing) | DeleteQueue(queue_id=thing):
            return f"{kind} {thing.hex()}"
        case RegisterPeer(peer_id=thing) | DeregisterPeer(peer_id=thing):
            return f"{kind} {thing.hex()}"
        case ExpirePeers(leases=leases, tenure=tenure):
            return f"{kind} {tenure} {len(leases)}"


@dataclass(frozen=True, kw_only=True, slots=True)
class Refused:
    """Nothing was changed, and why: the particulars of a StampedeError."""

    reason: str
    message: str
    metadata: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))

    @classmethod
    def because(cls, error: StampedeError) -> Refused:
        """The refusal that `error` stands for."""
        return cls(reason=error.reason, message=error.message, metadata=MappingProxyType(error.metadata))

    def error(self) -> StampedeError:
        """The exception to raise to the caller."""
        return error_for(self.reason, self.message, self.metadata)


GroupSuccess: TypeAlias = GroupOpened | GroupUpdated | GroupDeleted
ReplicaSuccess: TypeAlias = ReplicaAdded | ReplicaRemoved | ReplicaInSyncSet
QueueSuccess: TypeAlias = QueueOpened | QueueUpdated | QueueDeleted
PeerSuccess: TypeAlias = PeerRegistered | PeerDeregistered | PeersExpired
Success: TypeAlias = (
    ChannelOpened
    | ChannelUpdated
    | ChannelDeleted
    | HostRegistered
    | HostDeregistered
    | HostExpired
    | TenureBegun
    | TimeMarked
    | GroupSuccess
    | ReplicaSuccess
    | QueueSuccess
    | PeerSuccess
)
Result: TypeAlias = Refused | Success
