"""Converts commands about moves, and their results, from and to messages of the log."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from stampede_rt.v1 import directory_command_pb2 as pb
from stampede_rt.v1 import move_pb2
from stampede_rt_supernode.codecs.kind_codec import KindCodec
from stampede_rt_supernode.codecs.queue_codec import queue_from, queue_record
from stampede_rt_supernode.codecs.record_codec import channel_from, channel_record
from stampede_rt_supernode.core.moves.commands import (
    CommitMove,
    CommitMoves,
    CommitQueueMove,
    MoveCommitted,
    MovesCommitted,
    MovesReleased,
    MoveToCommit,
    MoveToRelease,
    QueueMoveCommitted,
    ReleaseMoves,
)


def _commit_message(operation: CommitMove) -> pb.CommitMoveCommand:
    return pb.CommitMoveCommand(
        channel_id=operation.channel_id,
        epoch=operation.epoch,
        to_host_id=operation.to_host_id,
        to_boot_incarnation=operation.to_boot_incarnation,
        to_registered_index=operation.to_registered_index,
        permit=operation.permit,
    )


def _read_commit(message: pb.CommitMoveCommand) -> CommitMove:
    return CommitMove(
        channel_id=message.channel_id,
        epoch=message.epoch,
        to_host_id=message.to_host_id,
        to_boot_incarnation=message.to_boot_incarnation,
        to_registered_index=message.to_registered_index,
        permit=message.permit,
    )


def moves_to(moves: Iterable[MoveToCommit]) -> list[move_pb2.MoveToCommit]:
    """The moves of `CommitMoves`, as messages."""
    return [move_pb2.MoveToCommit(channel_id=one.channel_id, epoch=one.epoch, permit=one.permit) for one in moves]


def moves_from(messages: Iterable[move_pb2.MoveToCommit]) -> tuple[MoveToCommit, ...]:
    """The moves of `CommitMoves`, from messages."""
    return tuple(MoveToCommit(channel_id=one.channel_id, epoch=one.epoch, permit=one.permit) for one in messages)


def releases_to(moves: Iterable[MoveToRelease]) -> list[move_pb2.MoveToRelease]:
    """The moves of `ReleaseMoves`, as messages."""
    return [move_pb2.MoveToRelease(channel_id=one.channel_id, epoch=one.epoch) for one in moves]


def releases_from(messages: Iterable[move_pb2.MoveToRelease]) -> tuple[MoveToRelease, ...]:
    """The moves of `ReleaseMoves`, from messages."""
    return tuple(MoveToRelease(channel_id=one.channel_id, epoch=one.epoch) for one in messages)


def _commits_message(operation: CommitMoves) -> pb.CommitMovesCommand:
    return pb.CommitMovesCommand(
        to_host_id=operation.to_host_id,
        to_boot_incarnation=operation.to_boot_incarnation,
        to_registered_index=operation.to_registered_index,
        moves=moves_to(operation.moves),
    )


def _read_commits(message: pb.CommitMovesCommand) -> CommitMoves:
    return CommitMoves(
        to_host_id=message.to_host_id,
        to_boot_incarnation=message.to_boot_incarnation,
        to_registered_index=message.to_registered_index,
        moves=moves_from(message.moves),
    )


def _queue_message(operation: CommitQueueMove) -> pb.CommitQueueMoveCommand:
    return pb.CommitQueueMoveCommand(
        queue_id=operation.queue_id,
        epoch=operation.epoch,
        to_host_id=operation.to_host_id,
        to_boot_incarnation=operation.to_boot_incarnation,
        to_registered_index=operation.to_registered_index,
        permit=operation.permit,
    )


def _read_queue(message: pb.CommitQueueMoveCommand) -> CommitQueueMove:
    return CommitQueueMove(
        queue_id=message.queue_id,
        epoch=message.epoch,
        to_host_id=message.to_host_id,
        to_boot_incarnation=message.to_boot_incarnation,
        to_registered_index=message.to_registered_index,
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
    KindCodec(
        kind="commit_moves",
        outcome="moves_committed",
        operation=CommitMoves,
        result=MovesCommitted,
        write=_commits_message,
        read=_read_commits,
        write_result=lambda one: pb.MovesCommittedResult(channels=map(channel_record, one.channels)),
        read_result=lambda message: MovesCommitted(channels=tuple(map(channel_from, message.channels))),
    ),
    KindCodec(
        kind="release_moves",
        outcome="moves_released",
        operation=ReleaseMoves,
        result=MovesReleased,
        write=lambda one: pb.ReleaseMovesCommand(host_id=one.host_id, moves=releases_to(one.moves)),
        read=lambda message: ReleaseMoves(host_id=message.host_id, moves=releases_from(message.moves)),
        write_result=lambda one: pb.MovesReleasedResult(channel_ids=one.channel_ids),
        read_result=lambda message: MovesReleased(channel_ids=tuple(message.channel_ids)),
    ),
)
