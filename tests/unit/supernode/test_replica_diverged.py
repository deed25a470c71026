"""A supernode whose state differs from the leader's: how it is noticed, and its answers from then on."""

from __future__ import annotations

from collections.abc import AsyncIterator

import pytest

from stampede_rt.cli.supernode_findings import refusal
from stampede_rt.errors import Unavailable
from stampede_rt.v1 import directory_service_pb2 as pb
from stampede_rt_supernode.codecs.command_codec import encode_command
from stampede_rt_supernode.core.channels.commands import DeleteChannel
from stampede_rt_supernode.core.cluster.commands import BeginTenure
from stampede_rt_supernode.core.commands import Command, Operation
from stampede_rt_supernode.replica import DirectoryReplica
from stampede_rt_supernode.replication.interface import TOO_OLD
from tests.support.supernode.node import Node, running_node
from tests.support.supernode.operations import TTL_NANOS, id_of

TENURE = BeginTenure(tenure=1, supernode_id="s1", new_cluster_id="c", new_lease_ttl_nanos=TTL_NANOS)
UNKNOWN = b"\xff\xff what no release knows"


def encoded(number: int, operation: Operation) -> bytes:
    return encode_command(Command(op_id=id_of(number), time_unix_nano=number, operation=operation))


def done(*commands: bytes) -> DirectoryReplica:
    replica = DirectoryReplica()
    for index, command in enumerate(commands, start=1):
        replica.apply(index, command)
    return replica


def test_a_member_that_skips_an_unknown_command_has_another_digest_for_good() -> None:
    later = encoded(2, BeginTenure(tenure=2, supernode_id="s1", new_cluster_id="c", new_lease_ttl_nanos=TTL_NANOS))
    knows, does_not = done(encoded(1, TENURE), later), done(UNKNOWN, later)
    assert knows.digest()[0] == does_not.digest()[0] == 2
    assert knows.digest() != does_not.digest()


def test_the_texts_of_refusals_are_not_compared_between_releases() -> None:
    refused = encoded(2, DeleteChannel(channel_id=id_of(9)))
    one, other = done(encoded(1, TENURE), refused), done(encoded(1, TENURE), UNKNOWN)
    assert one.digest() == other.digest()


def test_a_snapshot_carries_the_digest() -> None:
    replica, restored = done(encoded(1, TENURE)), DirectoryReplica()
    restored.prepare_restore(replica.begin_snapshot()())()
    assert restored.digest() == replica.digest()
    assert any(replica.digest()[1])


@pytest.fixture
async def node() -> AsyncIterator[Node]:
    async with running_node() as node:
        yield node


async def test_a_diverged_supernode_refuses_reads_and_updates_with_the_position_of_the_difference(node: Node) -> None:
    await node.register(1)
    await node.open("cam/1")
    node.log.diverged_at = 7
    with pytest.raises(Unavailable, match="differs from that of most members at log position 7"):
        await node.open("cam/2")
    for stale_ok in (False, True):
        request = pb.ResolveChannelRequest(name="cam/1", stale_ok=stale_ok)
        with pytest.raises(Unavailable, match="use another one"):
            await node.call(node.stub.ResolveChannel(request, timeout=10))
    pong = await node.call(node.stub.Ping(pb.DirectoryServicePingRequest(), timeout=10))
    assert not pong.ready
    why = pong.refused_supernodes["s1"]
    assert "log position 7" in why
    state, advice = refusal(why)  # as `supernode status` and `doctor` show it
    assert (state, "join under a new id" in advice, "latest data folder" in advice) == ("diverged", True, False)


async def test_a_supernode_reports_that_its_disk_does_not_answer_and_doctor_gives_advice(node: Node) -> None:
    node.log.disk_silent_seconds = 7.2
    pong = await node.call(node.stub.Ping(pb.DirectoryServicePingRequest(), timeout=10))
    state, advice = refusal(pong.refused_supernodes["s1"])
    assert (state, "has not answered for 7 s; the other supernodes serve without this supernode" in advice) == (
        "waiting for its disk",
        True,
    ), advice


def test_doctor_distinguishes_a_refused_release_from_a_refused_store() -> None:
    state, advice = refusal(f"'s2' {TOO_OLD}: it knows feature level 1 (says s1)")
    assert (state, "release of the others and the same data folder" in advice) == ("release refused", True)
    assert "remove" not in advice
