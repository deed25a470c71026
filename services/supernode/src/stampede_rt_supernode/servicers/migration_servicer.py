"""Serves MigrationDirectoryService (proto/stampede_rt/v1/migration_directory_service.proto). Checks the request, asks
the log, and encodes the response.
"""

# ruff: noqa: N802  # methods have the names of the RPCs
from __future__ import annotations

from stampede_rt.errors import InvalidArgument
from stampede_rt.v1 import migration_directory_service_pb2 as pb
from stampede_rt.v1 import migration_directory_service_pb2_grpc, move_pb2
from stampede_rt_runtime.access.move_permits import PERMIT_BYTES
from stampede_rt_runtime.rpc import Context, errors_as_status
from stampede_rt_supernode.codecs.host_codec import host_record
from stampede_rt_supernode.codecs.move_kinds import moves_from, releases_from
from stampede_rt_supernode.codecs.queue_codec import queue_record
from stampede_rt_supernode.codecs.record_codec import channel_record
from stampede_rt_supernode.core.moves.commands import (
    CommitMove,
    CommitMoves,
    CommitQueueMove,
    MoveCommitted,
    MovesCommitted,
    MovesReleased,
    QueueMoveCommitted,
    ReleaseMoves,
)
from stampede_rt_supernode.core.moves.several import owners, released
from stampede_rt_supernode.servicers.calls import DirectoryCalls


class MigrationDirectoryServicer(migration_directory_service_pb2_grpc.MigrationDirectoryServiceServicer):
    """One supernode's answers about moves of channels and queues."""

    def __init__(self, calls: DirectoryCalls) -> None:
        self._calls = calls

    @errors_as_status
    async def CommitMove(self, request: pb.CommitMoveRequest, context: Context) -> pb.CommitMoveResponse:
        """In a cluster with certificates only the new owner may call this, and the present owner must permit it."""
        self._calls.check_host(context, request.to_host_id)
        _check_permits(request)
        operation = CommitMove(
            channel_id=request.channel_id,
            epoch=request.epoch,
            to_host_id=request.to_host_id,
            to_boot_incarnation=request.to_boot_incarnation,
            to_registered_index=request.to_registered_index,
            permit=request.permit,
        )
        committed = await self._calls.submit(context, operation, MoveCommitted, request.request_id)
        return pb.CommitMoveResponse(channel=channel_record(committed.channel))

    @errors_as_status
    async def CommitMoves(self, request: pb.CommitMovesRequest, context: Context) -> pb.CommitMovesResponse:
        """In a cluster with certificates only the new owner may call this, and the present owners must permit it."""
        self._calls.check_host(context, request.to_host_id)
        _check_permits(*request.moves)
        operation = CommitMoves(
            to_host_id=request.to_host_id,
            to_boot_incarnation=request.to_boot_incarnation,
            to_registered_index=request.to_registered_index,
            moves=moves_from(request.moves),
        )
        committed = await self._calls.submit(context, operation, MovesCommitted, request.request_id)
        return pb.CommitMovesResponse(channels=map(channel_record, committed.channels))

    @errors_as_status
    async def ReleaseMoves(self, request: pb.ReleaseMovesRequest, context: Context) -> pb.ReleaseMovesResponse:
        """In a cluster with certificates only the owner may call this."""
        self._calls.check_host(context, request.host_id)
        operation = ReleaseMoves(host_id=request.host_id, moves=releases_from(request.moves))
        done = await self._calls.submit(context, operation, MovesReleased, request.request_id)
        return pb.ReleaseMovesResponse(channel_ids=done.channel_ids)

    @errors_as_status
    async def ListReleasedMoves(
        self, request: pb.ListReleasedMovesRequest, context: Context
    ) -> pb.ListReleasedMovesResponse:
        """In a cluster with certificates only the former owner may call this."""
        self._calls.check_host(context, request.host_id)
        ids = await self._calls.read(
            context, lambda one: released(one.tables, request.host_id, list(request.channel_ids))
        )
        return pb.ListReleasedMovesResponse(channel_ids=ids)

    @errors_as_status
    async def ListOwners(self, request: pb.ListOwnersRequest, context: Context) -> pb.ListOwnersResponse:
        """The owners of channels that are to move. Only hosts may call this."""
        channels, hosts = await self._calls.read(context, lambda one: owners(one.tables, list(request.channel_ids)))
        return pb.ListOwnersResponse(channels=map(channel_record, channels), hosts=map(host_record, hosts))

    @errors_as_status
    async def CommitQueueMove(self, request: pb.CommitQueueMoveRequest, context: Context) -> pb.CommitQueueMoveResponse:
        """In a cluster with certificates only the new owner may call this, and the present owner must permit it."""
        self._calls.check_host(context, request.to_host_id)
        _check_permits(request)
        operation = CommitQueueMove(
            queue_id=request.queue_id,
            epoch=request.epoch,
            to_host_id=request.to_host_id,
            to_boot_incarnation=request.to_boot_incarnation,
            to_registered_index=request.to_registered_index,
            permit=request.permit,
        )
        committed = await self._calls.submit(context, operation, QueueMoveCommitted, request.request_id)
        return pb.CommitQueueMoveResponse(queue=queue_record(committed.queue))


def _check_permits(*moves: pb.CommitMoveRequest | pb.CommitQueueMoveRequest | move_pb2.MoveToCommit) -> None:
    """Keep long permits out of the log. Raises InvalidArgument."""
    for move in moves:
        if len(move.permit) not in (0, PERMIT_BYTES):
            raise InvalidArgument(f"the permit of a move has {PERMIT_BYTES} bytes or none, not {len(move.permit)}")
