"""Clients of one cluster that call supernodes and front-ends of several clusters."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import AsyncExitStack, asynccontextmanager
from typing import Any

import pytest

import stampede_rt as st
from stampede_rt import aio
from stampede_rt._async import directory_client as async_directory
from stampede_rt._async import discovery as async_discovery
from stampede_rt._sync import directory_client as sync_directory
from stampede_rt._sync import discovery as sync_discovery
from stampede_rt.cluster.cluster_ids import may_change_to, named_cluster, wrong_cluster
from stampede_rt.errors import StampedeError, Unavailable, WrongCluster
from stampede_rt.status import abort
from stampede_rt.v1 import (
    directory_pb2,
    directory_service_pb2_grpc,
    frontend_service_pb2_grpc,
    peer_service_pb2_grpc,
)
from stampede_rt.v1 import directory_service_pb2 as directory_pb
from stampede_rt.v1 import frontend_service_pb2 as frontend_pb
from stampede_rt.v1 import peer_service_pb2 as peer_pb
from stampede_rt_runtime.server import serving


class FakeSupernode(directory_service_pb2_grpc.DirectoryServiceServicer, peer_service_pb2_grpc.PeerServiceServicer):
    """A supernode that knows no hosts and no peers.

    `mute`: the supernode answers no ping. `served` has the cluster that each caller named, and `clock_flags` whether
    the caller asked for clocks, which only the leader reports. The supernode lists the addresses in `members`, and
    names the first as the leader.
    """

    def __init__(self, cluster_id: str, *, former: tuple[str, ...] = (), mute: bool = False) -> None:
        self.cluster_id, self.former, self.mute = cluster_id, former, mute
        self.served: list[str] = []
        self.clock_flags: list[bool] = []
        self.members: list[str] = []

    def judge(self, callers: str) -> StampedeError | None:
        if may_change_to(callers, self.cluster_id, self.former):
            return None
        return wrong_cluster("this supernode", self.cluster_id, callers)

    async def Ping(self, request: Any, context: Any) -> directory_pb.DirectoryServicePingResponse:  # noqa: N802
        if self.mute:
            await abort(context, Unavailable("not now"))
        return directory_pb.DirectoryServicePingResponse(
            supernode_id="s", ready=True, cluster_id=self.cluster_id, former_cluster_ids=self.former
        )

    async def ListHosts(self, request: Any, context: Any) -> directory_pb.ListHostsResponse:  # noqa: N802
        self.served.append(named_cluster(context.invocation_metadata()))
        return directory_pb.ListHostsResponse()

    async def ListSupernodes(self, request: Any, context: Any) -> directory_pb.ListSupernodesResponse:  # noqa: N802
        records = [
            directory_pb2.SupernodeRecord(endpoint=directory_pb2.Endpoint(target=target), is_leader=not number)
            for number, target in enumerate(self.members)
        ]
        return directory_pb.ListSupernodesResponse(supernodes=records)

    async def ListPeers(self, request: Any, context: Any) -> peer_pb.ListPeersResponse:  # noqa: N802
        self.clock_flags.append(request.with_clocks)
        return peer_pb.ListPeersResponse()

    async def Watch(self, request: Any, context: Any) -> AsyncIterator[directory_pb.WatchResponse]:  # noqa: N802
        self.served.append(named_cluster(context.invocation_metadata()))
        change = directory_pb2.DirectoryChange(index=1, kind=1, host=directory_pb2.HostRecord(name="h"))
        yield directory_pb.WatchResponse(applied_index=1, changes=[change])
        await asyncio.Event().wait()


class FakeFrontend(frontend_service_pb2_grpc.FrontendServiceServicer):
    def __init__(self, cluster_id: str, supernodes: list[str]) -> None:
        self.cluster_id, self._supernodes = cluster_id, supernodes
        self.former: tuple[str, ...] = ()

    async def Bind(self, request: Any, context: Any) -> frontend_pb.BindResponse:  # noqa: N802
        records = [
            directory_pb2.SupernodeRecord(endpoint=directory_pb2.Endpoint(target=target)) for target in self._supernodes
        ]
        return frontend_pb.BindResponse(
            supernodes=records, protocol_version=1, cluster_id=self.cluster_id, former_cluster_ids=self.former
        )


class World:
    """Front-ends and supernodes that run until the block ends."""

    def __init__(self, stack: AsyncExitStack) -> None:
        self._stack = stack

    async def supernode(self, one: FakeSupernode) -> str:
        def register(server: Any) -> None:
            directory_service_pb2_grpc.add_DirectoryServiceServicer_to_server(one, server)
            peer_service_pb2_grpc.add_PeerServiceServicer_to_server(one, server)

        serves = serving(register, judge_cluster=lambda cluster_id: one.judge(cluster_id))
        return (await self._stack.enter_async_context(serves)).address

    async def frontend(self, one: FakeFrontend) -> str:
        def register(server: Any) -> None:
            frontend_service_pb2_grpc.add_FrontendServiceServicer_to_server(one, server)

        return (await self._stack.enter_async_context(serving(register))).address


@pytest.fixture
async def world() -> AsyncIterator[World]:
    async with AsyncExitStack() as stack:
        yield World(stack)


class Client:
    """The calls of these tests, with either client."""

    def __init__(self, rt: Any, change: Callable[[], Awaitable[Any]], call: Callable[[Any], Awaitable[Any]]) -> None:
        self.change = change
        self.hosts: Callable[[], Awaitable[Any]] = lambda: call(rt.hosts)
        self.peers: Callable[[], Awaitable[Any]] = lambda: call(rt.peers)


@asynccontextmanager
async def connected(kind: str, url: str) -> AsyncIterator[Client]:
    if kind == "aio":
        async with await aio.connect(url) as rt:

            async def change() -> Any:
                async with rt.watch() as watch:
                    return await anext(watch)

            yield Client(rt, change, lambda method: method())
        return
    rt = await asyncio.to_thread(st.connect, url)
    try:

        def next_change() -> Any:
            with rt.watch() as watch:
                return next(watch)

        yield Client(rt, lambda: asyncio.to_thread(next_change), asyncio.to_thread)
    finally:
        await asyncio.to_thread(rt.close)


@pytest.fixture(params=["aio", "sync"])
def kind(request: pytest.FixtureRequest) -> str:
    return str(request.param)


async def test_a_call_and_a_watch_skip_a_supernode_of_another_cluster(world: World, kind: str) -> None:
    """No ping is answered, as under load. So only the refusal keeps the client from the other cluster."""
    stranger, own = FakeSupernode("y", mute=True), FakeSupernode("x", mute=True)
    targets = [await world.supernode(stranger), await world.supernode(own)]
    frontend = await world.frontend(FakeFrontend("x", targets))
    async with connected(kind, frontend) as client:
        await client.hosts()
    async with connected(kind, frontend) as client:
        await client.change()
    assert (stranger.served, set(own.served)) == ([], {"x"})


@pytest.mark.parametrize("others_know", [True, False])
async def test_a_call_for_the_leader_skips_another_cluster_at_the_known_leaders_address(
    world: World, kind: str, others_know: bool
) -> None:
    """The other members may not have elected another leader yet. Then none of them reports clocks."""
    former, follower = FakeSupernode("x"), FakeSupernode("x")
    targets = [await world.supernode(former), await world.supernode(follower)]
    former.members = follower.members = targets
    frontend = await world.frontend(FakeFrontend("x", targets))
    async with connected(kind, frontend) as client:
        await client.peers()
        assert (former.clock_flags, follower.clock_flags) == ([True], [])
        former.cluster_id = "y"  # as if an operator had restored a backup there
        if others_know:
            follower.members = targets[1:]
        await client.peers()
        assert (former.clock_flags, follower.clock_flags) == ([True], [others_know])


@pytest.fixture
def short_calls(monkeypatch: pytest.MonkeyPatch) -> None:
    """A call that is refused everywhere gives up after two seconds instead of ten."""
    for module in (async_discovery, sync_discovery):
        monkeypatch.setattr(module, "CALL_TIMEOUT_S", 2.0)


@pytest.mark.usefixtures("short_calls")
async def test_the_error_names_both_ids_if_all_supernodes_belong_to_another_cluster(world: World, kind: str) -> None:
    stranger = FakeSupernode("y")
    frontend = await world.frontend(FakeFrontend("x", [await world.supernode(stranger)]))
    with pytest.raises(WrongCluster, match="of cluster y, and the caller of cluster x"):
        async with connected(kind, frontend) as client:
            await client.hosts()
    assert stranger.served == []


async def test_front_ends_of_different_clusters_are_refused_with_both_names(world: World, kind: str) -> None:
    one = await world.frontend(FakeFrontend("x", [await world.supernode(FakeSupernode("x"))]))
    other = await world.frontend(FakeFrontend("y", [await world.supernode(FakeSupernode("y"))]))
    with pytest.raises(WrongCluster, match=f"{one} and {other} are of different clusters, x and y"):
        async with connected(kind, f"{one},{other}"):
            pass


@pytest.mark.usefixtures("short_calls")
async def test_a_client_leaves_a_front_end_that_now_serves_another_cluster(world: World, kind: str) -> None:
    own, stranger = FakeSupernode("x"), FakeSupernode("y")
    serves = FakeFrontend("x", [await world.supernode(own)])
    frontend = await world.frontend(serves)
    async with connected(kind, frontend) as client:
        await client.hosts()
        serves.cluster_id, serves._supernodes = "y", [await world.supernode(stranger)]
        own.cluster_id = "z"  # at the former address, another cluster serves now
        with pytest.raises(WrongCluster, match="of cluster z, and the caller of cluster x"):
            await client.hosts()
        assert stranger.served == []
        serves.former = stranger.former = ("x",)
        await client.hosts()
    assert stranger.served == ["y"]


@pytest.mark.parametrize(("before", "after", "former"), [("memory-x", "memory-y", ()), ("x", "y", ("x",))])
async def test_a_client_follows_the_successor_of_its_cluster(
    world: World, kind: str, before: str, after: str, former: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in (async_directory, sync_directory):
        monkeypatch.setattr(module, "MEASURE_EVERY_S", 0.0)
    one = FakeSupernode(before)
    frontend = await world.frontend(FakeFrontend(before, [await world.supernode(one)]))
    async with connected(kind, frontend) as client:
        await client.hosts()
        one.cluster_id, one.former = after, former
        await client.hosts()
    assert one.served == [before, after]


async def test_a_new_client_belongs_to_the_first_cluster_that_answers(world: World, kind: str) -> None:
    one = FakeSupernode("x")
    frontend = await world.frontend(FakeFrontend("", [await world.supernode(one)]))
    async with connected(kind, frontend) as client:
        await client.hosts()
    assert one.served == ["x"]
