"""The host's calls to the directory about copies (paper, sections 4.1 and 4.3)."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any, NamedTuple

from stampede_rt.v1 import replica_directory_service_pb2 as pb
from stampede_rt.v1 import replica_directory_service_pb2_grpc, replica_pb2, subject_pb2
from stampede_rt_channel_host.cluster.identity import ID_BYTES
from stampede_rt_channel_host.cluster.supernodes import Supernodes
from stampede_rt_channel_host.core.replication import KnownReplica, ReplicaChange

CALL_SECONDS_MAX = 4.0
ADD_SECONDS_MAX = 1.0  # the flags of other replicas wait meanwhile


class FeedSource(NamedTuple):
    """The host that feeds a copy, and the epoch of the channel. `target` is empty if that host is not alive.

    If the source is the host of the copy itself, this host has become the owner.
    """

    host_id: bytes
    target: str
    epoch: int
    is_replica: bool = False


class ListedReplica(NamedTuple):
    """A replica as the directory lists it. `target` is the gatekeeper of its host; empty if the host is not alive.

    `acknowledged`: puts wait for the replica, as the owner that added it has said.
    """

    known: KnownReplica
    target: str
    acknowledged: bool


class ListedReplicas(NamedTuple):
    """The replicas of a channel, without its proxies; and its owner."""

    owner_host_id: bytes
    epoch: int
    replicas: list[ListedReplica]


class ReplicaDirectory:
    """Asks the directory about copies, and reports their loads.

    Each method waits for CALL_SECONDS_MAX at most. It raises the error with which the directory answers, or
    Unavailable.
    """

    def __init__(self, supernodes: Supernodes, *, of_queues: bool = False) -> None:
        """`of_queues`: the subjects of all calls are queues, and not channels."""
        self._supernodes = supernodes
        self._is_of_queues = of_queues

    def _subject(self, subject_id: bytes) -> subject_pb2.Subject:
        if self._is_of_queues:
            return subject_pb2.Subject(queue_id=subject_id)
        return subject_pb2.Subject(channel_id=subject_id)

    async def source_of(self, subject_id: bytes, host_id: bytes) -> FeedSource | None:
        """The host that feeds the copy at the host `host_id`; None if the directory has no such copy.

        Raises ChannelNotFound, QueueNotFound.
        """
        request = pb.ListReplicasRequest(subject=self._subject(subject_id))
        response: pb.ListReplicasResponse = await self._call("ListReplicas", request)
        if response.owner_host_id == host_id:
            return FeedSource(host_id, "", response.epoch)
        replica = next((one for one in response.replicas if one.host_id == host_id), None)
        if replica is None:
            return None
        is_replica = replica.kind == replica_pb2.REPLICA_KIND_WARM
        target = _targets(response).get(replica.source_host_id, "")
        return FeedSource(replica.source_host_id, target, response.epoch, is_replica)

    async def replicas_of(self, subject_id: bytes) -> ListedReplicas:
        """The replicas of a channel or queue. Raises ChannelNotFound, QueueNotFound."""
        request = pb.ListReplicasRequest(subject=self._subject(subject_id))
        response: pb.ListReplicasResponse = await self._call("ListReplicas", request)
        targets = _targets(response)
        replicas = [
            ListedReplica(
                KnownReplica(one.host_id, one.boot_incarnation, one.in_sync, one.added_index),
                targets.get(one.host_id, ""),
                one.acknowledged,
            )
            for one in response.replicas
            if one.kind == replica_pb2.REPLICA_KIND_WARM
        ]
        return ListedReplicas(response.owner_host_id, response.epoch, replicas)

    async def add_replica(self, subject_id: bytes, epoch: int, *, acknowledged: bool) -> None:
        """Add a replica at a host that the directory chooses. `acknowledged`: puts wait for it.

        Raises Unavailable (NO_HOST) immediately if there is no host.
        """
        request = pb.AddReplicaRequest(
            request_id=os.urandom(ID_BYTES),
            subject=self._subject(subject_id),
            epoch=epoch,
            kind=replica_pb2.REPLICA_KIND_WARM,
            acknowledged=acknowledged,
        )
        await self._call("AddReplica", request, ADD_SECONDS_MAX, final_reason="NO_HOST")

    async def remove_replica(self, subject_id: bytes, epoch: int, host_id: bytes) -> None:
        """Remove the replica at a host. Raises StaleBinding."""
        request = pb.RemoveReplicaRequest(
            request_id=os.urandom(ID_BYTES), subject=self._subject(subject_id), host_id=host_id, epoch=epoch
        )
        await self._call("RemoveReplica", request)

    async def change(self, subject_id: bytes, epoch: int, change: ReplicaChange) -> None:
        """Set or clear the in-sync flag of a replica. Raises StaleBinding, HostNotFound, InvalidArgument."""
        request = pb.SetReplicaInSyncRequest(
            request_id=os.urandom(ID_BYTES),
            subject=self._subject(subject_id),
            epoch=epoch,
            host_id=change.host_id,
            boot_incarnation=change.boot_incarnation,
            in_sync=change.in_sync,
            change_number=change.number,
            added_index=change.added_index,
        )
        await self._call("SetReplicaInSync", request)

    async def report(
        self, host_id: bytes, boot_incarnation: int, loads: Sequence[replica_pb2.ReplicaLoad]
    ) -> Sequence[bytes]:
        """Report loads to the leader. Returns the reported channels that this host no longer holds."""
        request = pb.ReportReplicaLoadsRequest(host_id=host_id, boot_incarnation=boot_incarnation, loads=loads)
        response: pb.ReportReplicaLoadsResponse = await self._call("ReportReplicaLoads", request)
        return response.gone_channel_ids

    async def _call(
        self, method: str, request: object, seconds_max: float = CALL_SECONDS_MAX, final_reason: str | None = None
    ) -> Any:
        stub = replica_directory_service_pb2_grpc.ReplicaDirectoryServiceStub
        return await self._supernodes.call(method, request, seconds_max, service=stub, final_reason=final_reason)


def _targets(response: pb.ListReplicasResponse) -> dict[bytes, str]:
    """The gatekeepers of the live hosts, by host."""
    return {one.host_id: one.gatekeepers[0].target for one in response.hosts if one.alive and one.gatekeepers}
