"""Registers the services for groups, replicas, moves, queues and peers, on the port of DirectoryService."""

from __future__ import annotations

import grpc

from stampede_rt.v1 import group_directory_service_pb2_grpc as groups
from stampede_rt.v1 import migration_directory_service_pb2_grpc as moves
from stampede_rt.v1 import peer_service_pb2_grpc as peers
from stampede_rt.v1 import queue_directory_service_pb2_grpc as queues
from stampede_rt.v1 import replica_directory_service_pb2_grpc as replicas
from stampede_rt_supernode.servicers.calls import DirectoryCalls
from stampede_rt_supernode.servicers.group_servicer import GroupDirectoryServicer
from stampede_rt_supernode.servicers.lease_keeper import LeaseKeeper
from stampede_rt_supernode.servicers.load_keeper import LoadKeeper
from stampede_rt_supernode.servicers.migration_servicer import MigrationDirectoryServicer
from stampede_rt_supernode.servicers.peer_servicer import PeerServicer
from stampede_rt_supernode.servicers.queue_servicer import QueueDirectoryServicer
from stampede_rt_supernode.servicers.replica_servicer import ReplicaDirectoryServicer
from stampede_rt_supernode.servicers.watch import Watches


def register_record_services(
    server: grpc.aio.Server, calls: DirectoryCalls, loads: LoadKeeper, leases: LeaseKeeper, watches: Watches
) -> None:
    """Register the services. Call this function before the server starts."""
    groups.add_GroupDirectoryServiceServicer_to_server(GroupDirectoryServicer(calls), server)
    replicas.add_ReplicaDirectoryServiceServicer_to_server(ReplicaDirectoryServicer(calls, loads), server)
    moves.add_MigrationDirectoryServiceServicer_to_server(MigrationDirectoryServicer(calls), server)
    queues.add_QueueDirectoryServiceServicer_to_server(QueueDirectoryServicer(calls), server)
    peers.add_PeerServiceServicer_to_server(PeerServicer(calls, leases, watches), server)
