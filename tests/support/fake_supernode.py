"""A fake supernode that only answers probes. The test sets its answers."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from stampede_rt.v1 import directory_pb2, directory_service_pb2, directory_service_pb2_grpc


@dataclass
class FakeSupernode(directory_service_pb2_grpc.DirectoryServiceServicer):
    """A fake supernode. `members`: id -> target. `pings` counts the answers."""

    supernode_id: str = "s1"
    cluster_id: str = "c1"
    ready: bool = True
    members: dict[str, str] = field(default_factory=dict)
    pings: int = 0

    async def Ping(self, request: Any, context: Any) -> directory_service_pb2.DirectoryServicePingResponse:  # noqa: N802
        self.pings += 1
        return directory_service_pb2.DirectoryServicePingResponse(
            supernode_id=self.supernode_id, ready=self.ready, cluster_id=self.cluster_id
        )

    async def ListSupernodes(  # noqa: N802
        self, request: Any, context: Any
    ) -> directory_service_pb2.ListSupernodesResponse:
        records = [
            directory_pb2.SupernodeRecord(supernode_id=name, endpoint=directory_pb2.Endpoint(target=target))
            for name, target in self.members.items()
        ]
        return directory_service_pb2.ListSupernodesResponse(supernodes=records, term=1, applied_index=1)
