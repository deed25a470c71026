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
from stampede_rt.values.model import Policy
from stampede_rt_supernode.core.groups.commands import (
    DeleteGroup,
    GroupDeleted,
    GroupOpened,
    GroupUpdated,
    OpenGroup,
    UpdateGroup,
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
from stampede_rt_supernode.core.records import Channel, Endpoint, Host
from stampede_rt_supernode.core.replicas.commands import (
    AddReplica,
    RemoveReplica,
    ReplicaAdded,
    ReplicaInSyncSet,
    ReplicaRemoved,
    SetReplicaInSync,
)


@dataclass(frozen=True, kw_only=True, slots=True)
class OpenChannel:
    """Get or create a channel; `new_channel_id` and `new_incarnation` are used if it is made or placed anew."""

    name: str
    policy: Policy = field(default_factory=Policy)
    create: bool = True
    host_name: str = ""
    new_channel_id: bytes
    new_incarnation: int


@dataclass(frozen=True, kw_only=True, slots=True)
class UpdateChannel:
    """Change the stated fields of a channel's set-up."""

    channel_id: bytes
    epoch: int
    policy: Policy


@dataclass(frozen=True, kw_only=True, slots=True)
class DeleteChannel:
    """Forget a channel."""

    channel_id: bytes


@dataclass(frozen=True, kw_only=True, slots=True)
class RegisterHost:
    """A host enters; `new_incarnation` is what its channels get if its boot incarnation is a new one."""

    host_id: bytes
    name: str
    gatekeepers: tuple[Endpoint, ...]
    boot_incarnation: int
    version: str = ""
    new_incarnation: int


@dataclass(frozen=True, kw_only=True, slots=True)
class DeregisterHost:
    """A host leaves of its own accord."""

    host_id: bytes
    boot_incarnation: int


@dataclass(frozen=True, kw_only=True, slots=True)
class ExpireHost:
    """The lease of one registration has ended, says the leader of `tenure`."""

    host_id: bytes
    boot_incarnation: int
    registered_index: int
    tenure: int


@dataclass(frozen=True, kw_only=True, slots=True)
class BeginTenure:
    """A new leader takes over the leases; the first one of all founds the cluster: it gives it its id and its TTL.

    `founded_anew`: by restoring, so that the id is to replace that of the former cluster; `takes_over`: whose hosts may
    go over to this one.
    """

    tenure: int
    supernode_id: str
    new_cluster_id: str
    new_lease_ttl_nanos: int
    founded_anew: bool = False
    takes_over: bool = False


@dataclass(frozen=True, kw_only=True, slots=True)
class MarkTime:
    """Some time has passed since the last mark, says the leader of `tenure`, which was at `after_index`; see
    `answered`."""

    tenure: int
    after_index: int


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


@dataclass(frozen=True, kw_only=True, slots=True)
class ChannelOpened:
    """The channel and its owner; `created` by this very command."""

    channel: Channel
    host: Host
    created: bool


@dataclass(frozen=True, kw_only=True, slots=True)
class ChannelUpdated:
    """The channel after the change."""

    channel: Channel


@dataclass(frozen=True, kw_only=True, slots=True)
class ChannelDeleted:
    """The channel as it was last."""

    channel: Channel


@dataclass(frozen=True, kw_only=True, slots=True)
class HostRegistered:
    """The host is in."""

    host: Host
    cluster_id: str


@dataclass(frozen=True, kw_only=True, slots=True)
class HostDeregistered:
    """The host has left."""


@dataclass(frozen=True, kw_only=True, slots=True)
class HostExpired:
    """Whether the command ended a lease; False: it came too late and changed nothing."""

    expired: bool


@dataclass(frozen=True, kw_only=True, slots=True)
class TenureBegun:
    """The tenure now in force, and the cluster's id."""

    tenure: int
    cluster_id: str


@dataclass(frozen=True, kw_only=True, slots=True)
class TimeMarked:
    """Whether the mark counts; False: another leader's, or a repeated one."""

    marked: bool


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
