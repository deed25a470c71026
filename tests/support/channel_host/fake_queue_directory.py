"""The directory in memory, with queues."""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import AsyncIterator
from typing import Any

import grpc

from stampede_rt.errors import QueueNotFound, error_for
from stampede_rt.status import abort
from stampede_rt.v1 import (
    directory_pb2,
    directory_service_pb2,
    migration_directory_service_pb2_grpc,
    queue_directory_service_pb2_grpc,
    queue_pb2,
)
from stampede_rt.v1 import migration_directory_service_pb2 as moves_pb
from stampede_rt.v1 import queue_directory_service_pb2 as pb
from tests.support.channel_host.fake_directory import FakeDirectory


class FakeQueueDirectory(
    FakeDirectory,
    queue_directory_service_pb2_grpc.QueueDirectoryServiceServicer,
    migration_directory_service_pb2_grpc.MigrationDirectoryServiceServicer,
):
    """A fake directory with `queues` by id.

    A host gets its own queues when it registers; `tell` reports changes to watchers.
    """

    def __init__(self, *, lease_ttl_nanos: int = 5 * 10**9) -> None:
        super().__init__(lease_ttl_nanos=lease_ttl_nanos)
        self.queues: dict[bytes, queue_pb2.QueueRecord] = {}
        self._watchers: list[asyncio.Queue[queue_pb2.QueueRecord | None]] = []

    def register(self, server: grpc.aio.Server) -> None:
        super().register(server)
        queue_directory_service_pb2_grpc.add_QueueDirectoryServiceServicer_to_server(self, server)
        migration_directory_service_pb2_grpc.add_MigrationDirectoryServiceServicer_to_server(self, server)

    def add_queue(self, name: str, host_id: bytes, **spec: Any) -> queue_pb2.QueueRecord:
        record = queue_pb2.QueueRecord(
            queue_id=secrets.token_bytes(16),
            name=name,
            host_id=host_id,
            epoch=1,
            incarnation=secrets.randbits(64) | 1,
            spec=queue_pb2.QueueSpec(**spec),
            spec_version=1,
        )
        self.queues[record.queue_id] = record
        return record

    async def RegisterHost(self, request: Any, context: Any) -> directory_service_pb2.RegisterHostResponse:  # noqa: N802
        response = await super().RegisterHost(request, context)
        response.queues.extend(one for one in self.queues.values() if one.host_id == request.host_id)
        return response

    async def ResolveQueue(self, request: Any, context: Any) -> pb.ResolveQueueResponse:  # noqa: N802
        await self._begin("ResolveQueue", context)
        record = self.queues.get(request.queue_id)
        if record is None:
            await abort(context, QueueNotFound(f"there is no queue with the id {request.queue_id.hex()}"))
        assert record is not None
        return pb.ResolveQueueResponse(queue=record, host=self.hosts.get(record.host_id))

    async def CommitQueueMove(self, request: Any, context: Any) -> moves_pb.CommitQueueMoveResponse:  # noqa: N802
        await self._begin("CommitQueueMove", context)
        record = self.queues[request.queue_id]
        if (record.host_id, record.epoch) != (request.to_host_id, request.epoch + 1):
            if record.epoch != request.epoch:
                await abort(context, error_for("WRONG_EPOCH", f"the queue is at epoch {record.epoch}"))
            record.host_id, record.epoch = request.to_host_id, record.epoch + 1
        return moves_pb.CommitQueueMoveResponse(queue=record)

    async def Watch(self, request: Any, context: Any) -> AsyncIterator[directory_service_pb2.WatchResponse]:  # noqa: N802
        if not request.include_queues:  # a part of the host that does not watch queues
            async for response in super().Watch(request, context):
                yield response
            return
        changes: asyncio.Queue[queue_pb2.QueueRecord | None] = asyncio.Queue()
        self._watchers.append(changes)
        await self._begin("Watch", context)
        yield directory_service_pb2.WatchResponse(applied_index=1)
        while (record := await changes.get()) is not None:
            kept = record.queue_id in self.queues
            kind = directory_pb2.CHANGE_KIND_UPDATED if kept else directory_pb2.CHANGE_KIND_REMOVED
            yield directory_service_pb2.WatchResponse(changes=[directory_pb2.DirectoryChange(kind=kind, queue=record)])

    def report(self, record: queue_pb2.QueueRecord) -> None:
        """Report the present queue, or its deletion, to watchers."""
        for changes in self._watchers:
            changes.put_nowait(record)

    def break_watches(self) -> None:
        """End every watch."""
        watchers, self._watchers = self._watchers, []
        for changes in watchers:
            changes.put_nowait(None)
