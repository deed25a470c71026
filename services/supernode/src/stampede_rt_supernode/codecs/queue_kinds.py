"""Converts commands about queues, and their results, from and to messages of the log."""

from __future__ import annotations

from typing import Any

from stampede_rt.v1 import directory_command_pb2 as pb
from stampede_rt_supernode.codecs.host_codec import host_entry, host_from
from stampede_rt_supernode.codecs.kind_codec import KindCodec
from stampede_rt_supernode.codecs.queue_codec import queue_from, queue_record, queue_spec_from, queue_spec_message
from stampede_rt_supernode.core.queues.commands import (
    DeleteQueue,
    OpenQueue,
    QueueDeleted,
    QueueOpened,
    QueueUpdated,
    UpdateQueue,
)


def _open_message(operation: OpenQueue) -> pb.OpenQueueCommand:
    return pb.OpenQueueCommand(
        name=operation.name,
        spec=queue_spec_message(operation.spec),
        create=operation.create,
        host_name=operation.host_name,
        new_queue_id=operation.new_queue_id,
        new_incarnation=operation.new_incarnation,
        created_by=operation.created_by,
        created_max=operation.created_max,
    )


def _read_open(message: pb.OpenQueueCommand) -> OpenQueue:
    return OpenQueue(
        name=message.name,
        spec=queue_spec_from(message.spec),
        create=message.create,
        host_name=message.host_name,
        new_queue_id=message.new_queue_id,
        new_incarnation=message.new_incarnation,
        created_by=message.created_by,
        created_max=message.created_max if message.HasField("created_max") else None,
    )


def _update_message(operation: UpdateQueue) -> pb.UpdateQueueCommand:
    return pb.UpdateQueueCommand(
        queue_id=operation.queue_id, epoch=operation.epoch, spec=queue_spec_message(operation.spec)
    )


def _read_update(message: pb.UpdateQueueCommand) -> UpdateQueue:
    return UpdateQueue(queue_id=message.queue_id, epoch=message.epoch, spec=queue_spec_from(message.spec))


def _opened_message(result: QueueOpened) -> pb.QueueOpenedResult:
    return pb.QueueOpenedResult(queue=queue_record(result.queue), host=host_entry(result.host), created=result.created)


def _read_opened(message: pb.QueueOpenedResult) -> QueueOpened:
    return QueueOpened(queue=queue_from(message.queue), host=host_from(message.host), created=message.created)


CODECS: tuple[KindCodec[Any, Any, Any, Any], ...] = (
    KindCodec(
        kind="open_queue",
        outcome="queue_opened",
        operation=OpenQueue,
        result=QueueOpened,
        write=_open_message,
        read=_read_open,
        write_result=_opened_message,
        read_result=_read_opened,
    ),
    KindCodec(
        kind="update_queue",
        outcome="queue_updated",
        operation=UpdateQueue,
        result=QueueUpdated,
        write=_update_message,
        read=_read_update,
        write_result=lambda one: pb.QueueUpdatedResult(queue=queue_record(one.queue)),
        read_result=lambda message: QueueUpdated(queue=queue_from(message.queue)),
    ),
    KindCodec(
        kind="delete_queue",
        outcome="queue_deleted",
        operation=DeleteQueue,
        result=QueueDeleted,
        write=lambda one: pb.DeleteQueueCommand(queue_id=one.queue_id),
        read=lambda message: DeleteQueue(queue_id=message.queue_id),
        write_result=lambda one: pb.QueueDeletedResult(queue=queue_record(one.queue)),
        read_result=lambda message: QueueDeleted(queue=queue_from(message.queue)),
    ),
)
