"""Commands about peers, and their results (paper, sections 3.5 and 4.2). Pure values; see `core.commands`."""

from __future__ import annotations

from dataclasses import dataclass

from stampede_rt_supernode.core.commands import Creation, Operation, Success
from stampede_rt_supernode.core.records import HostRecord, PeerRecord, QueueRecord, QueueSpec


@dataclass(frozen=True, kw_only=True, slots=True)
class RegisterPeer(Creation):
    """A peer registers.

    `proof_sha256` is empty if the peer gave no proof. `mailbox` is None if the peer states no settings of its mailbox.
    The `new_` fields are used if a mailbox is created or moves. `registration_epoch`: see `registration_epochs`.
    `owner`: see PeerRecord.
    """

    peer_id: bytes
    name: str = ""
    boot_incarnation: int
    proof_sha256: bytes = b""
    mailbox: QueueSpec | None = None
    mailbox_host_name: str = ""
    host_id: bytes | None = None
    zone: str = ""
    version: str = ""
    attributes: tuple[tuple[str, str], ...] = ()  # ascending by key
    new_mailbox_id: bytes
    new_incarnation: int
    registration_epoch: int = 0
    owner: str | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class DeregisterPeer(Operation):
    """A peer ends its own registration."""

    peer_id: bytes
    boot_incarnation: int


@dataclass(frozen=True, kw_only=True, slots=True)
class PeerLease:
    """The lease of one registration of a peer."""

    peer_id: bytes
    boot_incarnation: int
    registered_index: int


@dataclass(frozen=True, kw_only=True, slots=True)
class ExpirePeers(Operation):
    """The leader of `tenure` notes that these leases have ended."""

    leases: tuple[PeerLease, ...]
    tenure: int


@dataclass(frozen=True, kw_only=True, slots=True)
class PeerRegistered(Success):
    """The peer is registered.

    `mailbox` and `mailbox_host` are None if the peer has no name. `mailbox_kept`: the mailbox has kept its former
    messages.
    """

    peer: PeerRecord
    mailbox: QueueRecord | None
    mailbox_host: HostRecord | None
    mailbox_kept: bool
    cluster_id: str


@dataclass(frozen=True, kw_only=True, slots=True)
class PeerDeregistered(Success):
    """The peer is deregistered."""


@dataclass(frozen=True, kw_only=True, slots=True)
class PeersExpired(Success):
    """The number of leases that the command ended. The others had ended before, or their peers had registered again."""

    expired: int
