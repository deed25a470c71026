"""A directory in memory behind real gRPC, with all that a channel host needs from supernodes and front-ends."""

from __future__ import annotations

import asyncio
import secrets
from collections import Counter
from collections.abc import AsyncIterator
from typing import Any

import grpc

from stampede_rt.cluster.cluster_ids import named_cluster
from stampede_rt.errors import ChannelNotFound, HostExists, LeaseExpired, StaleRegistration, StampedeError, error_for
from stampede_rt.status import abort
from stampede_rt.v1 import (
    channel_pb2,
    directory_pb2,
    directory_service_pb2_grpc,
    frontend_service_pb2,
    frontend_service_pb2_grpc,
)
from stampede_rt.v1 import directory_service_pb2 as pb


class FakeDirectory(
    directory_service_pb2_grpc.DirectoryServiceServicer, frontend_service_pb2_grpc.FrontendServiceServicer
):
    """A fake directory. `refuse[method]` makes a method fail; `calls` counts the calls; `target` is its address."""

    def __init__(self, *, lease_ttl_nanos: int = 60 * 10**9) -> None:
        self.lease_ttl_nanos = lease_ttl_nanos
        self.hosts: dict[bytes, directory_pb2.HostRecord] = {}
        self.channels: dict[bytes, channel_pb2.ChannelRecord] = {}
        self.refuse: dict[str, StampedeError] = {}
        self.calls: Counter[str] = Counter()
        # By method, the ids of the clusters that hosts have named as theirs.
        self.named_clusters: dict[str, list[str]] = {"RegisterHost": [], "RenewHostLease": []}
        self.cluster_id, self.former_cluster_ids = "c", list[str]()
        self.registered_index = 0  # the number of registrations
        self.target = ""
        self.others: list[str] = []
        self._called = asyncio.Condition()

    def register(self, server: grpc.aio.Server) -> None:
        directory_service_pb2_grpc.add_DirectoryServiceServicer_to_server(self, server)
        frontend_service_pb2_grpc.add_FrontendServiceServicer_to_server(self, server)

    def add_channel(
        self, name: str, host_id: bytes, spec: channel_pb2.ChannelSpec | None = None
    ) -> channel_pb2.ChannelRecord:
        record = channel_pb2.ChannelRecord(
            channel_id=secrets.token_bytes(16),
            name=name,
            host_id=host_id,
            epoch=1,
            incarnation=secrets.randbits(64) | 1,
            spec=spec,
            spec_version=1,
        )
        self.channels[record.channel_id] = record
        return record

    def move_away(self, channel_id: bytes) -> None:
        """Give the channel to another host, with the next epoch."""
        record = self.channels[channel_id]
        record.host_id, record.epoch, record.incarnation = b"other-host-id-16", record.epoch + 1, record.incarnation + 1

    async def called(self, method: str, *, times: int) -> None:
        """Return when that method has been called `times` times in all."""
        async with asyncio.timeout(30), self._called:
            await self._called.wait_for(lambda: self.calls[method] >= times)

    async def _begin(self, method: str, context: Any) -> None:
        self.calls[method] += 1
        async with self._called:
            self._called.notify_all()
        if method in self.refuse:
            await abort(context, self.refuse[method])

    async def Watch(self, request: Any, context: Any) -> AsyncIterator[pb.WatchResponse]:  # noqa: N802
        await self._begin("Watch", context)
        yield pb.WatchResponse(applied_index=1)
        await asyncio.Event().wait()

    async def Bind(self, request: Any, context: Any) -> frontend_service_pb2.BindResponse:  # noqa: N802
        await self._begin("Bind", context)
        targets = [*self.others, self.target]
        return frontend_service_pb2.BindResponse(
            supernodes=[
                directory_pb2.SupernodeRecord(
                    supernode_id=target, endpoint=directory_pb2.Endpoint(target=target), healthy=True
                )
                for target in targets
            ],
            cluster_id=self.cluster_id,
            former_cluster_ids=self.former_cluster_ids,
            protocol_version=1,
        )

    async def RegisterHost(self, request: pb.RegisterHostRequest, context: Any) -> pb.RegisterHostResponse:  # noqa: N802
        self.named_clusters["RegisterHost"].append(named_cluster(context.invocation_metadata()))
        await self._begin("RegisterHost", context)
        for held in self.hosts.values():
            if held.name == request.name and held.alive and held.host_id != request.host_id:
                await abort(context, HostExists(f"another live host has the name {request.name}"))
        before = self.hosts.get(request.host_id)
        is_other = before is not None and before.boot_incarnation != request.boot_incarnation
        if before is not None and is_other and before.registration_epoch >= request.registration_epoch:
            facts = {"registration_epoch": str(before.registration_epoch), "alive": str(before.alive).lower()}
            await abort(context, StaleRegistration("another process has registered", metadata=facts))
        self.hosts[request.host_id] = directory_pb2.HostRecord(
            host_id=request.host_id,
            name=request.name,
            gatekeepers=request.gatekeepers,
            boot_incarnation=request.boot_incarnation,
            alive=True,
            registration_epoch=request.registration_epoch,
        )
        self.registered_index += 1
        own = [one for one in self.channels.values() if one.host_id == request.host_id]
        if before is not None and before.boot_incarnation != request.boot_incarnation:
            for one in own:
                one.epoch, one.incarnation = one.epoch + 1, one.incarnation + 1
        return pb.RegisterHostResponse(
            host=self.hosts[request.host_id],
            lease_ttl_nanos=self.lease_ttl_nanos,
            channels=own,
            cluster_id=self.cluster_id,
            registered_index=self.registered_index,
        )

    async def RenewHostLease(  # noqa: N802
        self, request: pb.RenewHostLeaseRequest, context: Any
    ) -> pb.RenewHostLeaseResponse:
        self.named_clusters["RenewHostLease"].append(named_cluster(context.invocation_metadata()))
        await self._begin("RenewHostLease", context)
        host = self.hosts.get(request.host_id)
        if host is None or not host.alive or host.boot_incarnation != request.boot_incarnation:
            await abort(context, LeaseExpired("the lease has ended; register again"))
        return pb.RenewHostLeaseResponse(
            lease_ttl_nanos=self.lease_ttl_nanos,
            tenure=1,
            cluster_id=self.cluster_id,
            former_cluster_ids=self.former_cluster_ids,
        )

    async def DeregisterHost(  # noqa: N802
        self, request: pb.DeregisterHostRequest, context: Any
    ) -> pb.DeregisterHostResponse:
        await self._begin("DeregisterHost", context)
        self.hosts[request.host_id].alive = False
        return pb.DeregisterHostResponse()

    async def ResolveChannel(  # noqa: N802
        self, request: pb.ResolveChannelRequest, context: Any
    ) -> pb.ResolveChannelResponse:
        await self._begin("ResolveChannel", context)
        record = await self._find(request.channel_id, context)
        return pb.ResolveChannelResponse(channel=record, host=self.hosts.get(record.host_id))

    async def UpdateChannel(self, request: pb.UpdateChannelRequest, context: Any) -> pb.UpdateChannelResponse:  # noqa: N802
        await self._begin("UpdateChannel", context)
        record = await self._find(request.channel_id, context)
        if record.epoch != request.epoch:
            await abort(context, error_for("WRONG_EPOCH", f"the channel's epoch is {record.epoch}"))
        record.spec.MergeFrom(request.spec)
        record.spec_version += 1
        return pb.UpdateChannelResponse(channel=record)

    async def DeleteChannel(self, request: pb.DeleteChannelRequest, context: Any) -> pb.DeleteChannelResponse:  # noqa: N802
        await self._begin("DeleteChannel", context)
        await self._find(request.channel_id, context)
        del self.channels[request.channel_id]
        return pb.DeleteChannelResponse()

    async def _find(self, channel_id: bytes, context: Any) -> channel_pb2.ChannelRecord:
        record = self.channels.get(channel_id)
        if record is None:
            await abort(context, ChannelNotFound(f"there is no channel with the id {channel_id.hex()}"))
        assert record is not None
        return record
