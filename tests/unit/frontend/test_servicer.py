"""The answers of a front-end to `Bind`."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import AsyncExitStack, asynccontextmanager

import grpc
import pytest

from stampede_rt.errors import StampedeError, Unavailable, VersionMismatch
from stampede_rt.status import from_rpc_error
from stampede_rt.v1 import frontend_service_pb2, frontend_service_pb2_grpc
from stampede_rt.v1.directory_service_pb2_grpc import add_DirectoryServiceServicer_to_server
from stampede_rt_frontend.probe import Prober
from stampede_rt_frontend.roster import SupernodeRoster
from stampede_rt_frontend.servicer import FrontendServicer
from stampede_rt_local.ports import free_ports
from stampede_rt_runtime.access.control import AccessControl
from stampede_rt_runtime.dial import dial
from stampede_rt_runtime.server import ServiceServer, serving
from tests.support.clock import ManualClock
from tests.support.fake_supernode import FakeSupernode

Bind = Callable[..., "asyncio.Future[frontend_service_pb2.BindResponse]"]
NOBODY = "localhost:1"  # tcpmux: nothing listens there


@pytest.fixture(autouse=True)
def _quick_probes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("stampede_rt_frontend.probe.PROBE_PERIOD_SECONDS", 0.02)
    monkeypatch.setattr("stampede_rt_frontend.probe._RETRY_SECONDS_MIN", 0.01)


@asynccontextmanager
async def supernode(directory: FakeSupernode, listen: str = "localhost:0") -> AsyncIterator[ServiceServer]:
    def register(server: grpc.aio.Server) -> None:
        add_DirectoryServiceServicer_to_server(directory, server)

    async with serving(register, listen=listen) as server:
        yield server


@asynccontextmanager
async def frontend(*seeds: str) -> AsyncIterator[Bind]:
    roster = SupernodeRoster(seeds)
    async with AsyncExitStack() as stack:
        prober = await stack.enter_async_context(Prober(roster, lambda target: dial(target, secret=None)))
        servicer = FrontendServicer(roster, prober, ManualClock(unix_nano=77), AccessControl())

        def register(server: grpc.aio.Server) -> None:
            frontend_service_pb2_grpc.add_FrontendServiceServicer_to_server(servicer, server)

        server = await stack.enter_async_context(serving(register))
        channel = await stack.enter_async_context(dial(server.address, secret=None))
        stub = frontend_service_pb2_grpc.FrontendServiceStub(channel)

        async def bind(protocol_version: int = 1, zone: str = "") -> frontend_service_pb2.BindResponse:
            request = frontend_service_pb2.BindRequest(protocol_version=protocol_version, zone=zone)
            try:
                return await stub.Bind(request, timeout=10)
            except grpc.aio.AioRpcError as error:
                raise from_rpc_error(error, server.address) from error

        yield bind


async def bind_until(bind: Bind, met: Callable[[frontend_service_pb2.BindResponse], bool]) -> None:
    async with asyncio.timeout(45):
        while not met(await bind()):
            pass  # each call is a round trip, so the loop waits for the network, not for a clock


async def test_a_caller_gets_the_supernodes_the_cluster_and_the_clock() -> None:
    directory = FakeSupernode()
    async with supernode(directory) as server, frontend(server.address) as bind:
        directory.members = {"s1": server.address}
        answer = await bind()
    assert [(one.supernode_id, one.healthy) for one in answer.supernodes] == [("s1", True)]
    assert answer.supernodes[0].endpoint.target == server.address
    assert (answer.cluster_id, answer.protocol_version, answer.time_unix_nano) == ("c1", 1, 77)
    assert answer.version


async def test_the_error_for_another_protocol_version_names_both_versions() -> None:
    async with supernode(FakeSupernode()) as server, frontend(server.address) as bind:
        with pytest.raises(VersionMismatch, match="protocol version 2, this cluster 1") as caught:
            await bind(protocol_version=2)
    assert caught.value.metadata["protocol_version"] == "1"


async def test_a_caller_that_comes_before_the_supernode_waits_for_it() -> None:
    directory, address = FakeSupernode(), f"localhost:{free_ports(1)[0]}"
    async with frontend(address) as bind:
        waiting = asyncio.ensure_future(bind())
        async with supernode(directory, address):
            assert (await waiting).supernodes[0].healthy


async def test_a_caller_gets_no_quorum_when_no_supernode_answers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("stampede_rt_frontend.servicer.WAIT_SECONDS_MAX", 0.1)
    async with frontend(NOBODY) as bind:
        with pytest.raises(Unavailable, match=f"no supernode answers this front-end .*{NOBODY}") as caught:
            await bind()
    assert caught.value.reason == "NO_QUORUM"
    assert isinstance(caught.value, StampedeError)


async def test_a_supernode_that_cannot_serve_is_reported_as_unhealthy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("stampede_rt_frontend.servicer.WAIT_SECONDS_MAX", 0.1)
    async with supernode(FakeSupernode(ready=False)) as server, frontend(server.address) as bind:
        answer = await bind()
    assert [one.healthy for one in answer.supernodes] == [False]


async def test_members_are_learned_from_one_seed() -> None:
    one, two = FakeSupernode("s1"), FakeSupernode("s2")
    async with supernode(one) as first, supernode(two) as second, frontend(first.address) as bind:
        one.members = two.members = {"s1": first.address, "s2": second.address}
        await bind_until(bind, lambda answer: [node.healthy for node in answer.supernodes] == [True, True])


async def test_a_dead_supernode_goes_to_the_end_and_comes_back() -> None:
    one, two = FakeSupernode("s1"), FakeSupernode("s2")
    async with supernode(two) as second:
        place = f"localhost:{free_ports(1)[0]}"
        async with supernode(one, place):
            one.members = two.members = {"s1": place, "s2": second.address}
            stack = AsyncExitStack()
            bind = await stack.enter_async_context(frontend(place, second.address))
            await bind_until(bind, lambda answer: [node.healthy for node in answer.supernodes] == [True, True])
        async with stack:
            await bind_until(bind, lambda answer: answer.supernodes[-1].supernode_id == "s1"
                             and [node.healthy for node in answer.supernodes] == [True, False])  # fmt: skip
            async with supernode(one, place):
                await bind_until(bind, lambda answer: all(node.healthy for node in answer.supernodes))


async def test_a_member_that_was_removed_is_not_probed_any_more() -> None:
    one, two = FakeSupernode("s1"), FakeSupernode("s2")
    async with supernode(one) as first, supernode(two) as second, frontend(first.address) as bind:
        one.members = two.members = {"s1": first.address, "s2": second.address}
        await bind_until(bind, lambda answer: len(answer.supernodes) == 2)
        one.members = two.members = {"s1": first.address}
        await bind_until(bind, lambda answer: len(answer.supernodes) == 1)
        before, pings = two.pings, one.pings
        await bind_until(bind, lambda _: one.pings > pings + 10)
        assert two.pings <= before + 1, "one probe may have been under way"
