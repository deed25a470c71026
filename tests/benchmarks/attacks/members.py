"""Attacks by a caller with the credential of a service of the cluster, and patterns that take long to match.

If the program of an attack notices that the attack has done harm, it ends with an error.
"""

from __future__ import annotations

import asyncio
import itertools
import secrets
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import grpc

from stampede_rt.errors import StampedeError
from stampede_rt.v1 import directory_service_pb2 as directory_pb
from stampede_rt.v1 import gatekeeper_service_pb2 as gate_pb
from stampede_rt.v1 import group_pb2, raft_service_pb2_grpc
from stampede_rt.v1 import group_service_pb2 as group_pb
from stampede_rt.v1 import membership_service_pb2 as members_pb
from stampede_rt.v1 import raft_service_pb2 as raft_pb
from stampede_rt.v1.directory_service_pb2_grpc import DirectoryServiceStub
from stampede_rt.v1.gatekeeper_service_pb2_grpc import GatekeeperServiceStub
from stampede_rt.v1.group_service_pb2_grpc import GroupServiceStub
from stampede_rt.v1.membership_service_pb2_grpc import MembershipServiceStub
from stampede_rt.version import PROTOCOL_VERSION as HOSTS_PROTOCOL
from stampede_rt_supernode.core.cluster.feature_levels import HIGHEST_LEVEL
from stampede_rt_supernode.joining.join_tokens import JoinTokens
from stampede_rt_supernode.replication import Member
from stampede_rt_supernode.replication.settings import PROTOCOL_VERSION
from tests.benchmarks.attacks.attacked_cluster import AttackedCluster, all_of

FAR = 2**62 - 1
CALLERS, CALL_SECONDS = 8, 5.0
HOUR_NANOS = 3600 * 10**9
STARS = "*a" * 24 + "b"
VOTE = raft_pb.RaftMessage(vote_request=raft_pb.RaftVoteRequest(term=FAR, last_log_index=FAR, last_log_term=FAR))
CLAIM = raft_pb.RaftMessage(append_entries=raft_pb.RaftAppendEntries(term=FAR, commit_index=FAR, previous_log_index=1))


async def raft_claims(attacked: AttackedCluster, on_begun: Callable[[], None]) -> None:
    """Streams of the log under the names of invented and of real members, with votes and claims of a far later term."""
    supernode = attacked.channel(attacked.supernode)
    token = await _join_token(attacked, supernode, "spare")
    known: Any = DirectoryServiceStub(supernode).ListSupernodes
    listed = await known(directory_pb.ListSupernodesRequest(), metadata=attacked.member_metadata)
    names = [one.supernode_id for one in listed.supernodes]
    on_begun()
    for number in itertools.count():
        callers = [*names, f"invented{number % 100}"]
        await all_of(*(_claim(attacked, supernode, token.log_cluster_id, one, names[0]) for one in callers))


async def _claim(attacked: AttackedCluster, supernode: grpc.aio.Channel, cluster_id: str, name: str, to: str) -> None:
    """Greet as a member, vote and claim to lead. Ends when the supernode has ended the stream."""
    hello = raft_pb.RaftHello(
        cluster_id=cluster_id, member_id=name, peer_member_id=to, protocol_version=PROTOCOL_VERSION,
        highest_feature_level=HIGHEST_LEVEL, store_id=secrets.token_hex(16), term=FAR, last_log_index=FAR,
    )  # fmt: skip
    stub: Any = raft_service_pb2_grpc.RaftServiceStub(supernode)  # type: ignore[no-untyped-call]
    call = stub.Exchange(timeout=CALL_SECONDS, metadata=attacked.member_metadata)
    await call.write(raft_pb.RaftServiceExchangeRequest(hello=hello))
    await call.write(raft_pb.RaftServiceExchangeRequest(messages=[VOTE, CLAIM]))
    while await call.read() is not grpc.aio.EOF:
        pass


async def _join_token(attacked: AttackedCluster, supernode: grpc.aio.Channel, name: str) -> Any:
    make: Any = MembershipServiceStub(supernode).CreateJoinToken
    request = members_pb.CreateJoinTokenRequest(
        request_id=secrets.token_bytes(16), supernode_id=name, target="127.0.0.1:9"
    )
    return await make(request, metadata=attacked.member_metadata)


async def join_tokens(attacked: AttackedCluster, on_begun: Callable[[], None]) -> None:
    """Newcomers with tokens that are made with the public id of the cluster as their key, or for another address."""
    supernode = attacked.channel(attacked.supernode)
    genuine = await _join_token(attacked, supernode, "spare")
    listing: Any = DirectoryServiceStub(supernode).ListSupernodes

    async def members() -> set[str]:
        found = await listing(directory_pb.ListSupernodesRequest(), metadata=attacked.member_metadata)
        return {one.supernode_id for one in found.supernodes}

    before = await members()
    on_begun()
    while True:
        await all_of(*(_join(attacked, supernode, genuine) for _ in range(CALLERS)))
        if await members() != before:
            raise AssertionError("a false join token has changed the members")


async def _join(attacked: AttackedCluster, supernode: grpc.aio.Channel, genuine: Any) -> None:
    name = f"thief-{secrets.token_hex(4)}"
    forged = JoinTokens(genuine.cluster_id.encode()).make(
        secrets.token_bytes(16), Member(member_id=name, address="127.0.0.1:9"),
        valid_until_unix_nano=time.time_ns() + HOUR_NANOS, log_cluster_id=genuine.log_cluster_id,
    )  # fmt: skip
    add: Any = MembershipServiceStub(supernode).AddSupernode
    for token, target in ((forged, "127.0.0.1:9"), (genuine.token, "127.0.0.1:10")):
        request = members_pb.AddSupernodeRequest(
            supernode_id=name, token=token, protocol_version=1, highest_feature_level=HIGHEST_LEVEL
        )
        request.endpoint.target = target
        with suppress(grpc.aio.AioRpcError):
            await add(request, timeout=CALL_SECONDS, metadata=attacked.member_metadata)


async def cut_floors(attacked: AttackedCluster, on_begun: Callable[[], None]) -> None:
    """Links of hosts that do not exist. They claim that a group was shown up to the end of time."""
    supernode, host = attacked.channel(attacked.supernode), attacked.channel(attacked.host)
    token = await _join_token(attacked, supernode, "spare")
    async with attacked.connect() as rt:
        channel = await rt.channel(f"{attacked.thing}/left")
        await channel.put(b"x")  # without an item the group has no cut
        group = await rt.group(attacked.thing, [channel])
        info = group.info
        floor = group_pb2.CutFloor(
            group_id=info.group_id,
            incarnation=info.incarnation,
            cut_unix_nano=2**63 - 1,
            spec_version=info.spec_version,
        )
        on_begun()
        while True:
            await all_of(*(_exchange(attacked, host, token.cluster_id, floor) for _ in range(CALLERS)))
            with suppress(StampedeError):
                if ((await group.status()).cut or 0) > time.time_ns() + HOUR_NANOS:
                    raise AssertionError("a host that does not exist has raised the cut")


async def _exchange(
    attacked: AttackedCluster, host: grpc.aio.Channel, cluster_id: str, floor: group_pb2.CutFloor
) -> None:
    stub: Any = GroupServiceStub(host)
    call = stub.ExchangeTimes(timeout=CALL_SECONDS, metadata=attacked.member_metadata)
    hello = group_pb.ExchangeHello(
        cluster_id=cluster_id, host_id=secrets.token_bytes(16), boot_incarnation=1, protocol_version=HOSTS_PROTOCOL
    )
    await call.write(group_pb.ExchangeTimesRequest(hello=hello))
    await call.read()  # the host's hello
    for _ in range(100):
        await call.write(group_pb.ExchangeTimesRequest(update=group_pb.TimesUpdate(floors=[floor])))
    await call.done_writing()  # the host reads all of it, and ends the stream
    while await call.read() is not grpc.aio.EOF:
        pass


async def globs(attacked: AttackedCluster, on_begun: Callable[[], None]) -> None:
    """Lists of channels by a pattern with 24 stars, at the host and at the supernode."""
    supernode, host = attacked.channel(attacked.supernode), attacked.channel(attacked.host)
    async with attacked.connect() as rt:
        await (await rt.channel(f"{attacked.thing}/{'a' * 100}")).put(b"x")
    at_host: Any = GatekeeperServiceStub(host).ListHostedChannels
    at_supernode: Any = DirectoryServiceStub(supernode).ListChannels
    on_begun()
    while True:
        await all_of(
            *(at_host(gate_pb.ListHostedChannelsRequest(name_glob=STARS), timeout=CALL_SECONDS,
                      metadata=attacked.metadata) for _ in range(CALLERS)),
            *(at_supernode(directory_pb.ListChannelsRequest(name_glob=STARS), timeout=CALL_SECONDS,
                           metadata=attacked.metadata) for _ in range(CALLERS)),
            asyncio.sleep(0.01),
        )  # fmt: skip
