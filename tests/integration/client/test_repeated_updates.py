"""An update that is sent again has the same request id, and says how long ago it was sent first."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import Any

import grpc
import grpc.aio
import pytest

import stampede_rt
import stampede_rt.aio
from stampede_rt.cluster.request_age import METADATA_KEY, age_clock_s, request_age_nanos
from stampede_rt.errors import Unavailable
from stampede_rt.status import abort
from stampede_rt.v1 import channel_pb2, directory_pb2, directory_service_pb2_grpc, gatekeeper_service_pb2_grpc
from stampede_rt.v1 import directory_service_pb2 as directory_pb
from stampede_rt.v1 import frontend_service_pb2 as frontend_pb
from stampede_rt.v1 import gatekeeper_service_pb2 as gate_pb
from stampede_rt.v1.frontend_service_pb2_grpc import (
    FrontendServiceServicer,
    add_FrontendServiceServicer_to_server,
)
from stampede_rt_channel_host.cluster.supernodes import Supernodes
from stampede_rt_runtime.dial import dial
from stampede_rt_runtime.server import serving

FAILURES = 4


class AllServices(
    FrontendServiceServicer,
    directory_service_pb2_grpc.DirectoryServiceServicer,
    gatekeeper_service_pb2_grpc.GatekeeperServiceServicer,
):
    """A front-end, a supernode and a host in one. It refuses the first FAILURES updates, and notes ids and ages."""

    address = ""

    def __init__(self) -> None:
        self.on_failure: Callable[[], None] = lambda: None
        self.seen: list[tuple[bytes, int]] = []

    async def Bind(self, request: Any, context: Any) -> frontend_pb.BindResponse:  # noqa: N802
        record = directory_pb2.SupernodeRecord(endpoint=directory_pb2.Endpoint(target=self.address), healthy=True)
        return frontend_pb.BindResponse(supernodes=[record], protocol_version=1)

    async def Ping(self, request: Any, context: Any) -> directory_pb.DirectoryServicePingResponse:  # noqa: N802
        return directory_pb.DirectoryServicePingResponse(supernode_id="s1", ready=True)

    async def OpenChannel(self, request: Any, context: Any) -> directory_pb.OpenChannelResponse:  # noqa: N802
        host = directory_pb2.HostRecord(
            host_id=bytes(16), name="h1", gatekeepers=[directory_pb2.Endpoint(target=self.address)], alive=True
        )
        return directory_pb.OpenChannelResponse(channel=self._record(), host=host)

    async def ResolveChannel(self, request: Any, context: Any) -> directory_pb.ResolveChannelResponse:  # noqa: N802
        opened = await self.OpenChannel(request, context)
        return directory_pb.ResolveChannelResponse(channel=opened.channel, host=opened.host)

    async def DeleteChannel(self, request: Any, context: Any) -> directory_pb.DeleteChannelResponse:  # noqa: N802
        await self._note(request, context)
        return directory_pb.DeleteChannelResponse()

    async def BindChannel(self, request: Any, context: Any) -> gate_pb.BindChannelResponse:  # noqa: N802
        endpoint = gate_pb.DataEndpoint(transport=gate_pb.TRANSPORT_GRPC, target=self.address)
        return gate_pb.BindChannelResponse(endpoints=[endpoint], channel=self._record())

    async def ConfigureChannel(self, request: Any, context: Any) -> gate_pb.ConfigureChannelResponse:  # noqa: N802
        await self._note(request, context)
        return gate_pb.ConfigureChannelResponse(channel=self._record())

    async def DropChannel(self, request: Any, context: Any) -> gate_pb.DropChannelResponse:  # noqa: N802
        await self._note(request, context)
        return gate_pb.DropChannelResponse()

    @staticmethod
    def _record() -> channel_pb2.ChannelRecord:
        return channel_pb2.ChannelRecord(channel_id=b"c" * 16, name="cam", host_id=bytes(16), epoch=1, incarnation=1)

    async def _note(self, request: Any, context: Any) -> None:
        self.seen.append((request.request_id, request_age_nanos(context.invocation_metadata())))
        if len(self.seen) <= FAILURES:
            self.on_failure()
            await abort(context, Unavailable("not now"))

    def was_asked_again_for_the_same(self) -> None:
        ids, ages = zip(*self.seen, strict=True)
        assert len(ids) == FAILURES + 1
        assert len(set(ids)) == 1
        assert list(ages) == sorted(ages)
        assert ages[-1] > ages[0]


@asynccontextmanager
async def running_all_services() -> AsyncIterator[AllServices]:
    servicer = AllServices()

    def register(server: grpc.aio.Server) -> None:
        add_FrontendServiceServicer_to_server(servicer, server)
        directory_service_pb2_grpc.add_DirectoryServiceServicer_to_server(servicer, server)
        gatekeeper_service_pb2_grpc.add_GatekeeperServiceServicer_to_server(servicer, server)

    async with serving(register) as server:
        servicer.address = server.address
        yield servicer


async def configure(address: str) -> None:
    async with stampede_rt.aio.connect(address) as rt:
        channel = await rt.channel("cam")
        await channel.configure(max_items=7)


async def delete(address: str) -> None:
    async with stampede_rt.aio.connect(address) as rt:
        channel = await rt.channel("cam")
        await channel.delete()


def configure_blocking(address: str) -> None:
    with stampede_rt.connect(address) as rt:
        rt.channel("cam").configure(max_items=7)


async def configure_in_thread(address: str) -> None:
    await asyncio.to_thread(configure_blocking, address)


@pytest.mark.parametrize("update", [configure, delete, configure_in_thread])
async def test_a_client_repeats_an_update_with_its_id_and_its_age(update: Callable[[str], Awaitable[None]]) -> None:
    async with running_all_services() as servicer:
        await update(servicer.address)
        servicer.was_asked_again_for_the_same()


async def test_a_host_passes_on_how_old_its_callers_request_is() -> None:
    async with running_all_services() as servicer:
        supernodes = Supernodes((servicer.address,), lambda target: dial(target, secret=None), peer_name="h1")
        try:
            request = directory_pb.DeleteChannelRequest(request_id=b"r" * 16, channel_id=b"c" * 16)
            await supernodes.call("DeleteChannel", request, 10.0, since_s=age_clock_s() - 5.0)
        finally:
            await supernodes.aclose()
        servicer.was_asked_again_for_the_same()
        assert servicer.seen[0][1] >= 5 * 10**9


@pytest.mark.parametrize("update", [configure, delete, configure_in_thread])
async def test_the_age_of_an_update_includes_the_time_that_the_machine_slept(
    update: Callable[[str], Awaitable[None]], monkeypatch: pytest.MonkeyPatch
) -> None:
    boottime, slept_s = time.clock_gettime, 0.0

    def sleep_for_a_minute() -> None:
        nonlocal slept_s
        slept_s += 60.0

    monkeypatch.setattr(time, "clock_gettime", lambda clock: boottime(clock) + slept_s)
    async with running_all_services() as servicer:
        servicer.on_failure = sleep_for_a_minute
        await update(servicer.address)
        assert servicer.seen[-1][1] >= FAILURES * 60 * 10**9


@pytest.mark.parametrize("stated_age", ["-1", "1.5", "", "٣", "9" * 13])
def test_an_invalid_age_of_an_update_is_refused(stated_age: str) -> None:
    with pytest.raises(stampede_rt.InvalidArgument, match="whole milliseconds"):
        request_age_nanos([(METADATA_KEY, stated_age)])
