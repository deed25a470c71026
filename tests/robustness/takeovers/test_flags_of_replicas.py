"""The flags of replicas in the directory after changes that their owner learns late, in virtual time."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import replace
from typing import Any

import pytest

from stampede_rt.values.model import Policy
from stampede_rt_channel_host.copies.replica_directory import FeedSource
from stampede_rt_supernode.core.moves.commands import CommitMove
from stampede_rt_supernode.core.records import ReplicaRecord
from tests.robustness.takeovers import simulate
from tests.robustness.takeovers.channel_callers import ChannelCallers
from tests.robustness.takeovers.world import Cluster
from tests.support.supernode.operations import add_replica, remove_replica, update
from tests.support.virtual_time import VirtualClock, run_virtually

SETTLED_SECONDS, SOON_SECONDS = 15.0, 2.0


class Scenario:
    """A channel with one replica in sync, and a producer."""

    def __init__(self, clock: VirtualClock, ack: str) -> None:
        policy = Policy(replicas=1, ack=ack)
        self.cluster = Cluster(clock, 1, 2, policy)
        self.callers = ChannelCallers(self.cluster, self.cluster.channel_id, policy, self.cluster.rng, 0.05)

    def replicas(self) -> tuple[ReplicaRecord, ...]:
        return self.cluster.log.directory.tables.replicas.of(self.cluster.channel_id)

    async def bind(self) -> None:
        """Let the owner learn of the present record of the channel, as a client does."""
        channel = self.cluster.channel
        await self.cluster.owner.store.bind(channel.channel_id, channel.epoch, channel.policy_version)


def play(ack: str, events: Callable[[Scenario], Awaitable[None]]) -> tuple[ReplicaRecord, ...]:
    """Play the events after the replica has come in sync. Returns the replicas of the directory at the end."""

    async def main(clock: VirtualClock) -> tuple[ReplicaRecord, ...]:
        scenario = Scenario(clock, ack)
        producing = asyncio.create_task(scenario.callers.produce(1))
        try:
            await asyncio.sleep(SETTLED_SECONDS)
            assert [one.in_sync for one in scenario.replicas()] == [True]
            await events(scenario)
            return scenario.replicas()
        finally:
            producing.cancel()
            await scenario.cluster.aclose()

    return run_virtually(main, 1, *simulate.WITH_CLOCKS)


@pytest.mark.parametrize(("before", "after"), [("replica", "host"), ("host", "replica")])
def test_the_directory_refuses_a_replica_of_an_owner_that_does_not_know_the_new_policy(before: str, after: str) -> None:
    """The answer to the change of the policy comes late. In an earlier version the replica stayed. With `ack="host"` it
    became the owner under the same incarnation, although items were lost. The owner also removes a replica that a
    caller adds meanwhile.
    """

    async def events(scenario: Scenario) -> None:
        cluster = scenario.cluster
        cluster.apply(update(cluster.channel_id, cluster.channel.epoch, ack=after))
        await asyncio.sleep(SETTLED_SECONDS)
        assert scenario.replicas() == ()
        number, is_acknowledged = 3 - scenario.callers.owner_number(), after == "replica"
        epoch = cluster.channel.epoch
        adding = add_replica(cluster.channel_id, number, epoch=epoch, warm=True, acknowledged=is_acknowledged)
        cluster.apply(adding)
        await asyncio.sleep(SETTLED_SECONDS)
        assert scenario.replicas() == (), "the owner has removed it"
        await scenario.bind()
        await asyncio.sleep(SETTLED_SECONDS)

    replicas = play(before, events)
    assert [(one.in_sync, one.acknowledged) for one in replicas] == [(True, after == "replica")]


def test_a_replica_is_in_sync_again_soon_after_a_move_has_failed() -> None:
    """The end of the move gives the owner another epoch, and clears the flag. In an earlier version the owner set
    it again only after its next list of replicas, up to 10 s later.
    """

    async def events(scenario: Scenario) -> None:
        cluster = scenario.cluster
        channel, identity = cluster.channel, cluster.owner.identity
        failed = CommitMove(
            channel_id=channel.channel_id, epoch=channel.epoch, to_host_id=identity.host_id,
            to_boot_incarnation=identity.boot_incarnation,
        )  # fmt: skip
        cluster.apply(failed)
        assert [one.in_sync for one in scenario.replicas()] == [False]
        await scenario.bind()
        await asyncio.sleep(SOON_SECONDS)

    assert [one.in_sync for one in play("host", events)] == [True]


class LateLookup:
    """The next lookup of a copy's source by a host. The directory answers it, but the answer comes after `release`."""

    def __init__(self, directory: Any) -> None:
        self.is_answered, self.release = asyncio.Event(), asyncio.Event()
        self._directory, self._source_of = directory, directory.source_of
        directory.source_of = self._answered_late

    async def _answered_late(self, channel_id: bytes, host_id: bytes) -> FeedSource | None:
        self._directory.source_of = self._source_of
        answer = await self._source_of(channel_id, host_id)
        self.is_answered.set()
        await self.release.wait()
        return answer


def test_a_late_answer_about_a_removed_replica_does_not_drop_the_replica_that_was_added_again() -> None:
    """The feed of the removed replica never ended, so the new replica came in sync. In an earlier version its host then
    dropped all items. It became the owner without them if the owner was lost within a second.
    """

    async def events(scenario: Scenario) -> None:
        cluster, callers = scenario.cluster, scenario.callers
        channel_id, owner = cluster.channel_id, callers.owner_number()
        number = 3 - owner
        lookup = LateLookup(cluster.hosts[number].directory)
        cluster.apply(replace(remove_replica(channel_id, number), epoch=cluster.channel.epoch))
        checking = asyncio.create_task(cluster.hosts[number].copies._check_removed([channel_id]))
        await lookup.is_answered.wait()
        cluster.apply(add_replica(channel_id, number, epoch=cluster.channel.epoch, warm=True, acknowledged=True))
        await asyncio.sleep(SETTLED_SECONDS)
        assert [one.in_sync for one in scenario.replicas()] == [True]
        lookup.release.set()
        await checking
        acknowledged = {*callers.acknowledged}
        cluster.kill(owner)
        await asyncio.sleep(SETTLED_SECONDS)
        assert callers.owner_number() == number
        assert acknowledged
        assert acknowledged <= {*callers.look()}

    play("replica", events)
