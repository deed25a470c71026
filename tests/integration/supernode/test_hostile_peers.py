"""Outsiders that speak the log's protocol with valid credentials to real supernodes."""

from __future__ import annotations

import asyncio
import json
import shutil
import signal
import tempfile
from pathlib import Path
from typing import Any

import grpc

from stampede_rt.v1 import directory_service_pb2, raft_service_pb2_grpc
from stampede_rt.v1 import raft_service_pb2 as pb
from stampede_rt_supernode.core.cluster.feature_levels import HIGHEST_LEVEL
from stampede_rt_supernode.replication.settings import PROTOCOL_VERSION
from stampede_rt_supernode.replication.storage.known_stores import FILE_NAME
from stampede_rt_supernode.replication.storage.sqlite_store import read_identity
from tests.support.supernode.processes import (
    Cluster,
    Supernode,
    attempts,
    open_channel,
    register,
    resolve,
    running_cluster,
)

FAR = 2**62 - 1


def hello(cluster_id: str, name: str, to: Supernode, **more: Any) -> pb.RaftHello:
    return pb.RaftHello(
        cluster_id=cluster_id,
        member_id=name,
        peer_member_id=to.name,
        protocol_version=PROTOCOL_VERSION,
        highest_feature_level=HIGHEST_LEVEL,
        **{"store_id": f"store of {name}", "term": FAR, "last_log_index": FAR, **more},
    )


async def refusal_text(to: Supernode, greeting: pb.RaftHello, *messages: pb.RaftMessage) -> str:
    """Open a stream and send the messages. Returns the status text with which it ends; empty if it does not end."""
    call = raft_service_pb2_grpc.RaftServiceStub(to.channel).Exchange()  # type: ignore[no-untyped-call]
    await call.write(pb.RaftServiceExchangeRequest(hello=greeting))
    try:
        answer = await call.read()
        if answer is not grpc.aio.EOF and not answer.unknown_caller:
            await call.write(pb.RaftServiceExchangeRequest(messages=messages))
        async with asyncio.timeout(1.0):
            while await call.read() is not grpc.aio.EOF:
                pass
    except TimeoutError:
        call.cancel()
        return ""
    except grpc.aio.AioRpcError as error:
        return str(error.details())
    return str(await call.details())


VOTE = pb.RaftMessage(vote_request=pb.RaftVoteRequest(term=FAR, last_log_index=FAR, last_log_term=FAR))
CLAIM = pb.RaftMessage(append_entries=pb.RaftAppendEntries(term=FAR, commit_index=FAR, previous_log_index=1))


async def terms(cluster: Cluster) -> set[int]:
    """The term of each supernode."""
    pongs = [
        await one.stub.ListSupernodes(directory_service_pb2.ListSupernodesRequest(), timeout=10)
        for one in cluster.supernodes
    ]
    return {pong.term for pong in pongs}


async def test_outsiders_neither_add_members_nor_depose_the_leader(tmp_path: Path) -> None:
    async with running_cluster(tmp_path, "--lease-ttl", "1h") as cluster:
        leader = await cluster.leader()
        await register(leader, 1)
        await open_channel(leader, "cam/kept")
        cluster_id, _ = await asyncio.to_thread(read_identity_of_copy, tmp_path / leader.name)
        before = await terms(cluster)
        for number in range(40):
            greeting = hello(cluster_id, f"invented{number % 20}", leader, address=f"127.0.0.1:{1 + number}")
            assert "is no other member" in await refusal_text(leader, greeting, VOTE, CLAIM)
        notes = json.loads((tmp_path / leader.name / FILE_NAME).read_text()[9:])["known"]
        assert set(notes) == {one.name for one in cluster.others(leader)}
        assert await terms(cluster) == before
        assert (await cluster.leader()).name == leader.name
        await resolve(leader, "cam/kept")


async def test_a_process_with_the_name_of_a_member_needs_the_store_of_that_member(tmp_path: Path) -> None:
    async with running_cluster(tmp_path, "--lease-ttl", "1h") as cluster:
        leader = await cluster.leader()
        other, _ = cluster.others(leader)
        await register(leader, 1)
        cluster_id, _ = await asyncio.to_thread(read_identity_of_copy, tmp_path / leader.name)
        async for _ in attempts():
            if other.name in json.loads((tmp_path / leader.name / FILE_NAME).read_text()[9:])["known"]:
                break
        before = await terms(cluster)
        for store_id in ("", "invented"):
            refusal = await refusal_text(leader, hello(cluster_id, other.name, leader, store_id=store_id), VOTE, CLAIM)
            assert "has come with another store before" in refusal
        assert await terms(cluster) == before
        await open_channel(leader, "cam/1")


async def test_a_liar_with_the_store_of_a_member_ends_no_process_and_raises_no_term(tmp_path: Path) -> None:
    """The liar has stopped a member and taken its folder. The others end its stream after each lie, and take no other
    harm.
    """
    async with running_cluster(tmp_path, "--lease-ttl", "1h") as cluster:
        leader = await cluster.leader()
        taken, _ = cluster.others(leader)
        await register(leader, 1)
        await taken.end(signal.SIGKILL)
        store_id = json.loads((tmp_path / taken.name / FILE_NAME).read_text()[9:])["own"]
        cluster_id, _ = await asyncio.to_thread(read_identity_of_copy, tmp_path / leader.name)
        [before] = await terms_of(leader)
        greeting = hello(cluster_id, taken.name, leader, store_id=store_id)
        for lie in (VOTE, CLAIM):
            assert await refusal_text(leader, greeting, lie) != ""
        same_term = pb.RaftMessage(append_entries=pb.RaftAppendEntries(term=before, previous_log_index=1))
        assert await refusal_text(leader, greeting, same_term) != ""
        assert await terms_of(leader) == {before}
        await open_channel(leader, "cam/1")
        await taken.start()
        await resolve(taken, "cam/1")


async def terms_of(one: Supernode) -> set[int]:
    return {(await one.stub.ListSupernodes(directory_service_pb2.ListSupernodesRequest(), timeout=10)).term}


def read_identity_of_copy(folder: Path) -> tuple[str, str]:
    """The identity in a copy of a running supernode's store."""
    with tempfile.TemporaryDirectory() as place:
        shutil.copytree(folder, Path(place) / "copy")
        return read_identity(Path(place) / "copy")
