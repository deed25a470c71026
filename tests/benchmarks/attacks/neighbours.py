"""Attacks by clients that do only allowed things, but very many of them."""

from __future__ import annotations

import asyncio
import itertools
import secrets
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import grpc

import stampede_rt as st
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.v1 import (
    directory_service_pb2,
    group_directory_service_pb2,
    group_pb2,
    group_service_pb2,
    peer_service_pb2,
)
from stampede_rt.v1.channel_service_pb2_grpc import ChannelServiceStub
from stampede_rt.v1.directory_service_pb2_grpc import DirectoryServiceStub
from stampede_rt.v1.group_directory_service_pb2_grpc import GroupDirectoryServiceStub
from stampede_rt.v1.group_service_pb2_grpc import GroupServiceStub
from stampede_rt.v1.peer_service_pb2_grpc import PeerServiceStub
from stampede_rt.wire.runs import encode_run
from tests.benchmarks.attacks.attacked_cluster import GOOD_CHANNEL, AttackedCluster, all_of, for_ever
from tests.benchmarks.attacks.memory import MIB, NAME, STREAMS, everything, put_all, stub

ITEMS, GETTERS = 50_000, 8
SUBSCRIPTIONS, SUBSCRIPTIONS_OF_ONE_CONNECTION = 3000, 1000
CREATORS = 16
GROUP_MEMBERS = 64
WATCHES = 2000


async def large_gets(attacked: AttackedCluster, on_begun: Callable[[], None]) -> None:
    """8 callers get all of 50,000 items, again and again."""
    async with attacked.connect() as rt:
        await rt.channel(NAME, max_items=ITEMS)
        await put_all(attacked, NAME, [encode_run([b"x" * 20], times=None)] * ITEMS, runs_per_request=100)
        known = await attacked.bound(NAME)
        on_begun()
        await all_of(*(_get_again_and_again(attacked, known) for _ in range(GETTERS)))


async def _get_again_and_again(attacked: AttackedCluster, known: dict[str, Any]) -> None:
    call: Any = stub(attacked, ChannelServiceStub).Get(metadata=attacked.metadata)
    for call_id in itertools.count(1):
        await call.write(pb.GetRequest(call_id=call_id, interval=everything(), **known))
        while not (response := await call.read()).HasField("summary"):
            assert not response.HasField("error"), response.error


async def many_subscriptions(attacked: AttackedCluster, on_begun: Callable[[], None]) -> None:
    """3000 subscriptions to the channel of the good clients; all are read."""
    opened = pb.SubscribeOpen(**await attacked.bound(GOOD_CHANNEL))
    request = pb.SubscribeRequest(open=opened, credit_bytes=2**60)
    calls: list[Any] = []
    for _ in range(SUBSCRIPTIONS // SUBSCRIPTIONS_OF_ONE_CONNECTION):
        one = stub(attacked, ChannelServiceStub)
        calls += [one.Subscribe(metadata=attacked.metadata) for _ in range(SUBSCRIPTIONS_OF_ONE_CONNECTION)]
    await all_of(*(call.write(request) for call in calls))
    on_begun()
    await all_of(*map(_read_all, calls))


async def _read_all(call: Any) -> None:
    while await call.read() is not grpc.aio.EOF:
        pass


async def new_channels(attacked: AttackedCluster, on_begun: Callable[[], None]) -> None:
    """16 callers make channels as fast as they can."""
    on_begun()
    numbers = itertools.count()
    await all_of(*(_create(attacked, numbers) for _ in range(CREATORS)))


async def _create(attacked: AttackedCluster, numbers: itertools.count[int]) -> None:
    open_channel: Any = DirectoryServiceStub(attacked.channel(attacked.supernode)).OpenChannel
    for number in numbers:
        request = directory_service_pb2.OpenChannelRequest(
            request_id=secrets.token_bytes(16), name=f"{NAME}/{number}", create=True
        )
        with suppress(grpc.aio.AioRpcError):
            await open_channel(request, metadata=attacked.metadata, timeout=10)


async def new_queues(attacked: AttackedCluster, on_begun: Callable[[], None]) -> None:
    """Queues are made one after the other."""
    async with attacked.connect() as rt:
        on_begun()
        for number in itertools.count():
            with suppress(st.StampedeError):
                await rt.queue(f"{NAME}/{number}")


async def new_groups(attacked: AttackedCluster, on_begun: Callable[[], None]) -> None:
    """Groups of 64 channels are made and deleted as fast as 16 callers can."""
    async with attacked.connect() as rt:
        ids = [(await rt.channel(f"{NAME}/{number}")).info.channel_id for number in range(GROUP_MEMBERS)]
    on_begun()
    numbers = itertools.count()
    await all_of(*(_make_groups(attacked, numbers, ids) for _ in range(CREATORS)))


async def _make_groups(attacked: AttackedCluster, numbers: itertools.count[int], channel_ids: list[bytes]) -> None:
    stub: Any = GroupDirectoryServiceStub(attacked.channel(attacked.supernode))  # type: ignore[no-untyped-call]
    spec = group_pb2.GroupSpec(channel_ids=channel_ids)
    for number in numbers:
        request = group_directory_service_pb2.OpenGroupRequest(
            request_id=secrets.token_bytes(16), name=f"{NAME}/{number}", spec=spec, create=True
        )
        with suppress(grpc.aio.AioRpcError):
            made = await stub.OpenGroup(request, metadata=attacked.metadata, timeout=10)
            delete = group_directory_service_pb2.DeleteGroupRequest(
                request_id=secrets.token_bytes(16), group_id=made.group.group_id
            )
            await stub.DeleteGroup(delete, metadata=attacked.metadata, timeout=10)


async def new_peers(attacked: AttackedCluster, on_begun: Callable[[], None]) -> None:
    """Peers with mailboxes are registered as fast as 16 callers can."""
    on_begun()
    numbers = itertools.count()
    await all_of(*(_register(attacked, numbers) for _ in range(CREATORS)))


async def _register(attacked: AttackedCluster, numbers: itertools.count[int]) -> None:
    register: Any = PeerServiceStub(attacked.channel(attacked.supernode)).RegisterPeer
    for number in numbers:
        request = peer_service_pb2.RegisterPeerRequest(
            request_id=secrets.token_bytes(16),
            peer_id=secrets.token_bytes(16),
            name=f"{NAME}/{number}",
            boot_incarnation=1,
        )
        with suppress(grpc.aio.AioRpcError):
            await register(request, metadata=attacked.metadata, timeout=10)


async def silent_watches(attacked: AttackedCluster, on_begun: Callable[[], None]) -> None:
    """2000 watches of the directory and 2000 of its peers, without a reader, while channels are created and deleted."""
    calls: list[Any] = []
    for _ in range(2):
        watch: Any = DirectoryServiceStub(attacked.channel(attacked.supernode)).Watch
        peers: Any = PeerServiceStub(attacked.channel(attacked.supernode)).WatchPeers  # type: ignore[no-untyped-call]
        for _ in range(WATCHES // 2):
            calls.append(watch(directory_service_pb2.WatchRequest(include_hosts=True), metadata=attacked.metadata))
            calls.append(peers(peer_service_pb2.WatchPeersRequest(), metadata=attacked.metadata))
    on_begun()
    async with attacked.connect() as rt:
        for number in itertools.count():
            with suppress(st.StampedeError):
                await (await rt.channel(f"{NAME}/{number}")).delete()


async def silent_cuts(attacked: AttackedCluster, on_begun: Callable[[], None]) -> None:
    """60 streams of a group's cut events and 60 of its matches, with unlimited credit, without a reader."""
    async with attacked.connect() as rt:
        members = [await rt.channel(f"{NAME}/{side}", max_age="5s") for side in ("left", "right")]
        await rt.group(NAME, members)
        async with attacked.channel(attacked.supernode) as channel:
            resolve: Any = GroupDirectoryServiceStub(channel).ResolveGroup  # type: ignore[no-untyped-call]
            request = group_directory_service_pb2.ResolveGroupRequest(name=NAME)
            found = await resolve(request, metadata=attacked.metadata)
        await all_of(*_silent_readers(attacked, found))
        on_begun()
        while True:
            at = st.now()
            for member in members:
                with suppress(st.StampedeError):
                    await member.put(bytes(MIB), time=at)
            await asyncio.sleep(0.05)


def _silent_readers(attacked: AttackedCluster, found: Any) -> list[Any]:
    group_id, per = found.group.group_id, found.channels[0]
    writes = []
    for _ in range(STREAMS):
        one: Any = stub(attacked, GroupServiceStub)
        cuts = group_service_pb2.SubscribeCutsOpen(group_id=group_id, decides=True)
        matches = group_service_pb2.SubscribeMatchesOpen(
            group_id=group_id, per_channel_id=per.channel_id, epoch=per.epoch
        )
        held = (one.SubscribeCuts(metadata=attacked.metadata), one.SubscribeMatches(metadata=attacked.metadata))
        READERS.extend(held)
        writes.append(held[0].write(group_service_pb2.SubscribeCutsRequest(open=cuts, credit=2**31)))
        writes.append(held[1].write(group_service_pb2.SubscribeMatchesRequest(open=matches, credit_bytes=2**60)))
    return writes


READERS: list[Any] = []  # a call without a reference would be ended


async def health_watches(attacked: AttackedCluster, on_begun: Callable[[], None]) -> None:
    """4096 Watch streams of the health service, with the secret, without a reader."""
    calls = []
    for _ in range(5):
        watch = attacked.channel(attacked.target).unary_stream("/grpc.health.v1.Health/Watch")
        calls += [watch(b"", metadata=attacked.metadata) for _ in range(1000)]
    on_begun()
    await for_ever()
