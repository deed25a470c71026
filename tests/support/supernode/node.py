"""One supernode on an in-memory log, served over gRPC, with a manual clock."""

from __future__ import annotations

import secrets
from collections.abc import AsyncIterator, Awaitable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from typing import Any, TypeVar

import grpc
import pytest

from stampede_rt.errors import StampedeError
from stampede_rt.status import from_rpc_error
from stampede_rt.v1 import (
    channel_pb2,
    directory_pb2,
    directory_service_pb2_grpc,
    group_directory_service_pb2_grpc,
    peer_service_pb2_grpc,
    queue_directory_service_pb2_grpc,
    replica_directory_service_pb2_grpc,
)
from stampede_rt.v1 import directory_service_pb2 as pb
from stampede_rt_runtime.access.control import AccessControl
from stampede_rt_runtime.dial import dial
from stampede_rt_runtime.server import serving
from stampede_rt_supernode.joining.members import Members
from stampede_rt_supernode.joining.probe import Probe
from stampede_rt_supernode.replica import DirectoryReplica
from stampede_rt_supernode.servicers.calls import DirectoryCalls
from stampede_rt_supernode.servicers.directory_servicer import DirectoryServicer
from stampede_rt_supernode.servicers.lease_keeper import LeaseKeeper
from stampede_rt_supernode.servicers.load_keeper import LoadKeeper
from stampede_rt_supernode.servicers.own_cluster import OwnCluster
from stampede_rt_supernode.servicers.record_services import register_record_services
from stampede_rt_supernode.servicers.submission import Submission
from stampede_rt_supernode.servicers.watch import Watches
from tests.support.clock import ManualClock
from tests.support.supernode.memory_log import MemoryLog
from tests.support.supernode.operations import TTL_NANOS, id_of

T = TypeVar("T")


@dataclass
class Node:
    """A running supernode and a stub to call it."""

    log: MemoryLog
    replica: DirectoryReplica
    leases: LeaseKeeper
    watches: Watches
    probe: Probe
    submission: Submission
    clock: ManualClock
    address: str
    stub: Any
    groups: Any
    replicas: Any
    queues: Any
    peers: Any

    async def open(self, name: str, **fields: Any) -> pb.OpenChannelResponse:
        fields = {"request_id": secrets.token_bytes(16), "create": True, **fields}
        return await self.call(self.stub.OpenChannel(pb.OpenChannelRequest(name=name, **fields), timeout=10))

    async def register(self, number: int, *, boot: int = 1, name: str = "") -> pb.RegisterHostResponse:
        request = pb.RegisterHostRequest(
            request_id=secrets.token_bytes(16),
            host_id=id_of(number),
            name=name or f"host-{number}",
            gatekeepers=[directory_pb2.Endpoint(target=f"localhost:{7000 + number}")],
            boot_incarnation=boot,
            registration_epoch=boot - 1,
        )
        return await self.call(self.stub.RegisterHost(request, timeout=10))

    async def renew(self, number: int, *, boot: int = 1, registered_index: int = 0) -> pb.RenewHostLeaseResponse:
        request = pb.RenewHostLeaseRequest(
            host_id=id_of(number), boot_incarnation=boot, registered_index=registered_index
        )
        return await self.call(self.stub.RenewHostLease(request, timeout=10))

    async def host(self, number: int) -> directory_pb2.HostRecord:
        request = pb.ResolveHostRequest(host_id=id_of(number))
        found: pb.ResolveHostResponse = await self.call(self.stub.ResolveHost(request, timeout=10))
        return found.host

    @staticmethod
    async def call(pending: Awaitable[T]) -> T:
        """Return the answer. Raises the StampedeError of the call."""
        try:
            return await pending
        except grpc.aio.AioRpcError as error:
            raise from_rpc_error(error, "the supernode") from error

    async def pass_seconds(self, seconds: float) -> None:
        """Advance the clock in steps of a second. The leader checks its leases at each step."""
        while seconds > 0:
            step = min(seconds, 1.0)
            self.clock.advance(round(step * 1e9))
            await self.leases.tick()
            seconds -= step


@asynccontextmanager
async def running_node(*, sign_of_life_seconds: float = 60.0) -> AsyncIterator[Node]:
    replica, clock = DirectoryReplica(), ManualClock()
    log = MemoryLog(replica)
    submission = Submission(log, replica, time_unix_nano=clock.time_unix_nano)
    leases = LeaseKeeper(log, replica, submission, clock=clock, founding_ttl_nanos=TTL_NANOS)
    watches = Watches(replica, log, sign_of_life_seconds=sign_of_life_seconds)
    probe = Probe(log, lambda target: dial(target, secret=None))
    members = Members(log, replica, probe, advertise="rig:7581", zone="lab")
    own_cluster = OwnCluster(replica)
    servicer = DirectoryServicer(replica, submission, leases, watches, members, clock, own_cluster, AccessControl())
    await leases.tick()

    def register(server: grpc.aio.Server) -> None:
        directory_service_pb2_grpc.add_DirectoryServiceServicer_to_server(servicer, server)
        loads = LoadKeeper(log, replica, clock=clock)
        register_record_services(server, DirectoryCalls(replica, submission), loads, leases, watches)

    async with (
        serving(register, judge_cluster=own_cluster.judge) as server,
        dial(server.address, secret=None) as channel,
    ):
        stub = directory_service_pb2_grpc.DirectoryServiceStub(channel)
        groups = group_directory_service_pb2_grpc.GroupDirectoryServiceStub(channel)
        replicas = replica_directory_service_pb2_grpc.ReplicaDirectoryServiceStub(channel)
        queues = queue_directory_service_pb2_grpc.QueueDirectoryServiceStub(channel)
        peers = peer_service_pb2_grpc.PeerServiceStub(channel)
        parts = (log, replica, leases, watches, probe, submission, clock, server.address)
        yield Node(*parts, stub, groups, replicas, queues, peers)
        watches.close()


async def reason_of(pending: Awaitable[Any]) -> StampedeError:
    """Return the error of `pending`."""
    with pytest.raises(StampedeError) as caught:
        await Node.call(pending)
    return caught.value


def spec(**limits: int) -> channel_pb2.ChannelSpec:
    return channel_pb2.ChannelSpec(retention=channel_pb2.RetentionPolicy(**limits))
