"""Feature levels: the commands that a cluster of several releases may use, and releases that do not know all."""

from __future__ import annotations

from collections.abc import AsyncIterator

import pytest

from stampede_rt.errors import VersionMismatch
from stampede_rt.v1 import directory_command_pb2
from stampede_rt.v1 import directory_service_pb2 as pb
from stampede_rt.values.model import Policy
from stampede_rt_supernode.codecs.command_codec import decode_result, encode_command, level_needed
from stampede_rt_supernode.codecs.snapshot_codec import decode_snapshot, encode_snapshot
from stampede_rt_supernode.core.channels.commands import ChannelUpdated, UpdateChannel
from stampede_rt_supernode.core.cluster.commands import BeginTenure, RaiseFeatureLevel
from stampede_rt_supernode.core.cluster.feature_levels import HIGHEST_LEVEL
from stampede_rt_supernode.core.commands import Command, Operation, RefusedOperation
from stampede_rt_supernode.core.directory import Directory
from stampede_rt_supernode.replica import DirectoryReplica
from stampede_rt_supernode.replication.interface import ReleaseTooOld
from stampede_rt_supernode.servicers.level_keeper import LevelKeeper
from stampede_rt_supernode.servicers.submission import Submission
from tests.support.newer_release import CAPPED, NEW_KIND, NEW_LEVEL, NewerReplica, encode_cap, encode_newer
from tests.support.supernode.memory_log import MemoryLog
from tests.support.supernode.node import Node, running_node
from tests.support.supernode.operations import TTL_NANOS, id_of, open_channel, register

FOUNDING = BeginTenure(tenure=1, supernode_id="s1", new_cluster_id="c", new_lease_ttl_nanos=TTL_NANOS)


def encoded(number: int, operation: Operation) -> bytes:
    return encode_command(Command(op_id=id_of(number), time_unix_nano=number, operation=operation))


RAISE = encoded(900, RaiseFeatureLevel(feature_level=NEW_LEVEL))
START = [encoded(1, FOUNDING), encoded(2, register(1)), encoded(3, open_channel("cam/1"))]


def driven(replica: DirectoryReplica, *commands: bytes) -> list[bytes]:
    return [replica.apply(index, command) for index, command in enumerate(commands, start=1)]


def cap(replica: DirectoryReplica, number: int = 500) -> bytes:
    [channel] = replica.read(lambda directory: list(directory.tables.channels.values()))
    return encode_cap(id_of(number), channel.channel_id, channel.epoch)


def test_each_kind_of_command_has_a_level_that_this_release_knows() -> None:
    kinds = directory_command_pb2.DirectoryCommand.DESCRIPTOR.oneofs_by_name["kind"].fields
    assert all(1 <= level_needed(one.name) <= HIGHEST_LEVEL for one in kinds)
    assert level_needed("a kind of a later release") > HIGHEST_LEVEL


def test_no_replica_of_any_release_applies_a_command_above_the_clusters_level() -> None:
    older, newer, more = DirectoryReplica(), NewerReplica(), encoded(5, open_channel("cam/2"))
    for replica in (older, newer):
        driven(replica, *START)
    command = cap(older)
    for replica in (older, newer):
        result = decode_result(replica.apply(4, command))
        assert isinstance(result, RefusedOperation)
        assert result.reason == "VERSION_MISMATCH"
        replica.apply(5, more)
    assert older.digest() == newer.digest()
    assert older.read(encode_snapshot) == newer.read(encode_snapshot)


def test_a_command_is_accepted_when_the_feature_level_has_risen() -> None:
    newer = NewerReplica()
    driven(newer, *START)
    assert not newer.takes(cap(newer))
    newer.apply(4, RAISE)
    assert newer.takes(cap(newer))
    result = decode_result(newer.apply(5, cap(newer)))
    assert isinstance(result, ChannelUpdated)
    assert result.channel.policy.max_items == CAPPED.max_items


def test_a_supernode_stops_at_a_feature_level_that_its_release_does_not_know() -> None:
    older = DirectoryReplica()
    driven(older, *START)
    with pytest.raises(ReleaseTooOld, match=f"knows feature level {HIGHEST_LEVEL}.* at level {NEW_LEVEL}; start"):
        older.apply(4, RAISE)


def test_a_supernode_does_not_open_a_snapshot_above_the_level_of_its_release() -> None:
    newer = NewerReplica()
    driven(newer, *START, RAISE)
    snapshot = newer.begin_snapshot()()
    assert decode_snapshot(snapshot).feature_level == NEW_LEVEL
    restored = NewerReplica()
    restored.prepare_restore(snapshot)()
    assert restored.feature_level == NEW_LEVEL
    with pytest.raises(ReleaseTooOld):
        DirectoryReplica().prepare_restore(snapshot)


def test_the_level_never_falls_and_a_new_cluster_begins_at_the_level_of_its_founder() -> None:
    founded = BeginTenure(
        tenure=1, supernode_id="s1", new_cluster_id="c", new_lease_ttl_nanos=TTL_NANOS, new_feature_level=NEW_LEVEL
    )
    newer = NewerReplica()
    lower = encoded(901, RaiseFeatureLevel(feature_level=1, tenure=1))
    later = encoded(902, BeginTenure(tenure=2, supernode_id="s2", new_cluster_id="d", new_lease_ttl_nanos=TTL_NANOS))
    driven(newer, encoded(1, founded), lower, later)
    assert newer.feature_level == NEW_LEVEL


@pytest.mark.parametrize(("tenure", "raised"), [(1, False), (2, True), (3, False), (0, False)])
def test_only_the_leader_of_the_present_tenure_raises_the_level(tenure: int, raised: bool) -> None:
    """In an earlier version, a late command of a former leader raised the level, though a member of a lower level had
    just joined.
    """
    newer = NewerReplica()
    founded = BeginTenure(
        tenure=1, supernode_id="s1", new_cluster_id="c", new_lease_ttl_nanos=TTL_NANOS, new_feature_level=HIGHEST_LEVEL
    )
    later = BeginTenure(tenure=2, supernode_id="s2", new_cluster_id="d", new_lease_ttl_nanos=TTL_NANOS)
    late = RaiseFeatureLevel(feature_level=NEW_LEVEL, tenure=tenure)
    driven(newer, encoded(1, founded), encoded(2, later), encoded(3, late))
    assert (newer.feature_level == NEW_LEVEL) is raised


def test_a_later_tenure_does_not_raise_the_level_by_itself() -> None:
    newer = NewerReplica()
    later = BeginTenure(
        tenure=2, supernode_id="s2", new_cluster_id="d", new_lease_ttl_nanos=TTL_NANOS, new_feature_level=NEW_LEVEL
    )
    driven(newer, encoded(1, FOUNDING), encoded(2, later))
    assert newer.feature_level == 1


def test_a_snapshot_without_a_feature_level_is_at_the_first_level() -> None:
    assert Directory(feature_level=0).feature_level == 1


# -- the leader raises it ------------------------------------------------------------------------------------------


async def keeper_over(replica: DirectoryReplica) -> tuple[LevelKeeper, MemoryLog, Submission]:
    log = MemoryLog(replica)
    submission = Submission(log, replica, time_unix_nano=lambda: 1)
    for command in START:
        await log.propose(command, timeout=1)
    return LevelKeeper(log, replica, submission), log, submission


async def test_the_leader_raises_the_feature_level_only_when_all_members_have_reported_that_they_know_it() -> None:
    newer = NewerReplica()
    keeper, log, _ = await keeper_over(newer)
    reports: list[dict[str, int]] = [{"s1": NEW_LEVEL}, {"s1": NEW_LEVEL, "s2": 1}, {"s2": NEW_LEVEL}]
    for log.highest_levels in reports:
        await keeper.tick()
        assert newer.feature_level == 1
    log.highest_levels = {"s1": NEW_LEVEL, "s2": NEW_LEVEL + 1}
    await keeper.tick()
    assert newer.feature_level == NEW_LEVEL
    index = log.index
    await keeper.tick()
    assert log.index == index, "the level is raised once"


async def test_a_follower_does_not_raise_the_feature_level() -> None:
    newer = NewerReplica()
    keeper, log, _ = await keeper_over(newer)
    log.leader_id = "s2"
    await keeper.tick()
    assert newer.feature_level == 1


async def test_a_refused_command_is_not_in_the_log_and_the_error_names_its_level_and_the_older_members(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("stampede_rt_supernode.servicers.submission.encode_command", encode_newer)
    newer = NewerReplica()
    _, log, submission = await keeper_over(newer)
    [channel] = newer.read(lambda directory: list(directory.tables.channels.values()))
    operation = UpdateChannel(channel_id=channel.channel_id, epoch=channel.epoch, policy=Policy(max_items=1))
    log.highest_levels, index = {"s1": NEW_LEVEL, "s2": 1}, log.index
    with pytest.raises(VersionMismatch) as caught:
        await submission.submit(operation, ChannelUpdated, op_id=id_of(9), seconds=1.0)
    assert log.index == index
    for part in (NEW_KIND, f"level {NEW_LEVEL}", "s2 (level 1)", "nothing was done", "upgrade", "rises by itself"):
        assert part in caught.value.message
    assert caught.value.metadata["supernodes_behind"] == "s2"
    log.highest_levels = {"s1": NEW_LEVEL}
    with pytest.raises(VersionMismatch, match=r"s2 \(no report\)"):
        await submission.submit(operation, ChannelUpdated, op_id=id_of(9), seconds=1.0)


@pytest.fixture
async def node() -> AsyncIterator[Node]:
    async with running_node() as node:
        yield node


async def test_supernodes_report_the_feature_level_of_the_cluster_and_of_each_member(node: Node) -> None:
    node.log.highest_levels = {"s1": HIGHEST_LEVEL}
    pong = await node.call(node.stub.Ping(pb.DirectoryServicePingRequest(), timeout=10))
    assert (pong.feature_level, pong.highest_feature_level) == (HIGHEST_LEVEL, HIGHEST_LEVEL)
    listed = await node.call(node.stub.ListSupernodes(pb.ListSupernodesRequest(), timeout=10))
    assert listed.feature_level == HIGHEST_LEVEL
    assert {one.supernode_id: one.highest_feature_level for one in listed.supernodes} == {"s1": HIGHEST_LEVEL, "s2": 0}
