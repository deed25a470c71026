"""The host's calls to the directory about copies (paper, sections 4.1 and 4.3)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from stampede_rt.v1 import replica_directory_service_pb2 as pb
from stampede_rt.v1 import replica_directory_service_pb2_grpc, replica_pb2, subject_pb2
from stampede_rt_channel_host.cluster.supernodes import Supernodes

CALL_SECONDS_MAX = 4.0


class FeedSource(NamedTuple):
    """The host that feeds a copy, and the epoch of the channel. `target` is empty if that host is not alive."""

    host_id: bytes
    target: str
    epoch: int


class ReplicaDirectory:
    """Asks the directory about copies, and reports their loads.

    Each method waits for CALL_SECONDS_MAX at most. It raises the error with which the directory answers, or
    Unavailable.
    """

    def __init__(self, supernodes: Supernodes) -> None:
        self._supernodes = supernodes

    async def source_of(self, channel_id: bytes, host_id: bytes) -> FeedSource | None:
        """The host that feeds the copy of the channel at the host `host_id`; None if the directory has no such copy.

        Raises ChannelNotFound.
        """
        request = pb.ListReplicasRequest(subject=subject_pb2.Subject(channel_id=channel_id))
        response: pb.ListReplicasResponse = await self._call("ListReplicas", request)
        replica = next((one for one in response.replicas if one.host_id == host_id), None)
        if replica is None:
            return None
        source = next((one for one in response.hosts if one.host_id == replica.source_host_id), None)
        target = source.gatekeepers[0].target if source is not None and source.alive and source.gatekeepers else ""
        return FeedSource(replica.source_host_id, target, response.epoch)

    async def report(
        self, host_id: bytes, boot_incarnation: int, loads: Sequence[replica_pb2.ReplicaLoad]
    ) -> Sequence[bytes]:
        """Report loads to the leader. Returns the reported channels that this host holds no more."""
        request = pb.ReportReplicaLoadsRequest(host_id=host_id, boot_incarnation=boot_incarnation, loads=loads)
        response: pb.ReportReplicaLoadsResponse = await self._call("ReportReplicaLoads", request)
        return response.gone_channel_ids

    async def _call(self, method: str, request: object) -> Any:
        stub = replica_directory_service_pb2_grpc.ReplicaDirectoryServiceStub
        return await self._supernodes.call(method, request, CALL_SECONDS_MAX, service=stub)
