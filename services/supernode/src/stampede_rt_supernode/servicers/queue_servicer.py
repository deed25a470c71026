"""Serves QueueDirectoryService (proto/stampede_rt/v1/queue_directory_service.proto). Each method checks the request,
asks the core or the log, and encodes the response.
"""

# ruff: noqa: N802  # methods have the names of the RPCs
from __future__ import annotations

import secrets

from stampede_rt.v1 import queue_directory_service_pb2 as pb
from stampede_rt.v1 import queue_directory_service_pb2_grpc, queue_pb2
from stampede_rt_runtime.access.control import allowed_to, caller_name, check_known, creation_limit, owner_name
from stampede_rt_runtime.access.rules import AccessKind, AccessVerb
from stampede_rt_runtime.quotas.limits import Quota
from stampede_rt_runtime.rpc import Context, errors_as_status
from stampede_rt_supernode.codecs.host_codec import host_record
from stampede_rt_supernode.codecs.queue_codec import queue_record, queue_spec_from
from stampede_rt_supernode.core import page_tokens
from stampede_rt_supernode.core.cluster.feature_levels import QUEUE_REPLICAS_LEVEL
from stampede_rt_supernode.core.directory import Directory
from stampede_rt_supernode.core.lookups import mailbox_of, queue_by_id, queue_by_name
from stampede_rt_supernode.core.queues.commands import (
    DeleteQueue,
    OpenQueue,
    QueueDeleted,
    QueueOpened,
    QueueUpdated,
    UpdateQueue,
)
from stampede_rt_supernode.core.queues.queries import Position, queue_page
from stampede_rt_supernode.core.queues.transitions import open_queue_unchanged
from stampede_rt_supernode.core.records import ID_BYTES, HostRecord, QueueRecord, QueueSpec
from stampede_rt_supernode.core.tables import Tables
from stampede_rt_supernode.core.validation import check_max_bytes
from stampede_rt_supernode.servicers.calls import DirectoryCalls
from stampede_rt_supernode.servicers.listing import SearchStep, list_shown


class QueueDirectoryServicer(queue_directory_service_pb2_grpc.QueueDirectoryServiceServicer):
    """One supernode's answers about queues and mailboxes."""

    def __init__(self, calls: DirectoryCalls) -> None:
        self._calls = calls

    @errors_as_status
    async def OpenQueue(self, request: pb.OpenQueueRequest, context: Context) -> pb.OpenQueueResponse:
        """Open a queue. If nothing changes, a confirmed read answers the first attempt without a log entry."""
        as_of = self._calls.applied_index()
        check_known(AccessKind.QUEUE, request.name)
        spec = await self._checked_spec(context, request.name, request.spec)
        operation = OpenQueue(
            name=request.name,
            spec=spec,
            create=request.create,
            host_name=request.host_name,
            new_queue_id=secrets.token_bytes(ID_BYTES),
            new_incarnation=secrets.randbits(64) or 1,
            created_by=caller_name(),
            created_max=creation_limit(Quota.QUEUES),
        )

        async def check(operation: OpenQueue) -> None:
            if self._calls.check_opening(AccessKind.QUEUE, operation):
                await self._check_dead_letter(context, request.spec)

        opened = await self._calls.open(
            context,
            operation,
            QueueOpened,
            request.request_id,
            as_of_index=as_of,
            unchanged=open_queue_unchanged,
            check=check,
        )
        return pb.OpenQueueResponse(
            queue=queue_record(opened.queue), host=host_record(opened.host), created=opened.created
        )

    @errors_as_status
    async def ResolveQueue(self, request: pb.ResolveQueueRequest, context: Context) -> pb.ResolveQueueResponse:

        def find(directory: Directory) -> tuple[QueueRecord, HostRecord, int]:
            queue = _resolved(directory.tables, request)
            return queue, directory.tables.hosts[queue.host_id], directory.applied_index

        match request.WhichOneof("key"):
            case "name":
                check_known(AccessKind.QUEUE, request.name)
            case "peer_name":
                check_known(AccessKind.PEER, request.peer_name)
        queue, host, index = await self._calls.read(context, find, stale_ok=request.stale_ok)
        check_queue_known(queue)
        return pb.ResolveQueueResponse(queue=queue_record(queue), host=host_record(host), applied_index=index)

    @errors_as_status
    async def UpdateQueue(self, request: pb.UpdateQueueRequest, context: Context) -> pb.UpdateQueueResponse:
        await self._calls.check_thing(context, AccessVerb.CONFIGURE, AccessKind.QUEUE, request.queue_id)
        await self._check_dead_letter(context, request.spec)
        spec = await self._checked_spec(context, request.queue_id.hex(), request.spec)
        operation = UpdateQueue(queue_id=request.queue_id, epoch=request.epoch, spec=spec)
        updated = await self._calls.submit(context, operation, QueueUpdated, request.request_id)
        return pb.UpdateQueueResponse(queue=queue_record(updated.queue))

    @errors_as_status
    async def DeleteQueue(self, request: pb.DeleteQueueRequest, context: Context) -> pb.DeleteQueueResponse:
        await self._calls.check_thing(context, AccessVerb.DELETE, AccessKind.QUEUE, request.queue_id)
        await self._calls.submit(context, DeleteQueue(queue_id=request.queue_id), QueueDeleted, request.request_id)
        return pb.DeleteQueueResponse()

    @errors_as_status
    async def ListQueues(self, request: pb.ListQueuesRequest, context: Context) -> pb.ListQueuesResponse:
        listing = f"queues\0{request.name_glob}\0{request.include_mailboxes}"

        def search(
            directory: Directory, after: Position, most: int
        ) -> SearchStep[tuple[QueueRecord, HostRecord], Position]:
            tables = directory.tables
            page = queue_page(tables, request.name_glob, after, most, mailboxes=request.include_mailboxes)
            found = zip(page.positions, page.queues, strict=True)
            return SearchStep([(at, (queue, tables.hosts[queue.host_id])) for at, queue in found], page.last)

        may_list_queue, may_list_peer = (
            allowed_to(AccessVerb.LIST, kind) for kind in (AccessKind.QUEUE, AccessKind.PEER)
        )

        def is_shown(found: tuple[QueueRecord, HostRecord]) -> bool:
            queue, _ = found
            return (
                may_list_queue(queue.name) if queue.mailbox_peer_id is None else may_list_peer(queue.mailbox_peer_name)
            )

        page = await list_shown(
            self._calls,
            context,
            search,
            is_shown,
            page_tokens.read_position(request.page_token, listing),
            request.page_size,
            stale_ok=request.stale_ok,
        )
        return pb.ListQueuesResponse(
            queues=[queue_record(queue) for queue, _ in page.things],
            hosts=map(host_record, {host.host_id: host for _, host in page.things}.values()),
            next_page_token=page_tokens.write_position(listing, page.last),
            applied_index=page.applied_index,
        )

    async def _checked_spec(self, context: Context, queue: str, stated: queue_pb2.QueueSpec) -> QueueSpec:
        """Return the stated policy.

        Raises InvalidArgument, also if the policy has replicas and the feature level is below QUEUE_REPLICAS_LEVEL.
        """
        spec = queue_spec_from(stated)
        check_max_bytes("queue", queue, spec.max_bytes)
        if (spec.replicas, spec.ack, spec.min_replicas) != (None, None, None):
            await self._calls.check_level(context, "a queue with replicas", QUEUE_REPLICAS_LEVEL)
        return spec

    async def _check_dead_letter(self, context: Context, spec: queue_pb2.QueueSpec) -> None:
        """Check that the caller may send to the dead-letter queue.

        Later the host sends messages to that queue, and rules of access do not limit hosts.
        """
        if spec.HasField("dead_letter_queue_id"):
            await self._calls.check_thing(context, AccessVerb.SEND, AccessKind.QUEUE, spec.dead_letter_queue_id)


def check_queue_known(queue: QueueRecord) -> None:
    """Raises an error for a queue or mailbox that the caller may not know."""
    if queue.mailbox_peer_id is None:
        check_known(AccessKind.QUEUE, queue.name, by_id=True)
    elif queue.mailbox_owner is None or queue.mailbox_owner != owner_name():
        check_known(AccessKind.PEER, queue.mailbox_peer_name, by_id=True)


def _resolved(tables: Tables, request: pb.ResolveQueueRequest) -> QueueRecord:
    match request.WhichOneof("key"):
        case "name":
            return queue_by_name(tables, request.name)
        case "peer_name":
            return mailbox_of(tables, request.peer_name)
        case _:
            return queue_by_id(tables, request.queue_id)
