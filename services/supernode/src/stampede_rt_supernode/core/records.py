"""The records of the directory (hosts, channels, groups, copies, queues and peers), and the changes of these records.

Pure, immutable values. The paper describes them in its sections 3.3 (groups), 3.5 (queues, peers), 4.1 (proxies)
and 4.3 (hosts, channels). Ids are 16 opaque bytes.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum

from stampede_rt.values.model import Policy

ID_BYTES = 16


@dataclass(frozen=True, kw_only=True, slots=True)
class Endpoint:
    """A gRPC target, and its zone; the zone is empty if none was named."""

    target: str
    zone: str = ""


@dataclass(frozen=True, kw_only=True, slots=True)
class HostLoad:
    """How busy a host is, see HostLoad in directory.proto.

    `owned`: the number of channels and queues that the host owned when the measurement began. `has_archive`: the host
    can record channels. `is_private`: the directory places nothing there unless a caller names the host. `machine`: the
    host's machine; empty if it is not known.
    """

    busy_permille: int = 0
    held_bytes: int = 0
    bytes_max: int = 0
    owned: int = 0
    has_archive: bool = False
    is_private: bool = False
    machine: str = ""


@dataclass(frozen=True, kw_only=True, slots=True)
class HostRecord:
    """A process that hosts channels.

    `name` is unique among live hosts. `boot_incarnation` is a random number. A host that registers with a new number
    has lost its items. `channels` is the number of channels that the host owns. `registered_index` is the log position
    of its last registration. A lease, and the entry that ends a lease, belong to one registration.
    `lease_ended_unix_nano`: for a lost host, when its lease ended, by the leader's clock; None for other hosts.
    `registration_epoch` grows with each process that replaces another, see `registration_epochs`. `load`: its load as
    the leader last noted it; None if the feature level has been below LOADS_LEVEL since the host registered.
    `move_key`: the key of its permits, see `move_permits`; empty if the host registered while the feature level was
    below MOVES_LEVEL. `archive_wait_nanos`: how long its recorded channels wait for it when it is unreachable.
    `archive_place`: where its archive is, for people.
    """

    host_id: bytes
    name: str
    gatekeepers: tuple[Endpoint, ...]
    boot_incarnation: int
    version: str
    alive: bool
    channels: int
    registered_index: int
    lease_ended_unix_nano: int | None = None
    registration_epoch: int = 0
    load: HostLoad | None = None
    move_key: bytes = field(default=b"", repr=False)
    archive_wait_nanos: int = 0
    archive_place: str = ""

    @property
    def is_lost(self) -> bool:
        """Whether the directory lists the host as lost, because its lease ended; see `expire_host`."""
        return self.lease_ended_unix_nano is not None

    @property
    def holder_id(self) -> bytes:
        """The id of this host, as the holder of a lease."""
        return self.host_id


@dataclass(frozen=True, kw_only=True, slots=True)
class ChannelRecord:
    """A channel and its owner. `epoch` never falls. `incarnation` changes only if items may have been lost.

    `policy_version` grows by 1 with every change of `policy`. `proxy_host_ids`: the hosts of all copies, in the order
    of addition; warm replicas are among them. `created_by`: the name by which rules of access know the caller that
    created it; empty if it is unknown. `first_incarnation`: the incarnation with which a recorded channel began; 0 if
    it is unknown.
    """

    channel_id: bytes
    name: str
    host_id: bytes
    epoch: int
    incarnation: int
    policy: Policy
    policy_version: int
    proxy_host_ids: tuple[bytes, ...] = ()
    created_by: str = ""
    first_incarnation: int = 0

    def after_restart(self, incarnation: int) -> ChannelRecord:
        """The record with the next epoch and with this incarnation. The host stays the same.

        The method calls the constructor, because a host may own very many channels, and `replace` takes three times as
        long.
        """
        return ChannelRecord(
            channel_id=self.channel_id,
            name=self.name,
            host_id=self.host_id,
            epoch=self.epoch + 1,
            incarnation=incarnation,
            policy=self.policy,
            policy_version=self.policy_version,
            proxy_host_ids=self.proxy_host_ids,
            created_by=self.created_by,
            first_incarnation=self.first_incarnation,
        )


@dataclass(frozen=True, kw_only=True, slots=True)
class GroupSpec:
    """The members and settings of a group (paper, section 3.3). A field is None if it was not stated.

    `channel_ids`: the members, each once, in any order. `reference_channel_id`: the member that is the reference; if it
    is None, the group has the smallest cut of all members. `bound`: "start" or "end". For the other fields see
    GroupSpec in group.proto.
    """

    channel_ids: tuple[bytes, ...]
    reference_channel_id: bytes | None = None
    bound: str = "start"
    idle_after_nanos: int | None = None
    max_lead_nanos: int | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class GroupRecord:
    """A group. `spec_version` grows by 1 with every change of `spec`. `incarnation` changes only if the cut was lost.

    The cut may then begin again at an earlier instant. `created_by`: as in ChannelRecord.
    """

    group_id: bytes
    name: str
    spec: GroupSpec
    spec_version: int
    incarnation: int
    created_by: str = ""


class ReplicaKind(Enum):
    """The purpose of a copy: a proxy only serves readers; the host of a warm replica may also become the owner.

    MOVE: the items of the former owner after a move, until the new owner acknowledges puts.
    """

    PROXY = "proxy"
    WARM = "warm"
    MOVE = "move"


@dataclass(frozen=True, kw_only=True, slots=True)
class ReplicaRecord:
    """A copy of a channel at `host_id`. The copy ends with that host's registration (paper, section 4.1).

    `is_of_queue`: it is a copy of a queue or mailbox, and `channel_id` is the id of that queue.

    `source_host_id`: the host that feeds the copy. `in_sync`: the copy holds all acknowledged items, so its host may
    become the owner; only warm replicas can be in sync. `acknowledged`: puts wait for the copy while it is in sync.
    `epoch`: the epoch of the channel when this copy was added or last changed. `change_number`: the owner's number of
    its last change of `in_sync` in this epoch; 0: there was none. `added_index`: the log position at which this copy
    was added; 0: unknown.
    """

    channel_id: bytes
    host_id: bytes
    boot_incarnation: int
    kind: ReplicaKind
    source_host_id: bytes
    in_sync: bool = False
    acknowledged: bool = False
    epoch: int
    change_number: int = 0
    added_index: int = 0
    is_of_queue: bool = False


@dataclass(frozen=True, kw_only=True, slots=True)
class QueueSpec:
    """The policy of a queue (paper, section 3.5). A field is None if it was not stated.

    `on_full`: "block", "reject" or "drop_oldest". `ack`: "host" or "replica".
    """

    max_items: int | None = None
    max_bytes: int | None = None
    on_full: str | None = None
    copies: int | None = None
    lease_nanos: int | None = None
    max_deliveries: int | None = None
    dead_letter_queue_id: bytes | None = None
    content_type: str | None = None
    max_item_bytes: int | None = None
    replicas: int | None = None
    ack: str | None = None
    min_replicas: int | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class QueueRecord:
    """A queue and its host. If `mailbox_peer_id` is set, the queue is the mailbox of that peer, and its name is empty.

    `mailbox_peer_name` and `mailbox_owner` are `name` and `owner` of that peer, if it registered at feature level 2 or
    above. `epoch` never falls. `incarnation` changes only if messages may have been lost. `created_by`: as in
    ChannelRecord; empty for a mailbox.
    """

    queue_id: bytes
    name: str
    host_id: bytes
    epoch: int
    incarnation: int
    spec: QueueSpec
    spec_version: int
    mailbox_peer_id: bytes | None = None
    mailbox_peer_name: str = ""
    mailbox_owner: str | None = None
    created_by: str = ""


@dataclass(frozen=True, kw_only=True, slots=True)
class PeerRecord:
    """A peer (paper, sections 3.5 and 4.2).

    A peer may have a name, which is unique among live peers; it then has a mailbox while it is alive. `host_id`: if the
    peer is a host, its id as a host; otherwise None. `owner`: the name by which rules of access know the caller that
    registered the peer; empty if rules do not limit that caller; None if it is unknown. `proof_sha256` is empty if the
    peer gave no proof. `registered_index`, `registration_epoch`: as in HostRecord. `ended_index`: the log position at
    which the peer's lease ended; 0 while it is alive. `created_by`: as in ChannelRecord; quotas count the peer under
    this name.
    """

    peer_id: bytes
    name: str
    boot_incarnation: int
    mailbox_queue_id: bytes | None = None
    host_id: bytes | None = None
    zone: str = ""
    version: str = ""
    attributes: tuple[tuple[str, str], ...] = ()  # ascending by key
    registered_unix_nano: int
    proof_sha256: bytes = b""
    registered_index: int
    ended_index: int = 0
    owner: str | None = None
    registration_epoch: int = 0
    created_by: str = ""

    @property
    def alive(self) -> bool:
        """Whether its lease has not ended."""
        return self.ended_index == 0

    @property
    def holder_id(self) -> bytes:
        """The id of this peer, as the holder of a lease."""
        return self.peer_id


class ChangeKind(Enum):
    """The effect of a change on its subject."""

    ADDED = "added"
    UPDATED = "updated"
    REMOVED = "removed"


@dataclass(frozen=True, kw_only=True, slots=True)
class AccessChange:
    """Rules, token keys, revocations or quotas have changed, at log position `version`. The change has only that."""

    version: int


@dataclass(frozen=True, kw_only=True, slots=True)
class DirectoryChange:
    """One change, at one log position.

    `subject`: the record of the changed thing after the change, or its last record if it was removed.
    """

    index: int
    kind: ChangeKind
    subject: ChannelRecord | HostRecord | GroupRecord | QueueRecord | PeerRecord | AccessChange
