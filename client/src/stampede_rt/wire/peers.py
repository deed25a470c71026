"""Participants, from their protobuf form (`peer.proto`)."""

from __future__ import annotations

from stampede_rt.peering import PeerChange, PeerInfo
from stampede_rt.v1 import peer_pb2
from stampede_rt.wire.records import CHANGE_KINDS


def peer_info(record: peer_pb2.PeerRecord) -> PeerInfo:
    """A participant as callers see it."""
    return PeerInfo(
        peer_id=record.peer_id,
        name=record.name,
        alive=record.alive,
        boot_incarnation=record.boot_incarnation,
        mailbox_queue_id=record.mailbox_queue_id if record.HasField("mailbox_queue_id") else None,
        host_id=record.host_id if record.HasField("host_id") else None,
        zone=record.zone,
        version=record.version,
        attributes=dict(record.attributes),
        registered=record.registered_unix_nano,
    )


def peer_change(message: peer_pb2.PeerChange) -> PeerChange:
    """One change among the peers."""
    return PeerChange(index=message.index, kind=CHANGE_KINDS[message.kind], peer=peer_info(message.peer))
