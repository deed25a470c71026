"""Converts peers from and to their messages. Makes no decisions."""

from __future__ import annotations

from collections.abc import Mapping
from sys import intern

from stampede_rt.v1 import directory_command_pb2 as pb
from stampede_rt.v1 import peer_pb2
from stampede_rt.values.peering import ClockOffset
from stampede_rt.wire.peers import clock_message
from stampede_rt_supernode.core.records import PeerRecord


def attributes_from(attributes: Mapping[str, str]) -> tuple[tuple[str, str], ...]:
    """The attributes in ascending order of keys, so that equal attributes compare as equal."""
    return tuple(sorted(attributes.items()))


def peer_record(peer: PeerRecord, clock: ClockOffset | None = None) -> peer_pb2.PeerRecord:
    """The record that clients get. `clock`: the peer's clock report, which is not in the log; None to leave it out."""
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
        owner=peer.owner,
        registration_epoch=peer.registration_epoch,
    )


def peer_entry(peer: PeerRecord) -> pb.PeerEntry:
    """The entry that supernodes keep for a peer."""
    return pb.PeerEntry(
        record=peer_record(peer),
        proof_sha256=peer.proof_sha256,
        registered_index=peer.registered_index,
        ended_index=peer.ended_index,
        created_by=peer.created_by,
    )


def peer_from(entry: pb.PeerEntry) -> PeerRecord:
    """The peer of an entry that this codec wrote."""
    record = entry.record
    return PeerRecord(
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
        registration_epoch=record.registration_epoch,
        owner=record.owner if record.HasField("owner") else None,
        created_by=intern(entry.created_by),  # one string object for all records of a caller
    )
