"""The client's choice of a supernode: in its zone, then the nearest. The client asks all of them together."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass, field
from typing import Any

import pytest

from stampede_rt._async import directory_client as async_directory
from stampede_rt._async import endpoints as async_endpoints
from stampede_rt._sync import directory_client as sync_directory
from stampede_rt._sync import endpoints as sync_endpoints
from stampede_rt.security.credentials import Credentials
from stampede_rt.v1 import directory_pb2, directory_service_pb2_grpc, frontend_service_pb2_grpc
from stampede_rt.v1 import directory_service_pb2 as directory_pb
from stampede_rt.v1 import frontend_service_pb2 as frontend_pb
from stampede_rt_runtime.server import serving

LATER_SECONDS = 0.3


@dataclass
class PingCounter:
    """Counts the pings. Each waits until all supernodes have been asked."""

    wanted: int
    pings: int = 0
    all_there: asyncio.Event = field(default_factory=asyncio.Event)

    async def note(self) -> None:
        self.pings += 1
        if self.pings >= self.wanted:
            self.all_there.set()
        await self.all_there.wait()


class Place(directory_service_pb2_grpc.DirectoryServiceServicer):
    """A supernode at a distance of some seconds. It answers pings once all other supernodes have got a ping, too."""

    def __init__(self, name: str, pings: PingCounter, later_seconds: float) -> None:
        self._name, self._pings, self._later_seconds = name, pings, later_seconds
        self.calls = 0

    async def Ping(self, request: Any, context: Any) -> directory_pb.DirectoryServicePingResponse:  # noqa: N802
        await self._pings.note()
        await asyncio.wait([asyncio.create_task(asyncio.Event().wait())], timeout=self._later_seconds)
        return directory_pb.DirectoryServicePingResponse(supernode_id=self._name, ready=True)

    async def ListHosts(self, request: Any, context: Any) -> directory_pb.ListHostsResponse:  # noqa: N802
        self.calls += 1
        return directory_pb.ListHostsResponse()


class Frontend(frontend_service_pb2_grpc.FrontendServiceServicer):
    """Names the places, each with its zone."""

    def __init__(self, places: Sequence[tuple[str, str]]) -> None:
        self._places = places

    async def Bind(self, request: Any, context: Any) -> frontend_pb.BindResponse:  # noqa: N802
        records = [
            directory_pb2.SupernodeRecord(endpoint=directory_pb2.Endpoint(target=target, zone=zone))
            for target, zone in self._places
        ]
        return frontend_pb.BindResponse(supernodes=records, protocol_version=1)


@asynccontextmanager
async def places(**later_seconds: float) -> AsyncIterator[tuple[str, dict[str, Place]]]:
    """A front-end's address, and the supernodes by name; the first letter of a name is its zone."""
    pings, made, targets = PingCounter(len(later_seconds)), {}, []
    async with AsyncExitStack() as stack:
        for name, seconds in later_seconds.items():
            made[name] = place = Place(name, pings, seconds)
            add = directory_service_pb2_grpc.add_DirectoryServiceServicer_to_server
            server = await stack.enter_async_context(serving(lambda server, add=add, place=place: add(place, server)))
            targets.append((server.address, name[0]))
        frontend = Frontend(targets)
        register = frontend_service_pb2_grpc.add_FrontendServiceServicer_to_server
        server = await stack.enter_async_context(serving(lambda server: register(frontend, server)))
        yield server.address, made


async def ask_awaited(frontend: str, zone: str) -> None:
    ports = async_endpoints.EndpointPool(Credentials())
    try:
        supernodes = async_directory.DirectoryClient((frontend,), ports, peer_name="", zone=zone)
        await supernodes.bind(20.0)
        await supernodes.call("ListHosts", directory_pb.ListHostsRequest(), 20.0)
    finally:
        await ports.aclose()


def ask_blocking(frontend: str, zone: str) -> None:
    ports = sync_endpoints.EndpointPool(Credentials())
    try:
        supernodes = sync_directory.DirectoryClient((frontend,), ports, peer_name="", zone=zone)
        supernodes.bind(20.0)
        supernodes.call("ListHosts", directory_pb.ListHostsRequest(), 20.0)
    finally:
        ports.close()


async def ask_in_thread(frontend: str, zone: str) -> None:
    await asyncio.to_thread(ask_blocking, frontend, zone)


Ask = Callable[[str, str], Awaitable[None]]


@pytest.fixture(params=[ask_awaited, ask_in_thread], ids=["async", "sync"])
def ask(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Ask:
    """Connect, and ask for the hosts. A ping may take long here, so that the order is right on a busy machine, too."""
    for module in (async_directory, sync_directory):
        monkeypatch.setattr(module, "PING_TIMEOUT_S", 10.0)
    chosen: Ask = request.param
    return chosen


def called(made: dict[str, Place]) -> list[str]:
    return [name for name, place in made.items() if place.calls]


async def test_a_client_asks_all_supernodes_at_the_same_time_and_chooses_the_nearest(ask: Ask) -> None:
    async with places(a1=LATER_SECONDS, b1=0.0, c1=2 * LATER_SECONDS) as (frontend, made):
        await ask(frontend, "")
    assert called(made) == ["b1"]


async def test_a_client_prefers_a_supernode_of_its_zone_to_a_nearer_one(ask: Ask) -> None:
    async with places(a1=2 * LATER_SECONDS, a2=LATER_SECONDS, b1=0.0) as (frontend, made):
        await ask(frontend, "a")
    assert called(made) == ["a2"]


async def test_a_supernode_that_does_not_answer_in_time_is_passed_over_even_in_the_same_zone(
    ask: Ask, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in (async_directory, sync_directory):
        monkeypatch.setattr(module, "PING_TIMEOUT_S", 2.0)
    async with places(a1=60.0, b1=0.0) as (frontend, made):
        await ask(frontend, "a")
    assert called(made) == ["b1"]


class EnoughError(Exception):
    """The test has seen enough delays."""


async def delays_of_one_that_finds_nobody(patch: pytest.MonkeyPatch) -> list[float]:
    delays: list[float] = []

    async def note(delay_s: float) -> None:
        delays.append(delay_s)
        if len(delays) == 4:
            raise EnoughError

    patch.setattr(async_directory, "sleep", note)
    ports = async_endpoints.EndpointPool(Credentials())
    try:
        supernodes = async_directory.DirectoryClient(("localhost:1",), ports, peer_name="", zone="")
        with pytest.raises(EnoughError):
            await supernodes.call("ListHosts", directory_pb.ListHostsRequest(), 60.0)
    finally:
        await ports.aclose()
    return delays


async def test_clients_that_lost_the_service_together_reconnect_at_different_times(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    one, other = [await delays_of_one_that_finds_nobody(monkeypatch) for _ in range(2)]
    assert one != other
    for bound_s, delay_s in zip((0.02, 0.04, 0.08, 0.16), one, strict=True):
        assert bound_s / 2 <= delay_s <= bound_s
