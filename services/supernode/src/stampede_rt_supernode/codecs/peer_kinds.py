"""Converts commands about peers, and their results, from and to messages of the log."""

from __future__ import annotations

from typing import Any

from stampede_rt.v1 import directory_command_pb2 as pb
from stampede_rt_supernode.codecs.host_codec import host_entry, host_from
from stampede_rt_supernode.codecs.kind_codec import KindCodec
from stampede_rt_supernode.codecs.peer_codec import attributes_from, peer_entry, peer_from
from stampede_rt_supernode.codecs.queue_codec import queue_from, queue_record, queue_spec_from, queue_spec_message
from stampede_rt_supernode.core.peers.commands import (
    DeregisterPeer,
    ExpirePeers,
    PeerDeregistered,
    PeerLease,
    PeerRegistered,
    PeersExpired,
    RegisterPeer,
)


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
        registration_epoch=operation.registration_epoch,
        owner=operation.owner,
        created_by=operation.created_by,
        created_max=operation.created_max,
    )


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
        registration_epoch=message.registration_epoch,
        owner=message.owner if message.HasField("owner") else None,
        created_by=message.created_by,
        created_max=message.created_max if message.HasField("created_max") else None,
    )


def _deregister_message(operation: DeregisterPeer) -> pb.DeregisterPeerCommand:
    return pb.DeregisterPeerCommand(peer_id=operation.peer_id, boot_incarnation=operation.boot_incarnation)


def _read_deregister(message: pb.DeregisterPeerCommand) -> DeregisterPeer:
    return DeregisterPeer(peer_id=message.peer_id, boot_incarnation=message.boot_incarnation)


def _expire_message(operation: ExpirePeers) -> pb.ExpirePeersCommand:
    ended = [
        pb.PeerLease(peer_id=one.peer_id, boot_incarnation=one.boot_incarnation, registered_index=one.registered_index)
        for one in operation.leases
    ]
    return pb.ExpirePeersCommand(leases=ended, tenure=operation.tenure)


def _read_expire(message: pb.ExpirePeersCommand) -> ExpirePeers:
    leases = (
        PeerLease(peer_id=one.peer_id, boot_incarnation=one.boot_incarnation, registered_index=one.registered_index)
        for one in message.leases
    )
    return ExpirePeers(leases=tuple(leases), tenure=message.tenure)


def _registered_message(result: PeerRegistered) -> pb.PeerRegisteredResult:
    return pb.PeerRegisteredResult(
        peer=peer_entry(result.peer),
        mailbox=None if result.mailbox is None else queue_record(result.mailbox),
        mailbox_host=None if result.mailbox_host is None else host_entry(result.mailbox_host),
        mailbox_kept=result.mailbox_kept,
        cluster_id=result.cluster_id,
    )


def _read_registered(message: pb.PeerRegisteredResult) -> PeerRegistered:
    return PeerRegistered(
        peer=peer_from(message.peer),
        mailbox=queue_from(message.mailbox) if message.HasField("mailbox") else None,
        mailbox_host=host_from(message.mailbox_host) if message.HasField("mailbox_host") else None,
        mailbox_kept=message.mailbox_kept,
        cluster_id=message.cluster_id,
    )


CODECS: tuple[KindCodec[Any, Any, Any, Any], ...] = (
    KindCodec(
        kind="register_peer",
        outcome="peer_registered",
        operation=RegisterPeer,
        result=PeerRegistered,
        write=_register_message,
        read=_read_register,
        write_result=_registered_message,
        read_result=_read_registered,
    ),
    KindCodec(
        kind="deregister_peer",
        outcome="peer_deregistered",
        operation=DeregisterPeer,
        result=PeerDeregistered,
        write=_deregister_message,
        read=_read_deregister,
        write_result=lambda one: pb.PeerDeregisteredResult(),
        read_result=lambda message: PeerDeregistered(),
    ),
    KindCodec(
        kind="expire_peers",
        outcome="peers_expired",
        operation=ExpirePeers,
        result=PeersExpired,
        write=_expire_message,
        read=_read_expire,
        write_result=lambda one: pb.PeersExpiredResult(expired=one.expired),
        read_result=lambda message: PeersExpired(expired=message.expired),
    ),
)
