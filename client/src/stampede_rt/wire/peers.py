"""Converts peers and clock offsets from protobuf, and clock offsets to it (`peer.proto`)."""

from __future__ import annotations

from stampede_rt.v1 import peer_pb2
from stampede_rt.values.peering import ClockOffset, PeerChange, PeerInfo
from stampede_rt.wire.records import change_kind


def peer_info(record: peer_pb2.PeerRecord) -> PeerInfo:
    """Return the peer of a record of the directory."""
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
        clock=clock_offset(record.clock) if record.HasField("clock") else None,
        owner=record.owner if record.HasField("owner") else None,
    )


def clock_offset(message: peer_pb2.ClockOffset) -> ClockOffset:
    """Return the offset of a peer's clock."""
    return ClockOffset(
        offset_nanos=message.offset_nanos,
        uncertainty_nanos=message.uncertainty_nanos,
        supernode=message.supernode_id,
    )


def clock_message(clock: ClockOffset | None) -> peer_pb2.ClockOffset | None:
    """Return the message for a clock offset; None if `clock` is None, so that the field stays absent."""
    if clock is None:
        return None
    return peer_pb2.ClockOffset(
        offset_nanos=clock.offset_nanos,
        uncertainty_nanos=clock.uncertainty_nanos,
        supernode_id=clock.supernode,
    )


def peer_change(message: peer_pb2.PeerChange) -> PeerChange:
    """Return one change of a peer."""
    return PeerChange(index=message.index, kind=change_kind(message.kind), peer=peer_info(message.peer))
