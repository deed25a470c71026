"""Queues and what is done to them, to and from the messages that carry them. Thin: no decision is made here."""

from __future__ import annotations

from typing import Any

from stampede_rt.errors import InvalidArgument, StampedeError
from stampede_rt.v1 import directory_command_pb2 as pb
from stampede_rt.v1 import queue_pb2
from stampede_rt_supernode.codecs.host_codec import host_entry, host_from
from stampede_rt_supernode.core.commands import QueueOperation, QueueSuccess
from stampede_rt_supernode.core.queues.commands import (
    DeleteQueue,
    OpenQueue,
    QueueDeleted,
    QueueOpened,
    QueueUpdated,
    UpdateQueue,
)
from stampede_rt_supernode.core.records import Queue, QueueSpec

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
)

QUEUE_OPERATIONS = ("open_queue", "update_queue", "delete_queue")
QUEUE_OUTCOMES = ("queue_opened", "queue_updated", "queue_deleted")


def queue_spec_from(spec: queue_pb2.QueueSpec) -> QueueSpec:
    """Raises InvalidArgument for a way to be full that this version does not know."""
    if spec.on_full not in _ON_FULL_FROM_WIRE:
        raise InvalidArgument(
            f"on_full is {spec.on_full}, which this version does not know; see QueueOnFull for the values"
        )
    stated: dict[str, Any] = {name: getattr(spec, name) for name in _SPEC_FIELDS if spec.HasField(name)}
    return QueueSpec(on_full=_ON_FULL_FROM_WIRE[spec.on_full], **stated)


def queue_spec_message(spec: QueueSpec) -> queue_pb2.QueueSpec:
    """The stated fields; None leaves a field out."""
    others: dict[str, Any] = {name: getattr(spec, name) for name in _SPEC_FIELDS}
    return queue_pb2.QueueSpec(on_full=_ON_FULL_TO_WIRE[spec.on_full], **others)


def queue_record(queue: Queue) -> queue_pb2.QueueRecord:
    """The queue as it travels."""
    return queue_pb2.QueueRecord(
        queue_id=queue.queue_id,
        name=queue.name,
        host_id=queue.host_id,
        epoch=queue.epoch,
        incarnation=queue.incarnation,
        spec=queue_spec_message(queue.spec),
        spec_version=queue.spec_version,
        mailbox_peer_id=queue.mailbox_peer_id,
    )


def queue_from(record: queue_pb2.QueueRecord) -> Queue:
    """The queue of a record that this codec wrote."""
    return Queue(
        queue_id=record.queue_id,
        name=record.name,
        host_id=record.host_id,
        epoch=record.epoch,
        incarnation=record.incarnation,
        spec=queue_spec_from(record.spec),
        spec_version=record.spec_version,
        mailbox_peer_id=record.mailbox_peer_id if record.HasField("mailbox_peer_id") else None,
    )


def write_queue_operation(message: pb.DirectoryCommand, operation: QueueOperation) -> None:
    """Into the command's oneof."""
    match operation:
        case OpenQueue():
            opening = pb.OpenQueueCommand(
                name=operation.name,
                spec=queue_spec_message(operation.spec),
                create=operation.create,
                host_name=operation.host_name,
                new_queue_id=operation.new_queue_id,
                new_incarnation=operation.new_incarnation,
            )
            message.open_queue.CopyFrom(opening)
        case UpdateQueue(queue_id=queue_id, epoch=epoch, spec=spec):
            change = pb.UpdateQueueCommand(queue_id=queue_id, epoch=epoch, spec=queue_spec_message(spec))
            message.update_queue.CopyFrom(change)
        case DeleteQueue(queue_id=queue_id):
            message.delete_queue.CopyFrom(pb.DeleteQueueCommand(queue_id=queue_id))


def read_queue_operation(message: pb.DirectoryCommand) -> QueueOperation:
    """Of a command whose kind is one of QUEUE_OPERATIONS. Raises InvalidArgument."""
    if message.HasField("open_queue"):
        opening = message.open_queue
        return OpenQueue(
            name=opening.name,
            spec=queue_spec_from(opening.spec),
            create=opening.create,
            host_name=opening.host_name,
            new_queue_id=opening.new_queue_id,
            new_incarnation=opening.new_incarnation,
        )
    if message.HasField("update_queue"):
        change = message.update_queue
        return UpdateQueue(queue_id=change.queue_id, epoch=change.epoch, spec=queue_spec_from(change.spec))
    return DeleteQueue(queue_id=message.delete_queue.queue_id)


def queue_result_message(result: QueueSuccess) -> pb.DirectoryResult:
    """A result as it travels."""
    record = queue_record(result.queue)
    match result:
        case QueueOpened(host=host, created=created):
            opened = pb.QueueOpenedResult(queue=record, host=host_entry(host), created=created)
            return pb.DirectoryResult(queue_opened=opened)
        case QueueUpdated():
            return pb.DirectoryResult(queue_updated=pb.QueueUpdatedResult(queue=record))
        case QueueDeleted():
            return pb.DirectoryResult(queue_deleted=pb.QueueDeletedResult(queue=record))


def read_queue_result(message: pb.DirectoryResult) -> QueueSuccess:
    """Of a result whose outcome is one of QUEUE_OUTCOMES."""
    match message.WhichOneof("outcome"):
        case "queue_opened":
            opened = message.queue_opened
            return QueueOpened(queue=queue_from(opened.queue), host=host_from(opened.host), created=opened.created)
        case "queue_updated":
            return QueueUpdated(queue=queue_from(message.queue_updated.queue))
        case "queue_deleted":
            return QueueDeleted(queue=queue_from(message.queue_deleted.queue))
        case other:
            raise StampedeError(f"{other} is no result of a queue; report this")
