"""Members come and go over real gRPC with real stores, under load. No acknowledged write is lost."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from stampede_rt_supernode.replication import (
    ChangeRefused,
    ChangeUnderWay,
    LogUnavailable,
    NotLeading,
    OutcomeUnknown,
    ReplicatedLog,
)
from stampede_rt_supernode.replication.rules import member_changes
from tests.support.supernode.live_cluster import (
    STEADY,
    LiveCluster,
    LiveMember,
    commands_of,
    proposed,
    running,
    until,
)


@dataclass
class Load:
    """Writes one command after the other until the block ends, at any running member."""

    acknowledged: list[bytes] = field(default_factory=list)

    async def run(self, cluster: LiveCluster) -> None:
        number = 0
        while True:
            member = cluster.all[number % len(cluster.all)]
            number += 1
            command = b"load %d" % number
            try:
                await running(member).propose(command, timeout=2.0)
            except (OutcomeUnknown, LogUnavailable, AssertionError):
                continue
            self.acknowledged.append(command)

    async def wait_for_progress(self) -> None:
        """Wait until some more writes were acknowledged."""
        target = len(self.acknowledged) + 5
        await until(lambda: len(self.acknowledged) >= target)


@asynccontextmanager
async def under_load(cluster: LiveCluster) -> AsyncIterator[Load]:
    load = Load()
    task = asyncio.create_task(load.run(cluster))
    try:
        yield load
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


async def test_a_cluster_of_one_grows_to_three_and_shrinks_back_under_load(tmp_path: Path) -> None:
    async with LiveCluster(1, tmp_path, snapshot_every=40) as cluster, under_load(cluster) as load:
        await load.wait_for_progress()
        for _ in range(2):
            await cluster.add(await cluster.volunteer())
            await load.wait_for_progress()
        ids = {member.member_id for member in running(await cluster.leader()).status().members}
        assert ids == {"m0", "m1", "m2"}
        first = cluster.all[0]
        await cluster.remove(first)
        await load.wait_for_progress()
        await cluster.remove(await cluster.leader())
        await load.wait_for_progress()
        [last] = cluster.all
        await running(last).confirm_read(timeout=30.0)
        held = set(commands_of(last))
        assert [command for command in load.acknowledged if command not in held] == []
        assert [member.member_id for member in running(last).status().members] == [last.member.member_id]


async def test_a_newcomer_catches_up_by_snapshot_before_it_counts(tmp_path: Path) -> None:
    async with LiveCluster(1, tmp_path, snapshot_every=10) as cluster:
        for number in range(50):
            await proposed(cluster.all[0], b"%d" % number)
        newcomer = await cluster.volunteer()
        index = await cluster.add(newcomer)
        await until(lambda: running(newcomer).status().applied_index >= index)
        assert len(commands_of(newcomer)) == 50


async def test_members_survive_a_restart_of_all_of_them(tmp_path: Path) -> None:
    async with LiveCluster(1, tmp_path) as cluster:
        newcomer = await cluster.volunteer()
        await cluster.add(newcomer)
        await proposed(newcomer, b"before")
        for member in cluster.all:
            await member.stop()
        for member in cluster.all:  # each start names the same members as the first start of this member
            await cluster.start(member)
        await proposed(newcomer, b"after")
        ids = [[each.member_id for each in running(member).status().members] for member in cluster.all]
        assert ids == [["m0", "m1"], ["m0", "m1"]]


async def test_a_removed_member_learns_of_its_removal_and_never_comes_back(tmp_path: Path) -> None:
    async with LiveCluster(3, tmp_path) as cluster:
        [removed, _] = await cluster.followers()
        await cluster.on_leader(lambda log: log.remove_member(removed.member.member_id, timeout=5.0))
        await until(lambda: running(removed).status().removed)
        with pytest.raises(ChangeRefused, match="never used again"):
            await cluster.on_leader(lambda log: log.add_member(removed.member, timeout=5.0))
        with pytest.raises((LogUnavailable, OutcomeUnknown)):
            await running(removed).propose(b"after the removal", timeout=0.5)


async def test_only_the_leader_changes_members_and_one_at_a_time(tmp_path: Path) -> None:
    async with LiveCluster(1, tmp_path) as cluster:
        first, second = await cluster.volunteer(), await cluster.volunteer()
        leader = running(cluster.all[0])
        with pytest.raises(NotLeading):
            await running(first).add_member(second.member, timeout=1.0)
        await second.stop()  # so that its addition has to wait
        under_way = asyncio.create_task(leader.add_member(second.member, timeout=30.0))
        await until(lambda: second.member.member_id in cluster.all[0].log._replica.roster.peers)  # type: ignore[union-attr]
        with pytest.raises(ChangeUnderWay):
            await leader.add_member(first.member, timeout=1.0)
        with pytest.raises(OutcomeUnknown, match="still under way"):
            await leader.add_member(second.member, timeout=0.1)
        under_way.cancel()


async def test_a_newcomer_that_is_stuck_delays_no_removal_and_another_newcomer_replaces_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(member_changes, "REPLACED_AFTER_SECONDS", 0.3)
    async with LiveCluster(3, tmp_path, timing=STEADY) as cluster:
        stuck, other = await cluster.volunteer(), await cluster.volunteer()
        await stuck.stop()
        leader = running(await cluster.leader())
        under_way = asyncio.create_task(leader.add_member(stuck.member, timeout=60.0))
        await until(lambda: stuck.member.member_id in leader._replica.roster.peers)  # type: ignore[attr-defined]
        removed = next(one for one in await cluster.followers() if one not in (stuck, other))
        await leader.remove_member(removed.member.member_id, timeout=5.0)
        assert not under_way.done()
        await let_in(leader, other)
        with pytest.raises(ChangeUnderWay, match="took nothing of the log"):
            await under_way
        # the leader has given up this newcomer before, so now another newcomer replaces it without delay
        monkeypatch.setattr(member_changes, "REPLACED_AFTER_SECONDS", 3600.0)
        repeated = asyncio.create_task(leader.add_member(stuck.member, timeout=60.0))
        await until(lambda: stuck.member.member_id in leader._replica.roster.peers)  # type: ignore[attr-defined]
        await let_in(leader, await cluster.volunteer())
        with pytest.raises(ChangeUnderWay):
            await repeated


async def let_in(leader: ReplicatedLog, newcomer: LiveMember) -> None:
    """Add a newcomer in the way in which its own process asks: repeat the request while another change is under way."""
    async with asyncio.timeout(20):
        while True:
            try:
                await leader.add_member(newcomer.member, timeout=10.0)
                return
            except ChangeUnderWay:
                await asyncio.sleep(0.02)


async def test_a_membership_change_without_effect_is_accepted_and_an_impossible_one_is_refused(tmp_path: Path) -> None:
    async with LiveCluster(1, tmp_path) as cluster:
        [only] = cluster.all
        log = running(only)
        await log.confirm_read(timeout=30.0)
        await log.add_member(only.member, timeout=5.0)
        await log.remove_member("nobody", timeout=5.0)
        with pytest.raises(ChangeRefused, match="last member"):
            await log.remove_member("m0", timeout=5.0)


async def test_a_member_that_the_majority_needs_is_not_removed(tmp_path: Path) -> None:
    async with LiveCluster(3, tmp_path) as cluster:
        down, alive = await cluster.followers()
        await down.stop()

        async def removed(log: ReplicatedLog) -> int:
            await until(lambda: not _is_alive(log, down))
            return await log.remove_member(alive.member.member_id, timeout=5.0)

        with pytest.raises(ChangeRefused, match="no majority"):
            await cluster.on_leader(removed)
        await cluster.on_leader(lambda log: log.remove_member(down.member.member_id, timeout=5.0))
        await proposed(alive, b"two are enough")


def _is_alive(leader: ReplicatedLog, other: LiveMember) -> bool:
    node = leader._replica._node  # type: ignore[attr-defined]
    return other.member.member_id in node.alive_voters(within_seconds=0.6)


async def test_a_leader_that_the_majority_needs_is_not_removed_by_its_successor_either(tmp_path: Path) -> None:
    async with LiveCluster(3, tmp_path) as cluster:
        first = (await cluster.leader()).member.member_id
        [down, _] = await cluster.followers()
        await down.stop()  # for a moment the leader still counts this member as alive, and hands over
        with pytest.raises(ChangeRefused, match="no majority"):
            await cluster.on_leader(lambda log: log.remove_member(first, timeout=5.0))
        await proposed(await cluster.leader(), b"still served")
        assert len(running(await cluster.leader()).status().members) == 3


async def test_a_leader_hands_over_immediately(tmp_path: Path) -> None:
    async with LiveCluster(3, tmp_path, timing=STEADY) as cluster:
        leader = await cluster.leader()
        assert await running(leader).hand_over(timeout=30.0)
        assert not running(leader).status().is_leader
        assert await cluster.leader() is not leader


async def test_a_lone_leader_keeps_its_leadership(tmp_path: Path) -> None:
    async with LiveCluster(1, tmp_path) as cluster:
        await cluster.leader()
        assert not await running(cluster.all[0]).hand_over(timeout=2.0)
        assert running(cluster.all[0]).status().is_leader
