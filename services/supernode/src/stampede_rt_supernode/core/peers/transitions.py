"""Registers, deregisters and expires peers in the tables (paper, sections 3.5 and 4.2). Pure.

As in `channels.transitions`, a function either raises a StampedeError without any change, or succeeds. A named peer has
a mailbox from the step that registers the peer to the step that ends its registration.
"""

from __future__ import annotations

from dataclasses import replace
from operator import attrgetter

from stampede_rt.errors import LeaseExpired, Overloaded
from stampede_rt_supernode.core.lookups import host_by_id
from stampede_rt_supernode.core.peers.checks import check_may_follow, check_register_peer
from stampede_rt_supernode.core.peers.commands import (
    DeregisterPeer,
    ExpirePeers,
    PeerLease,
    PeerRegistered,
    RegisterPeer,
)
from stampede_rt_supernode.core.queues.placement import choose_host, give_queue, with_new_incarnation
from stampede_rt_supernode.core.queues.specs import MAILBOX_UNSTATED, check_replicas, merge
from stampede_rt_supernode.core.queues.transitions import check_dead_letter, check_room
from stampede_rt_supernode.core.records import PeerRecord, QueueRecord, QueueSpec
from stampede_rt_supernode.core.registration_epochs import next_epoch
from stampede_rt_supernode.core.tables import Tables
from stampede_rt_supernode.core.validation import check_id

PEERS_MAX = 100_000  # counts live peers only


def register_peer(tables: Tables, operation: RegisterPeer, now_unix_nano: int, cluster_id: str) -> PeerRegistered:
    """Register a peer, perhaps again.

    A caller that proves to be the holder of the name takes over the name and mailbox.
    """
    check_register_peer(operation)
    holder = tables.peers.live_named(operation.name) if operation.name else None
    replaced = _replaced(tables, operation, holder)
    epoch = next_epoch(operation, [tables.peers.by_id.get(operation.peer_id), holder])
    if operation.host_id is not None:
        host_by_id(tables, operation.host_id)
    _check_peers_room(tables, operation, replaced)
    former = _mailbox_of(tables, holder) if holder is not None else None
    mailbox = _planned_mailbox(tables, operation, former) if operation.name else None
    for before in replaced:
        _clear_away(tables, before, operation.peer_id, kept=mailbox)
    if mailbox is not None and former is not None:
        give_queue(tables, former, mailbox)
    elif mailbox is not None:
        tables.put_queue(mailbox)
    peer = replace(_peer(tables, operation, mailbox, now_unix_nano), registration_epoch=epoch)
    tables.peers.put(peer, tables.index)
    return PeerRegistered(
        peer=peer,
        mailbox=mailbox,
        mailbox_host=None if mailbox is None else tables.hosts[mailbox.host_id],
        mailbox_kept=mailbox is not None and former is not None and mailbox.incarnation == former.incarnation,
        cluster_id=cluster_id,
    )


def _check_peers_room(tables: Tables, operation: RegisterPeer, replaced: list[PeerRecord]) -> None:
    """Check the limits of live peers: the caller's and the directory's. Raises Overloaded."""
    if all(one.created_by != operation.created_by for one in replaced):
        tables.peers.creators.check(operation, "peers", created="registered", way_out="let some leave")
    if not replaced and tables.peers.live_count >= PEERS_MAX:
        shown = operation.name or operation.peer_id.hex()
        text = f"peer {shown} cannot register: {PEERS_MAX} peers are registered, the limit; wait until one leaves"
        raise Overloaded(text, metadata={"peer": operation.name})


def _replaced(tables: Tables, operation: RegisterPeer, holder: PeerRecord | None) -> list[PeerRecord]:
    """The live peers that the registration replaces: the peer with its id, and the peer with its name.

    Raises PEER_EXISTS.
    """
    same_id = tables.peers.by_id.get(operation.peer_id)
    found = {one.peer_id: one for one in (same_id, holder) if one is not None and one.alive}
    for before in found.values():
        check_may_follow(before, operation)
    return list(found.values())


def _mailbox_of(tables: Tables, peer: PeerRecord) -> QueueRecord | None:
    return None if peer.mailbox_queue_id is None else tables.queues.by_id[peer.mailbox_queue_id]


def _planned_mailbox(tables: Tables, operation: RegisterPeer, former: QueueRecord | None) -> QueueRecord:
    """The mailbox after the registration. An existing mailbox stays at its host, if that host is alive."""
    shown = f"the mailbox of peer {operation.name}"
    if former is None:
        check_room(tables, shown)
        spec = MAILBOX_UNSTATED if operation.mailbox is None else operation.mailbox
        check_dead_letter(tables, operation.new_mailbox_id, f"of peer {operation.name}", spec)
        check_replicas(f"of peer {operation.name}", spec)
        return _new_mailbox(operation, spec, choose_host(tables, shown, operation.mailbox_host_name).host_id)
    spec = merge(former.spec, operation.mailbox or QueueSpec())
    if spec != former.spec:
        check_dead_letter(tables, former.queue_id, f"of peer {operation.name}", spec)
        check_replicas(f"of peer {operation.name}", spec)
    version = former.spec_version + (spec != former.spec)
    mailbox = replace(former, spec=spec, spec_version=version, mailbox_peer_id=operation.peer_id)
    if operation.owner is not None:
        mailbox = replace(mailbox, mailbox_peer_name=operation.name, mailbox_owner=operation.owner)
    if tables.hosts[former.host_id].alive:
        return mailbox
    host = choose_host(tables, shown, operation.mailbox_host_name, tables.hosts[former.host_id].name)
    return with_new_incarnation(mailbox, host, operation.new_incarnation)


def _new_mailbox(operation: RegisterPeer, spec: QueueSpec, host_id: bytes) -> QueueRecord:
    return QueueRecord(
        queue_id=operation.new_mailbox_id,
        name="",
        host_id=host_id,
        epoch=1,
        incarnation=operation.new_incarnation,
        spec=spec,
        spec_version=1,
        mailbox_peer_id=operation.peer_id,
        mailbox_peer_name="" if operation.owner is None else operation.name,
        mailbox_owner=operation.owner,
    )


def _clear_away(tables: Tables, before: PeerRecord, peer_id: bytes, *, kept: QueueRecord | None) -> None:
    """Remove the mailbox and the record of a replaced peer.

    The mailbox stays if it is `kept`, and the record if it has `peer_id`, the id of the new peer.
    """
    mailbox = _mailbox_of(tables, before)
    if mailbox is not None and (kept is None or mailbox.queue_id != kept.queue_id):
        tables.remove_queue(mailbox)
    if before.peer_id != peer_id:
        tables.peers.remove(before, tables.index)


def _peer(tables: Tables, operation: RegisterPeer, mailbox: QueueRecord | None, now_unix_nano: int) -> PeerRecord:
    return PeerRecord(
        peer_id=operation.peer_id,
        name=operation.name,
        boot_incarnation=operation.boot_incarnation,
        mailbox_queue_id=None if mailbox is None else mailbox.queue_id,
        host_id=operation.host_id,
        zone=operation.zone,
        version=operation.version,
        attributes=operation.attributes,
        registered_unix_nano=now_unix_nano,
        proof_sha256=operation.proof_sha256,
        registered_index=tables.index,
        owner=operation.owner,
        created_by=operation.created_by,
    )


def deregister_peer(tables: Tables, operation: DeregisterPeer) -> None:
    """Deregister a peer, delete its mailbox, and free its name. Does nothing if the peer is not registered.

    Raises LeaseExpired for another boot incarnation.
    """
    check_id(operation.peer_id, "peer_id")
    peer = tables.peers.by_id.get(operation.peer_id)
    if peer is None or not peer.alive:
        return
    check_peer_boot(peer, operation.boot_incarnation)
    _drop_mailbox(tables, peer)
    tables.peers.remove(peer, tables.index)


def check_peer_boot(peer: PeerRecord, boot_incarnation: int) -> None:
    """Raises LeaseExpired if another process of the peer has registered, with another boot incarnation."""
    if peer.boot_incarnation != boot_incarnation:
        shown = peer.name or peer.peer_id.hex()
        raise LeaseExpired(
            f"the lease of peer {shown} belongs to another process, started with another boot incarnation; register "
            "again, and make sure that two processes do not share one identity",
            metadata={"peer": shown, **({"registration_epoch": str(peer.registration_epoch)} if peer.alive else {})},
        )


def expire_peers(tables: Tables, operation: ExpirePeers, tenure: int) -> int:
    """End the stated leases, except leases that have changed since. Returns the number of ended leases.

    `tenure`: the present tenure. A command of another tenure ends nothing.
    """
    if operation.tenure != tenure:
        return 0
    return sum(_expire(tables, lease) for lease in sorted(operation.leases, key=attrgetter("peer_id")))


def _expire(tables: Tables, lease: PeerLease) -> bool:
    peer = tables.peers.by_id.get(lease.peer_id)
    if peer is None or not peer.alive:
        return False
    if (peer.boot_incarnation, peer.registered_index) != (lease.boot_incarnation, lease.registered_index):
        return False
    _drop_mailbox(tables, peer)
    tables.peers.put(replace(peer, mailbox_queue_id=None, ended_index=tables.index), tables.index)
    return True


def _drop_mailbox(tables: Tables, peer: PeerRecord) -> None:
    mailbox = _mailbox_of(tables, peer)
    if mailbox is not None:
        tables.remove_queue(mailbox)
