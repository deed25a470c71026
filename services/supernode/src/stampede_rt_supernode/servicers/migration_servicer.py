"""Serves MigrationDirectoryService (proto/stampede_rt/v1/migration_directory_service.proto). Checks the request, asks
the log, and encodes the response.
"""

# ruff: noqa: N802  # methods bear the names of the RPCs
from __future__ import annotations

from stampede_rt.v1 import migration_directory_service_pb2 as pb
from stampede_rt.v1 import migration_directory_service_pb2_grpc
from stampede_rt_runtime.rpc import Context, errors_as_status
from stampede_rt_supernode.codecs.queue_codec import queue_record
from stampede_rt_supernode.codecs.record_codec import channel_record
from stampede_rt_supernode.core.moves.commands import CommitMove, CommitQueueMove, MoveCommitted, QueueMoveCommitted
from stampede_rt_supernode.servicers.calls import DirectoryCalls


class MigrationDirectoryServicer(migration_directory_service_pb2_grpc.MigrationDirectoryServiceServicer):
    """One supernode's answers about moves of channels and queues."""

    def __init__(self, calls: DirectoryCalls) -> None:
        self._calls = calls

    @errors_as_status
    async def CommitMove(self, request: pb.CommitMoveRequest, context: Context) -> pb.CommitMoveResponse:
        """In a cluster with certificates only the new owner may call this, and the present owner must permit it."""
        self._calls.check_host(context, request.to_host_id)
        operation = CommitMove(
            channel_id=request.channel_id,
            epoch=request.epoch,
            to_host_id=request.to_host_id,
            to_boot_incarnation=request.to_boot_incarnation,
            permit=request.permit,
        )
        committed = await self._calls.submit(context, operation, MoveCommitted, request.request_id)
        return pb.CommitMoveResponse(channel=channel_record(committed.channel))

    @errors_as_status
    async def CommitQueueMove(self, request: pb.CommitQueueMoveRequest, context: Context) -> pb.CommitQueueMoveResponse:
        """In a cluster with certificates only the new owner may call this, and the present owner must permit it."""
        self._calls.check_host(context, request.to_host_id)
        operation = CommitQueueMove(
            queue_id=request.queue_id,
            epoch=request.epoch,
            to_host_id=request.to_host_id,
            to_boot_incarnation=request.to_boot_incarnation,
            permit=request.permit,
        )
        committed = await self._calls.submit(context, operation, QueueMoveCommitted, request.request_id)
        return pb.CommitQueueMoveResponse(queue=queue_record(committed.queue))
