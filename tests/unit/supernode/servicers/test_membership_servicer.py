"""Join tokens, MembershipService on a log in memory, and the facts in a data folder."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import grpc
import pytest
import pytest_asyncio

from stampede_rt.errors import InvalidArgument, PermissionDenied, StampedeError
from stampede_rt.v1 import directory_pb2, membership_service_pb2_grpc
from stampede_rt.v1 import membership_service_pb2 as pb
from stampede_rt_runtime.dial import dial
from stampede_rt_runtime.server import serving
from stampede_rt_supernode import replication
from stampede_rt_supernode.codecs.snapshot_codec import decode_snapshot, encode_snapshot
from stampede_rt_supernode.core.cluster.feature_levels import HIGHEST_LEVEL
from stampede_rt_supernode.joining.founding import (
    FoundingRecord,
    check_unused,
    note_started,
    read_founding,
    write_founding,
)
from stampede_rt_supernode.joining.join_tokens import VALID_NANOS_MAX, JoinTokens, log_cluster_of, valid_until
from stampede_rt_supernode.replication import Member
from stampede_rt_supernode.servicers.membership_servicer import SNAPSHOTS_MAX, MembershipServicer
from stampede_rt_supernode.settings import SupernodeSettings
from tests.support.supernode.node import Node, reason_of, running_node

TOKENS = JoinTokens(b"a key that nobody is told")
NEW = Member(member_id="new", address="new:1")
REQUEST_ID = bytes(range(16))


def token(**changes: Any) -> str:
    fields = {"valid_until_unix_nano": 1000, "log_cluster_id": "log", **changes}
    return TOKENS.make(REQUEST_ID, NEW, **fields)


def test_a_join_token_is_valid_until_its_end() -> None:
    assert TOKENS.check(token(), NEW, now_unix_nano=999) == TOKENS.check(token(), NEW, now_unix_nano=1)
    with pytest.raises(PermissionDenied, match="has ended"):
        TOKENS.check(token(), NEW, now_unix_nano=1000)


@pytest.mark.parametrize("text", ["", ".", "sj3...", "sj1.3e8.00.1", "sj3.3e8.00.1.2", "\u20ac.\u20ac.\u20ac.\u20ac"])
def test_a_text_that_is_no_token_is_refused(text: str) -> None:
    with pytest.raises(PermissionDenied, match="not one of this cluster"):
        TOKENS.check(text, NEW, now_unix_nano=1)


def test_a_join_token_with_another_key_id_address_or_end_is_refused() -> None:
    later, other_id, elsewhere = token().replace("3e8", "3e9"), replace(NEW, member_id="x"), replace(NEW, address="x:1")
    for text, tokens, newcomer in (
        (token(), JoinTokens(b"x"), NEW),
        (later, TOKENS, NEW),
        (token(), TOKENS, other_id),
        (token(), TOKENS, elsewhere),
    ):
        with pytest.raises(PermissionDenied, match="not one of this cluster"):
            tokens.check(text, newcomer, now_unix_nano=1)


async def test_the_key_of_join_tokens_is_random_and_survives_in_snapshots() -> None:
    keys = set()
    for _ in range(2):
        async with running_node() as node:
            keys.add(node.replica.read(lambda directory: directory.join_key))
            copy = node.replica.read(lambda directory: decode_snapshot(encode_snapshot(directory)))
            assert copy.join_key in keys
    assert len(keys) == 2
    assert {len(key) for key in keys} == {32}


def test_a_join_token_names_the_cluster_id_of_its_log() -> None:
    assert log_cluster_of(token()) == "log"
    assert log_cluster_of(token(log_cluster_id="")) == ""
    for text in ("", "sj3", token().rpartition(".")[0], token().replace("sj3", "sj1"), token().replace(".6c", ".6x")):
        with pytest.raises(InvalidArgument, match="stampede supernode add"):
            log_cluster_of(text)


def test_a_join_token_is_valid_for_at_most_a_day() -> None:
    assert valid_until(5, None) == 5 + 3600 * 10**9
    for nanos in (0, VALID_NANOS_MAX + 1):
        with pytest.raises(InvalidArgument, match="24 h"):
            valid_until(5, nanos)


@pytest_asyncio.fixture
async def rig() -> AsyncIterator[tuple[Node, Any]]:
    async with running_node() as node:
        members: Any = type("Nobody", (), {"records": lambda self: ([], 1), "self_id": "s1"})()
        servicer = MembershipServicer(node.log, node.replica, members, node.clock, log_cluster_id="log")
        register = membership_service_pb2_grpc.add_MembershipServiceServicer_to_server
        async with (
            serving(lambda server: register(servicer, server)) as server,
            dial(server.address, secret=None) as channel,
        ):
            yield node, membership_service_pb2_grpc.MembershipServiceStub(channel)


async def addition(stub: Any, **changes: Any) -> pb.AddSupernodeRequest:
    request = pb.CreateJoinTokenRequest(request_id=REQUEST_ID, supernode_id="new", target="new:1")
    made = await stub.CreateJoinToken(request, timeout=10)
    fields = {
        "supernode_id": "new",
        "endpoint": directory_pb2.Endpoint(target="new:1"),
        "token": made.token,
        "protocol_version": 1,
        "highest_feature_level": HIGHEST_LEVEL,
    }
    return pb.AddSupernodeRequest(**{**fields, **changes})


@pytest.mark.parametrize(("name", "why"), [("gone", "was a member before"), ("s2", "is a member already")])
async def test_no_join_token_is_made_for_the_id_of_a_former_or_present_member(
    rig: tuple[Node, Any], name: str, why: str
) -> None:
    node, stub = rig
    node.log.retired = {"gone"}
    node.log.other = Member(member_id="s2", address="s2:1")
    request = pb.CreateJoinTokenRequest(request_id=REQUEST_ID, supernode_id=name, target="new:1")
    with pytest.raises(grpc.RpcError, match=why):
        await stub.CreateJoinToken(request, timeout=10)


async def test_a_newcomer_with_a_token_is_added(rig: tuple[Node, Any]) -> None:
    node, stub = rig
    added = await stub.AddSupernode(await addition(stub), timeout=10)
    assert added.index == node.log.index
    [(member, ticket)] = node.log.added
    assert (member.member_id, member.address, len(ticket)) == ("new", "new:1", 64)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"token": "nonsense"}, "UNAUTHENTICATED"),
        ({"protocol_version": 2}, "VERSION_MISMATCH"),
        ({"supernode_id": ""}, "INVALID_ARGUMENT"),
        ({"supernode_id": "another"}, "UNAUTHENTICATED"),
        ({"endpoint": directory_pb2.Endpoint(target="elsewhere:1")}, "UNAUTHENTICATED"),
        ({"endpoint": directory_pb2.Endpoint(target="nowhere")}, "INVALID_ARGUMENT"),
    ],
)
async def test_a_new_member_that_cannot_be_admitted_gets_the_reason(
    rig: tuple[Node, Any], changes: dict[str, Any], reason: str
) -> None:
    _, stub = rig
    error = await reason_of(stub.AddSupernode(await addition(stub, **changes), timeout=10))
    assert error.reason == reason


async def test_a_new_member_whose_release_is_below_the_clusters_level_is_refused(rig: tuple[Node, Any]) -> None:
    node, stub = rig
    node.replica.read(lambda directory: setattr(directory, "feature_level", 3))
    for highest in (0, 2):
        request = await addition(stub, highest_feature_level=highest)
        error = await reason_of(stub.AddSupernode(request, timeout=10))
        assert error.reason == "VERSION_MISMATCH"
        assert f"level {max(1, highest)}, and the cluster is at level 3" in error.message
    await stub.AddSupernode(await addition(stub, highest_feature_level=3), timeout=10)


async def test_a_supernode_whose_state_differs_refuses_current_and_stale_snapshots(rig: tuple[Node, Any]) -> None:
    node, stub = rig
    node.log.diverged_at = 7
    for stale_ok in (False, True):
        error = await reason_of(stub.TakeSnapshot(pb.TakeSnapshotRequest(stale_ok=stale_ok), timeout=10).read())
        assert "differs from that of most members at log position 7" in error.message
        assert "take a snapshot of another supernode" in error.message


@pytest.mark.parametrize(
    ("failure", "reason"),
    [
        (replication.NotLeading("x"), "NO_QUORUM"),
        (replication.ChangeUnderWay("x"), "OVERLOADED"),
        (replication.ChangeRefused("x"), "INVALID_ARGUMENT"),
        (replication.TicketSpent("x"), "UNAUTHENTICATED"),
        (replication.ReleaseOutdated("x"), "VERSION_MISMATCH"),
        (replication.LogUnavailable("x"), "NO_QUORUM"),
        (replication.OutcomeUnknown("x"), "AMBIGUOUS"),
    ],
)
async def test_the_outcome_of_a_change_of_members_reaches_the_caller(
    rig: tuple[Node, Any], failure: Exception, reason: str
) -> None:
    node, stub = rig
    node.log.change_fails = failure
    error = await reason_of(stub.RemoveSupernode(pb.RemoveSupernodeRequest(supernode_id="s2"), timeout=10))
    assert error.reason == reason


async def test_a_snapshot_begins_with_its_facts_and_has_the_backup_on_request(rig: tuple[Node, Any]) -> None:
    node, stub = rig
    await node.register(1)
    [facts] = [one async for one in stub.TakeSnapshot(pb.TakeSnapshotRequest(), timeout=10)]
    assert (facts.supernode_id, facts.log_index, len(facts.sha256)) == ("s1", node.log.index, 32)
    repeated, *parts = [one async for one in stub.TakeSnapshot(pb.TakeSnapshotRequest(include_data=True), timeout=10)]
    assert repeated == facts
    assert sum(len(part.data) for part in parts) == facts.size_bytes


async def test_without_a_majority_only_a_stale_snapshot_can_be_taken(rig: tuple[Node, Any]) -> None:
    node, stub = rig
    node.log.quorum = False
    error = await reason_of(stub.TakeSnapshot(pb.TakeSnapshotRequest(), timeout=10).read())
    assert error.reason == "NO_QUORUM"
    [facts] = [one async for one in stub.TakeSnapshot(pb.TakeSnapshotRequest(stale_ok=True), timeout=10)]
    assert facts.log_index == node.log.index


async def test_the_number_of_calls_that_take_snapshots_is_limited(rig: tuple[Node, Any]) -> None:
    node, stub = rig
    node.log.reads_may_end.clear()
    waiting = [stub.TakeSnapshot(pb.TakeSnapshotRequest(), timeout=10) for _ in range(SNAPSHOTS_MAX)]
    firsts = [asyncio.ensure_future(call.read()) for call in waiting]
    # The first ones are still waiting, so one more is refused.
    extra = stub.TakeSnapshot(pb.TakeSnapshotRequest(), timeout=10)
    refused = await first_refused([*firsts, asyncio.ensure_future(extra.read())])
    assert refused.reason == "OVERLOADED"
    node.log.reads_may_end.set()


async def first_refused(pending: list[asyncio.Future[Any]]) -> StampedeError:
    done, _ = await asyncio.wait(pending, return_when=asyncio.FIRST_COMPLETED)
    return await reason_of(done.pop())


FOUNDING = FoundingRecord(supernode_id="a", address="h:1", members={"a": "h:1"}, log_cluster_id="c", token="t")


def test_a_founding_file_is_read_as_it_was_written_and_only_its_user_can_read_it(tmp_path: Path) -> None:
    write_founding(tmp_path / "a", FOUNDING)
    assert read_founding(tmp_path / "a") == FOUNDING
    assert (tmp_path / "a" / "supernode.json").stat().st_mode & 0o077 == 0
    with pytest.raises(StampedeError, match="already"):
        check_unused(tmp_path / "a")


def test_a_supernode_that_was_started_before_needs_its_store(tmp_path: Path) -> None:
    write_founding(tmp_path, FOUNDING)
    assert FOUNDING.replication_settings(tmp_path).create
    assert not note_started(tmp_path, FOUNDING).replication_settings(tmp_path).create
    assert read_founding(tmp_path) == replace(FOUNDING, started=True)


@pytest.mark.parametrize("text", ["", "{}", "[]", '{"format_version": 1, "surprise": 2}', '{"format_version": 9}'])
def test_a_damaged_founding_file_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "supernode.json").write_text(text)
    with pytest.raises(StampedeError, match=r"supernode\.json"):
        read_founding(tmp_path)


def test_an_unprepared_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(StampedeError, match="stampede supernode init"):
        SupernodeSettings(data_dir=tmp_path).founding("localhost:1")
