"""The clock offsets that connections and peers report, with both clients. The core in memory has no peers."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import AsyncExitStack, asynccontextmanager
from typing import Any

import grpc
import pytest

import stampede_rt as st
from stampede_rt import aio
from stampede_rt.errors import NotLeader
from stampede_rt.status import abort
from stampede_rt.v1 import directory_pb2, directory_service_pb2_grpc, frontend_service_pb2_grpc, peer_pb2
from stampede_rt.v1 import directory_service_pb2 as directory_pb
from stampede_rt.v1 import frontend_service_pb2 as frontend_pb
from stampede_rt.v1 import peer_service_pb2 as peer_pb
from stampede_rt.v1 import peer_service_pb2_grpc as peer_grpc
from stampede_rt_local.cluster import LocalCluster
from stampede_rt_runtime.server import serving
from tests.contract.surfaces import Surface

# ruff: noqa: N802 # methods have the names of the RPCs

pytestmark = pytest.mark.without_rules("its services know no rules")
MINUTE_NANOS = 60 * 10**9
NAME = "clocks/one"
NOBODY = "localhost:1"  # tcpmux: nothing listens there
Connecting = Callable[..., Any]


@pytest.fixture(params=["aio", "sync"])
def connected(request: pytest.FixtureRequest) -> Connecting:
    """Return a function that makes a connection with one of the clients, to be awaited."""

    @asynccontextmanager
    async def connect(address: str, **settings: Any) -> AsyncIterator[Any]:
        if request.param == "aio":
            async with aio.connect(address, **settings) as connection:
                yield connection
            return
        with ThreadPoolExecutor(4) as pool:
            blocking = await Surface(st, pool).connection.connect(address, **settings)
            connection = Surface(blocking, pool).connection
            yield connection
            await connection.close()

    return connect


def is_right(clock: st.ClockOffset | None) -> bool:
    """Whether the true offset, 0 on one machine, lies within the uncertainty."""
    assert clock is not None
    return abs(clock.offset_nanos) <= clock.uncertainty_nanos <= MINUTE_NANOS


async def test_a_connected_peer_and_other_peers_know_its_clock_offset(
    connected: Connecting, cluster: LocalCluster
) -> None:
    async with connected(cluster.address, name=NAME) as named:
        assert is_right(named.clock)
        [listed] = await named.peers(NAME)
        assert is_right(listed.clock)
        found = await named.peer(NAME)
        assert is_right(found.clock)
        assert found.clock.supernode in [supernode.supernode_id for supernode in await named.supernodes()]


async def test_a_client_without_a_name_knows_its_own_clock_offset(connected: Connecting, cluster: LocalCluster) -> None:
    async with connected(cluster.address) as nameless:
        assert is_right(nameless.clock)


class Supernode(
    frontend_service_pb2_grpc.FrontendServiceServicer,
    directory_service_pb2_grpc.DirectoryServiceServicer,
    peer_grpc.PeerServiceServicer,
):
    """Knows two peers, and their clocks if it leads.

    `believed`: the leader in its list; `named_leader`: the leader in its refusals.
    """

    def __init__(self, *, leads: bool) -> None:
        self.leads = leads
        self.believed = self.named_leader = ""
        self.members: tuple[str, ...] = ()
        self.clock_flags: list[bool] = []

    async def Bind(self, request: Any, context: Any) -> frontend_pb.BindResponse:
        return frontend_pb.BindResponse(supernodes=self._records()[:1], protocol_version=1)

    async def Ping(self, request: Any, context: Any) -> directory_pb.DirectoryServicePingResponse:
        return directory_pb.DirectoryServicePingResponse(supernode_id="s1", ready=True, time_unix_nano=1)

    async def ListSupernodes(self, request: Any, context: Any) -> directory_pb.ListSupernodesResponse:
        return directory_pb.ListSupernodesResponse(supernodes=self._records())

    def _records(self) -> list[directory_pb2.SupernodeRecord]:
        return [
            directory_pb2.SupernodeRecord(endpoint=directory_pb2.Endpoint(target=one), is_leader=one == self.believed)
            for one in self.members
        ]

    async def ListPeers(self, request: peer_pb.ListPeersRequest, context: Any) -> peer_pb.ListPeersResponse:
        self.clock_flags.append(request.with_clocks)
        if request.with_clocks and not self.leads:
            await abort(context, NotLeader("ask another", metadata={"leader_endpoint": self.named_leader}))
        clock = peer_pb2.ClockOffset(offset_nanos=7, uncertainty_nanos=1, supernode_id="s2")
        place = int(request.page_token or 0)
        peer = peer_pb2.PeerRecord(name=f"peer/{place}", alive=True, clock=clock if request.with_clocks else None)
        return peer_pb.ListPeersResponse(peers=[peer], next_page_token="" if place else "1")


@asynccontextmanager
async def two_supernodes() -> AsyncIterator[tuple[Supernode, Supernode]]:
    """Yield a follower, which a client asks first, and the leader. Both know the leader."""
    made = Supernode(leads=False), Supernode(leads=True)
    async with AsyncExitStack() as stack:
        addresses = []
        for one in made:

            def register(server: grpc.aio.Server, one: Supernode = one) -> None:
                frontend_service_pb2_grpc.add_FrontendServiceServicer_to_server(one, server)
                directory_service_pb2_grpc.add_DirectoryServiceServicer_to_server(one, server)
                peer_grpc.add_PeerServiceServicer_to_server(one, server)

            addresses.append((await stack.enter_async_context(serving(register))).address)
        for one in made:
            one.members = tuple(addresses)
            one.believed = one.named_leader = addresses[1]
        yield made


async def reported_clocks(connected: Connecting, address: str) -> dict[str, int | None]:
    async with connected(address) as rt:
        return {peer.name: None if peer.clock is None else peer.clock.offset_nanos for peer in await rt.peers()}


async def test_a_client_asks_the_leader_for_clock_offsets_after_a_wrong_hint(connected: Connecting) -> None:
    async with two_supernodes() as (follower, leader):
        address, _ = follower.members
        assert await reported_clocks(connected, address) == {"peer/0": 7, "peer/1": 7}
        assert (follower.clock_flags, leader.clock_flags) == ([], [True, True])
        follower.believed = address
        assert await reported_clocks(connected, address) == {"peer/0": 7, "peer/1": 7}
        assert follower.clock_flags == [True]


@pytest.mark.parametrize("leader", ["", NOBODY], ids=["none", "out of reach"])
async def test_without_the_leader_peers_are_listed_without_their_clocks(connected: Connecting, leader: str) -> None:
    async with two_supernodes() as (follower, _):
        address, _ = follower.members
        follower.members = (address, leader) if leader else (address,)
        follower.believed = leader
        assert await reported_clocks(connected, address) == {"peer/0": None, "peer/1": None}
        assert follower.clock_flags == [False, False]
