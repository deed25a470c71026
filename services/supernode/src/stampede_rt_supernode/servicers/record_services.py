"""The services of the directory's other records, groups and copies, on the port of DirectoryService."""

from __future__ import annotations

import grpc

from stampede_rt.v1 import group_directory_service_pb2_grpc as groups
from stampede_rt.v1 import replica_directory_service_pb2_grpc as replicas
from stampede_rt_supernode.servicers.calls import DirectoryCalls
from stampede_rt_supernode.servicers.group_servicer import GroupDirectoryServicer
from stampede_rt_supernode.servicers.load_keeper import LoadKeeper
from stampede_rt_supernode.servicers.replica_servicer import ReplicaDirectoryServicer


def register_record_services(server: grpc.aio.Server, calls: DirectoryCalls, loads: LoadKeeper) -> None:
    """Before the server is started."""
    groups.add_GroupDirectoryServiceServicer_to_server(GroupDirectoryServicer(calls), server)
    replicas.add_ReplicaDirectoryServiceServicer_to_server(ReplicaDirectoryServicer(calls, loads), server)
