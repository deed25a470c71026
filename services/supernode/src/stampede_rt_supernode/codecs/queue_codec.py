"""Converts queues from and to their messages. Makes no decisions."""

from __future__ import annotations

from sys import intern
from typing import Any

from stampede_rt.errors import InvalidArgument
from stampede_rt.v1 import channel_pb2, queue_pb2
from stampede_rt_supernode.core.records import QueueRecord, QueueSpec

_ON_FULL_TO_WIRE = {
    None: queue_pb2.QUEUE_ON_FULL_UNSPECIFIED,
    "block": queue_pb2.QUEUE_ON_FULL_BLOCK,
    "reject": queue_pb2.QUEUE_ON_FULL_REJECT,
    "drop_oldest": queue_pb2.QUEUE_ON_FULL_DROP_OLDEST,
}
_ON_FULL_FROM_WIRE = {wire: name for name, wire in _ON_FULL_TO_WIRE.items()}
_SPEC_FIELDS = (
    "max_items",
    "max_bytes",
    "copies",
    "lease_nanos",
    "max_deliveries",
    "dead_letter_queue_id",
    "content_type",
    "max_item_bytes",
    "replicas",
    "min_replicas",
)
_ACK_TO_WIRE = {
    None: channel_pb2.ACK_UNSPECIFIED,
    "host": channel_pb2.ACK_HOST,
    "replica": channel_pb2.ACK_REPLICA,
}
_ACK_FROM_WIRE = {wire: name for name, wire in _ACK_TO_WIRE.items()}


def queue_spec_from(spec: queue_pb2.QueueSpec) -> QueueSpec:
    """The policy in a message. Raises InvalidArgument for an unknown value of on_full or ack."""
    if spec.on_full not in _ON_FULL_FROM_WIRE:
        raise InvalidArgument(
            f"on_full is {spec.on_full}, which this version does not know; see QueueOnFull for the values"
        )
    if spec.ack not in _ACK_FROM_WIRE:
        raise InvalidArgument(f'ack is {spec.ack}; the ack of a queue is ACK_HOST or ACK_REPLICA ("host", "replica")')
    stated: dict[str, Any] = {name: getattr(spec, name) for name in _SPEC_FIELDS if spec.HasField(name)}
    return QueueSpec(on_full=_ON_FULL_FROM_WIRE[spec.on_full], ack=_ACK_FROM_WIRE[spec.ack], **stated)


def queue_spec_message(spec: QueueSpec) -> queue_pb2.QueueSpec:
    """The message of a policy. Leaves out fields that are None."""
    others: dict[str, Any] = {name: getattr(spec, name) for name in _SPEC_FIELDS}
    return queue_pb2.QueueSpec(on_full=_ON_FULL_TO_WIRE[spec.on_full], ack=_ACK_TO_WIRE[spec.ack], **others)


def queue_record(queue: QueueRecord) -> queue_pb2.QueueRecord:
    """The message of a queue."""
    return queue_pb2.QueueRecord(
        queue_id=queue.queue_id,
        name=queue.name,
        host_id=queue.host_id,
        epoch=queue.epoch,
        incarnation=queue.incarnation,
        spec=queue_spec_message(queue.spec),
        spec_version=queue.spec_version,
        mailbox_peer_id=queue.mailbox_peer_id,
        mailbox_peer_name=queue.mailbox_peer_name,
        mailbox_owner=queue.mailbox_owner,
        created_by=queue.created_by,
    )


def queue_from(record: queue_pb2.QueueRecord) -> QueueRecord:
    """The queue of a record that this codec wrote."""
    return QueueRecord(
        queue_id=record.queue_id,
        name=record.name,
        host_id=record.host_id,
        epoch=record.epoch,
        incarnation=record.incarnation,
        spec=queue_spec_from(record.spec),
        spec_version=record.spec_version,
        mailbox_peer_id=record.mailbox_peer_id if record.HasField("mailbox_peer_id") else None,
        mailbox_peer_name=record.mailbox_peer_name,
        mailbox_owner=record.mailbox_owner if record.HasField("mailbox_owner") else None,
        created_by=intern(record.created_by),
    )
