"""Serves ReplicaDirectoryService (proto/stampede_rt/v1/replica_directory_service.proto). Each method checks the
request, asks the core or the log, and encodes the response.
"""

# ruff: noqa: N802  # methods bear the names of the RPCs
from __future__ import annotations

from dataclasses import dataclass

from stampede_rt.v1 import replica_directory_service_pb2 as pb
from stampede_rt.v1 import replica_directory_service_pb2_grpc
from stampede_rt_runtime.access.control import check_known
from stampede_rt_runtime.access.rules import AccessKind, AccessVerb
from stampede_rt_runtime.rpc import Context, errors_as_status
from stampede_rt_supernode.codecs.host_codec import host_record
from stampede_rt_supernode.codecs.replica_codec import (
    channel_id_of,
    kind_from,
    load_from,
    load_message,
    replica_record,
)
from stampede_rt_supernode.core.directory import Directory
from stampede_rt_supernode.core.lookups import channel_by_id
from stampede_rt_supernode.core.records import ChannelRecord, HostRecord, ReplicaRecord
from stampede_rt_supernode.core.replicas.commands import (
    AddReplica,
    RemoveReplica,
    ReplicaAdded,
    ReplicaInSyncSet,
    ReplicaRemoved,
    SetReplicaInSync,
)
from stampede_rt_supernode.servicers.calls import DirectoryCalls
from stampede_rt_supernode.servicers.load_keeper import LoadKeeper


class ReplicaDirectoryServicer(replica_directory_service_pb2_grpc.ReplicaDirectoryServiceServicer):
    """One supernode's answers about copies of channels."""

    def __init__(self, calls: DirectoryCalls, loads: LoadKeeper) -> None:
        self._calls = calls
        self._loads = loads

    @errors_as_status
    async def AddReplica(self, request: pb.AddReplicaRequest, context: Context) -> pb.AddReplicaResponse:
        channel_id = channel_id_of(request.subject)
        await self._calls.check_thing(context, AccessVerb.CONFIGURE, AccessKind.CHANNEL, channel_id)
        operation = AddReplica(
            channel_id=channel_id,
            epoch=request.epoch,
            host_id=request.host_id,
            kind=kind_from(request.kind),
            source_host_id=request.source_host_id,
            acknowledged=request.acknowledged,
        )
        added = await self._calls.submit(context, operation, ReplicaAdded, request.request_id)
        return pb.AddReplicaResponse(replica=replica_record(added.replica), host=host_record(added.host))

    @errors_as_status
    async def RemoveReplica(self, request: pb.RemoveReplicaRequest, context: Context) -> pb.RemoveReplicaResponse:
        channel_id = channel_id_of(request.subject)
        await self._calls.check_thing(context, AccessVerb.CONFIGURE, AccessKind.CHANNEL, channel_id)
        operation = RemoveReplica(channel_id=channel_id, host_id=request.host_id)
        await self._calls.submit(context, operation, ReplicaRemoved, request.request_id)
        return pb.RemoveReplicaResponse()

    @errors_as_status
    async def SetReplicaInSync(
        self, request: pb.SetReplicaInSyncRequest, context: Context
    ) -> pb.SetReplicaInSyncResponse:
        """In a cluster with certificates only the owner of the channel may call this."""
        channel_id = channel_id_of(request.subject)
        owner = await self._calls.read(context, lambda directory: channel_by_id(directory.tables, channel_id).host_id)
        self._calls.check_host(context, owner)
        operation = SetReplicaInSync(
            channel_id=channel_id,
            epoch=request.epoch,
            host_id=request.host_id,
            boot_incarnation=request.boot_incarnation,
            in_sync=request.in_sync,
            change_number=request.change_number,
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
        channel_id = channel_id_of(request.subject)
        found = await self._calls.read(context, lambda one: _find(one, channel_id), stale_ok=request.stale_ok)
        check_known(AccessKind.CHANNEL, found.channel.name, by_id=True)
        loads = self._loads.of(channel_id, [host.host_id for host in found.hosts])
        return pb.ListReplicasResponse(
            replicas=[replica_record(replica) for replica in found.replicas],
            loads=[load_message(load) for load in loads],
            hosts=[host_record(host) for host in found.hosts],
            owner_host_id=found.channel.host_id,
            epoch=found.channel.epoch,
            applied_index=found.applied_index,
        )


@dataclass(frozen=True, slots=True)
class _Found:
    channel: ChannelRecord
    replicas: tuple[ReplicaRecord, ...]
    hosts: tuple[HostRecord, ...]  # the owner, then the hosts of the copies
    applied_index: int


def _find(directory: Directory, channel_id: bytes) -> _Found:
    tables = directory.tables
    channel = channel_by_id(tables, channel_id)
    replicas = tables.replicas.of(channel_id)
    host_ids = (channel.host_id, *(replica.host_id for replica in replicas))
    return _Found(channel, replicas, tuple(tables.hosts[one] for one in host_ids), directory.applied_index)
