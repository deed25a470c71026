"""Serves ReplicaDirectoryService (proto/stampede_rt/v1/replica_directory_service.proto). Each method checks the
request, asks the core or the log, and encodes the response.
"""

# ruff: noqa: N802  # methods have the names of the RPCs
from __future__ import annotations

from dataclasses import dataclass

from stampede_rt.v1 import replica_directory_service_pb2 as pb
from stampede_rt.v1 import replica_directory_service_pb2_grpc, subject_pb2
from stampede_rt_runtime.access.control import check_known
from stampede_rt_runtime.access.rules import AccessKind, AccessVerb
from stampede_rt_runtime.rpc import Context, errors_as_status
from stampede_rt_supernode.codecs.host_codec import host_record
from stampede_rt_supernode.codecs.replica_codec import (
    copied_subject,
    kind_from,
    load_from,
    load_message,
    replica_record,
)
from stampede_rt_supernode.core.cluster.feature_levels import CALLERS_FACTS_LEVEL, QUEUE_REPLICAS_LEVEL
from stampede_rt_supernode.core.command_table import subject_of
from stampede_rt_supernode.core.directory import Directory
from stampede_rt_supernode.core.records import HostRecord, QueueRecord, ReplicaRecord
from stampede_rt_supernode.core.replicas.commands import (
    AddReplica,
    RemoveReplica,
    ReplicaAdded,
    ReplicaInSyncSet,
    ReplicaRemoved,
    SetReplicaInSync,
)
from stampede_rt_supernode.core.replicas.copied_subjects import Copied, copied_by_id
from stampede_rt_supernode.core.replicas.transitions import check_agrees_with_policy, check_has_host, is_left_to_owner
from stampede_rt_supernode.servicers.calls import DirectoryCalls
from stampede_rt_supernode.servicers.load_keeper import LoadKeeper
from stampede_rt_supernode.servicers.queue_servicer import check_queue_known


class ReplicaDirectoryServicer(replica_directory_service_pb2_grpc.ReplicaDirectoryServiceServicer):
    """One supernode's answers about copies of channels and queues."""

    def __init__(self, calls: DirectoryCalls, loads: LoadKeeper) -> None:
        self._calls = calls
        self._loads = loads

    @errors_as_status
    async def AddReplica(self, request: pb.AddReplicaRequest, context: Context) -> pb.AddReplicaResponse:
        subject_id, is_of_queue = await self._check_configures(context, request.subject)
        operation = AddReplica(
            channel_id=subject_id,
            is_of_queue=is_of_queue,
            epoch=request.epoch,
            host_id=request.host_id,
            kind=kind_from(request.kind),
            source_host_id=request.source_host_id,
            acknowledged=request.acknowledged,
        )
        await self._calls.read(context, lambda one: _check_has_host(one, operation, request.request_id))
        added = await self._calls.submit(context, operation, ReplicaAdded, request.request_id)
        return pb.AddReplicaResponse(replica=replica_record(added.replica), host=host_record(added.host))

    @errors_as_status
    async def RemoveReplica(self, request: pb.RemoveReplicaRequest, context: Context) -> pb.RemoveReplicaResponse:
        subject_id, is_of_queue = await self._check_configures(context, request.subject)
        operation = RemoveReplica(
            channel_id=subject_id, is_of_queue=is_of_queue, host_id=request.host_id, epoch=request.epoch
        )
        if not await self._calls.read(context, lambda one: _leaves_to_owner(one, operation)):
            await self._calls.submit(context, operation, ReplicaRemoved, request.request_id)
        return pb.RemoveReplicaResponse()

    @errors_as_status
    async def SetReplicaInSync(
        self, request: pb.SetReplicaInSyncRequest, context: Context
    ) -> pb.SetReplicaInSyncResponse:
        """In a cluster with certificates only the owner of the channel or queue may call this."""
        subject_id, is_of_queue = copied_subject(request.subject)
        found = await self._calls.read(context, lambda one: _find(one, subject_id, is_of_queue=is_of_queue))
        self._calls.check_host(context, found.subject.host_id)
        operation = SetReplicaInSync(
            channel_id=subject_id,
            is_of_queue=is_of_queue,
            epoch=request.epoch,
            host_id=request.host_id,
            boot_incarnation=request.boot_incarnation,
            in_sync=request.in_sync,
            change_number=request.change_number,
            added_index=request.added_index,
        )
        done = await self._calls.submit(context, operation, ReplicaInSyncSet, request.request_id)
        return pb.SetReplicaInSyncResponse(replica=replica_record(done.replica))

    @errors_as_status
    async def ReportReplicaLoads(
        self, request: pb.ReportReplicaLoadsRequest, context: Context
    ) -> pb.ReportReplicaLoadsResponse:
        """Makes no log entry."""
        self._calls.check_host(context, request.host_id)
        loads = [load_from(load) for load in request.loads]
        gone = self._loads.report(request.host_id, request.boot_incarnation, loads)
        return pb.ReportReplicaLoadsResponse(gone_channel_ids=gone)

    @errors_as_status
    async def ListReplicas(self, request: pb.ListReplicasRequest, context: Context) -> pb.ListReplicasResponse:
        subject_id, is_of_queue = copied_subject(request.subject)
        found = await self._calls.read(
            context, lambda one: _find(one, subject_id, is_of_queue=is_of_queue), stale_ok=request.stale_ok
        )
        if isinstance(found.subject, QueueRecord):
            check_queue_known(found.subject)
        else:
            check_known(AccessKind.CHANNEL, found.subject.name, by_id=True)
        loads = self._loads.of(subject_id, [host.host_id for host in found.hosts])
        return pb.ListReplicasResponse(
            replicas=[replica_record(replica) for replica in found.replicas],
            loads=[load_message(load) for load in loads],
            hosts=[host_record(host) for host in found.hosts],
            owner_host_id=found.subject.host_id,
            epoch=found.subject.epoch,
            applied_index=found.applied_index,
        )

    async def _check_configures(self, context: Context, subject: subject_pb2.Subject) -> tuple[bytes, bool]:
        """The id of the copied subject, and whether it is a queue. Raises PermissionDenied."""
        subject_id, is_of_queue = copied_subject(subject)
        if is_of_queue:
            await self._calls.check_level(context, "a replica of a queue", QUEUE_REPLICAS_LEVEL)
        kind = AccessKind.QUEUE if is_of_queue else AccessKind.CHANNEL
        await self._calls.check_thing(context, AccessVerb.CONFIGURE, kind, subject_id)
        return subject_id, is_of_queue


@dataclass(frozen=True, slots=True)
class _FoundReplicas:
    subject: Copied
    replicas: tuple[ReplicaRecord, ...]
    hosts: tuple[HostRecord, ...]  # the owner, then the hosts of the copies
    applied_index: int


def _check_has_host(directory: Directory, operation: AddReplica, request_id: bytes) -> None:
    """Refuse a copy for which no host is free, or that contradicts the policy, without an entry in the log: the owner
    repeats its request.

    A request that comes again gets its former answer.
    """
    if directory.kept_answers.find(request_id, subject_of(operation)) is None:
        check_has_host(directory.tables, operation)
        if directory.feature_level >= CALLERS_FACTS_LEVEL:
            check_agrees_with_policy(directory.tables, operation)


def _leaves_to_owner(directory: Directory, operation: RemoveReplica) -> bool:
    """Whether the directory does nothing, without an entry in the log: owners of an earlier release repeat it."""
    return directory.feature_level >= CALLERS_FACTS_LEVEL and is_left_to_owner(directory.tables, operation)


def _find(directory: Directory, subject_id: bytes, *, is_of_queue: bool) -> _FoundReplicas:
    tables = directory.tables
    subject = copied_by_id(tables, subject_id, is_of_queue=is_of_queue)
    replicas = tables.replicas.of(subject_id)
    host_ids = (subject.host_id, *(replica.host_id for replica in replicas))
    return _FoundReplicas(subject, replicas, tuple(tables.hosts[one] for one in host_ids), directory.applied_index)
