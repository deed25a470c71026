"""Converts commands about moves, and their results, from and to messages of the log."""

from __future__ import annotations

from typing import Any

from stampede_rt.v1 import directory_command_pb2 as pb
from stampede_rt_supernode.codecs.kind_codec import KindCodec
from stampede_rt_supernode.codecs.queue_codec import queue_from, queue_record
from stampede_rt_supernode.codecs.record_codec import channel_from, channel_record
from stampede_rt_supernode.core.moves.commands import CommitMove, CommitQueueMove, MoveCommitted, QueueMoveCommitted


def _commit_message(operation: CommitMove) -> pb.CommitMoveCommand:
    return pb.CommitMoveCommand(
        channel_id=operation.channel_id,
        epoch=operation.epoch,
        to_host_id=operation.to_host_id,
        to_boot_incarnation=operation.to_boot_incarnation,
        permit=operation.permit,
    )


def _read_commit(message: pb.CommitMoveCommand) -> CommitMove:
    return CommitMove(
        channel_id=message.channel_id,
        epoch=message.epoch,
        to_host_id=message.to_host_id,
        to_boot_incarnation=message.to_boot_incarnation,
        permit=message.permit,
    )


def _queue_message(operation: CommitQueueMove) -> pb.CommitQueueMoveCommand:
    return pb.CommitQueueMoveCommand(
        queue_id=operation.queue_id,
        epoch=operation.epoch,
        to_host_id=operation.to_host_id,
        to_boot_incarnation=operation.to_boot_incarnation,
        permit=operation.permit,
    )


def _read_queue(message: pb.CommitQueueMoveCommand) -> CommitQueueMove:
    return CommitQueueMove(
        queue_id=message.queue_id,
        epoch=message.epoch,
        to_host_id=message.to_host_id,
        to_boot_incarnation=message.to_boot_incarnation,
        permit=message.permit,
    )


CODECS: tuple[KindCodec[Any, Any, Any, Any], ...] = (
    KindCodec(
        kind="commit_move",
        outcome="move_committed",
        operation=CommitMove,
        result=MoveCommitted,
        write=_commit_message,
        read=_read_commit,
        write_result=lambda one: pb.MoveCommittedResult(channel=channel_record(one.channel)),
        read_result=lambda message: MoveCommitted(channel=channel_from(message.channel)),
    ),
    KindCodec(
        kind="commit_queue_move",
        outcome="queue_move_committed",
        operation=CommitQueueMove,
        result=QueueMoveCommitted,
        write=_queue_message,
        read=_read_queue,
        write_result=lambda one: pb.QueueMoveCommittedResult(queue=queue_record(one.queue)),
        read_result=lambda message: QueueMoveCommitted(queue=queue_from(message.queue)),
    ),
)
