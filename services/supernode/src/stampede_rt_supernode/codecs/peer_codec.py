"""Peers and what is done to them, to and from the messages that carry them. Thin: no decision is made here."""

from __future__ import annotations

from collections.abc import Mapping

from stampede_rt.errors import StampedeError
from stampede_rt.v1 import directory_command_pb2 as pb
from stampede_rt.v1 import peer_pb2
from stampede_rt.values.peering import ClockOffset
from stampede_rt.wire.peers import clock_message
from stampede_rt_supernode.codecs.host_codec import host_entry, host_from
from stampede_rt_supernode.codecs.queue_codec import (
    queue_from,
    queue_record,
    queue_spec_from,
    queue_spec_message,
)
from stampede_rt_supernode.core.commands import PeerOperation, PeerSuccess
from stampede_rt_supernode.core.peers.commands import (
    DeregisterPeer,
    ExpirePeers,
    PeerDeregistered,
    PeerLease,
    PeerRegistered,
    PeersExpired,
    RegisterPeer,
)
from stampede_rt_supernode.core.records import Peer

PEER_OPERATIONS = ("register_peer", "deregister_peer", "expire_peers")
PEER_OUTCOMES = ("peer_registered", "peer_deregistered", "peers_expired")


def attributes_from(attributes: Mapping[str, str]) -> tuple[tuple[str, str], ...]:
    """Ascending by key, so that equal ones are equal."""
    return tuple(sorted(attributes.items()))


def peer_record(peer: Peer, clock: ClockOffset | None = None) -> peer_pb2.PeerRecord:
    """The peer as clients see it, with its clock if that is known and asked for: the log holds none."""
    return peer_pb2.PeerRecord(
        peer_id=peer.peer_id,
        name=peer.name,
        boot_incarnation=peer.boot_incarnation,
        alive=peer.alive,
        mailbox_queue_id=peer.mailbox_queue_id,
        host_id=peer.host_id,
        zone=peer.zone,
        version=peer.version,
        attributes=dict(peer.attributes),
        registered_unix_nano=peer.registered_unix_nano,
        clock=clock_message(clock),
    )


def peer_entry(peer: Peer) -> pb.PeerEntry:
    """The peer as supernodes keep it."""
    return pb.PeerEntry(
        record=peer_record(peer),
        proof_sha256=peer.proof_sha256,
        registered_index=peer.registered_index,
        ended_index=peer.ended_index,
    )


def peer_from(entry: pb.PeerEntry) -> Peer:
    """The peer of an entry that this codec wrote."""
    record = entry.record
    return Peer(
        peer_id=record.peer_id,
        name=record.name,
        boot_incarnation=record.boot_incarnation,
        mailbox_queue_id=record.mailbox_queue_id if record.HasField("mailbox_queue_id") else None,
        host_id=record.host_id if record.HasField("host_id") else None,
        zone=record.zone,
        version=record.version,
        attributes=attributes_from(record.attributes),
        registered_unix_nano=record.registered_unix_nano,
        proof_sha256=entry.proof_sha256,
        registered_index=entry.registered_index,
        ended_index=entry.ended_index,
    )


def write_peer_operation(message: pb.DirectoryCommand, operation: PeerOperation) -> None:
    """Into the command's oneof."""
    match operation:
        case RegisterPeer():
            message.register_peer.CopyFrom(_register_message(operation))
        case DeregisterPeer(peer_id=peer_id, boot_incarnation=boot):
            message.deregister_peer.CopyFrom(pb.DeregisterPeerCommand(peer_id=peer_id, boot_incarnation=boot))
        case ExpirePeers(leases=leases, tenure=tenure):
            ended = [
                pb.PeerLease(
                    peer_id=one.peer_id, boot_incarnation=one.boot_incarnation, registered_index=one.registered_index
                )
                for one in leases
            ]
            message.expire_peers.CopyFrom(pb.ExpirePeersCommand(leases=ended, tenure=tenure))


def _register_message(operation: RegisterPeer) -> pb.RegisterPeerCommand:
    return pb.RegisterPeerCommand(
        peer_id=operation.peer_id,
        name=operation.name,
        boot_incarnation=operation.boot_incarnation,
        proof_sha256=operation.proof_sha256,
        mailbox=None if operation.mailbox is None else queue_spec_message(operation.mailbox),
        mailbox_host_name=operation.mailbox_host_name,
        host_id=operation.host_id or b"",
        zone=operation.zone,
        version=operation.version,
        attributes=dict(operation.attributes),
        new_mailbox_id=operation.new_mailbox_id,
        new_incarnation=operation.new_incarnation,
    )


def read_peer_operation(message: pb.DirectoryCommand) -> PeerOperation:
    """Of a command whose kind is one of PEER_OPERATIONS. Raises InvalidArgument."""
    if message.HasField("register_peer"):
        return _read_register(message.register_peer)
    if message.HasField("deregister_peer"):
        leave = message.deregister_peer
        return DeregisterPeer(peer_id=leave.peer_id, boot_incarnation=leave.boot_incarnation)
    ended = message.expire_peers
    leases = (
        PeerLease(peer_id=one.peer_id, boot_incarnation=one.boot_incarnation, registered_index=one.registered_index)
        for one in ended.leases
    )
    return ExpirePeers(leases=tuple(leases), tenure=ended.tenure)


def _read_register(message: pb.RegisterPeerCommand) -> RegisterPeer:
    return RegisterPeer(
        peer_id=message.peer_id,
        name=message.name,
        boot_incarnation=message.boot_incarnation,
        proof_sha256=message.proof_sha256,
        mailbox=queue_spec_from(message.mailbox) if message.HasField("mailbox") else None,
        mailbox_host_name=message.mailbox_host_name,
        host_id=message.host_id or None,
        zone=message.zone,
        version=message.version,
        attributes=attributes_from(message.attributes),
        new_mailbox_id=message.new_mailbox_id,
        new_incarnation=message.new_incarnation,
    )


def peer_result_message(result: PeerSuccess) -> pb.DirectoryResult:
    """A result as it travels."""
    match result:
        case PeerRegistered(mailbox=mailbox, mailbox_host=host):
            registered = pb.PeerRegisteredResult(
                peer=peer_entry(result.peer),
                mailbox=None if mailbox is None else queue_record(mailbox),
                mailbox_host=None if host is None else host_entry(host),
                mailbox_kept=result.mailbox_kept,
                cluster_id=result.cluster_id,
            )
            return pb.DirectoryResult(peer_registered=registered)
        case PeerDeregistered():
            return pb.DirectoryResult(peer_deregistered=pb.PeerDeregisteredResult())
        case PeersExpired(expired=expired):
            return pb.DirectoryResult(peers_expired=pb.PeersExpiredResult(expired=expired))


def read_peer_result(message: pb.DirectoryResult) -> PeerSuccess:
    """Of a result whose outcome is one of PEER_OUTCOMES."""
    match message.WhichOneof("outcome"):
        case "peer_registered":
            m = message.peer_registered
            return PeerRegistered(
                peer=peer_from(m.peer),
                mailbox=queue_from(m.mailbox) if m.HasField("mailbox") else None,
                mailbox_host=host_from(m.mailbox_host) if m.HasField("mailbox_host") else None,
                mailbox_kept=m.mailbox_kept,
                cluster_id=m.cluster_id,
            )
        case "peer_deregistered":
            return PeerDeregistered()
        case "peers_expired":
            return PeersExpired(expired=message.peers_expired.expired)
        case other:
            raise StampedeError(f"{other} is no result of a peer; report this")
