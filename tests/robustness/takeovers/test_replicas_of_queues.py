"""The replicas of queues at hosts that the owner no longer needs, or needs anew, in virtual time."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import replace

from tests.robustness.takeovers import simulate_queues
from tests.robustness.takeovers.simulate_queues import QueueTrial
from tests.support.supernode.operations import add_replica, remove_replica, update_queue
from tests.support.virtual_time import VirtualClock, run_virtually

SETTLED_SECONDS = 25.0


def play(replicas: int, events: Callable[[QueueTrial], Awaitable[None]]) -> None:
    """Play the events after the replicas have come in sync."""

    async def main(clock: VirtualClock) -> None:
        trial = QueueTrial(clock, 1, replicas)
        producing = asyncio.create_task(trial.produce(1))
        try:
            await asyncio.sleep(SETTLED_SECONDS)
            assert len(hosts_with_copies(trial)) == replicas
            await events(trial)
        finally:
            producing.cancel()
            await trial.cluster.aclose()

    run_virtually(main, 1, *simulate_queues.WITH_CLOCKS)


def hosts_with_copies(trial: QueueTrial) -> set[int]:
    return {one for one, host in trial.cluster.hosts.items() if host.queues.copies.of(trial.cluster.jobs_id)}


def test_a_host_drops_the_replica_of_a_queue_that_needs_fewer_replicas() -> None:
    """In an earlier version the owner fed this replica for ever."""

    async def events(trial: QueueTrial) -> None:
        cluster = trial.cluster
        cluster.apply(update_queue(cluster.jobs_id, replicas=1))
        await asyncio.sleep(SETTLED_SECONDS)
        assert [one.in_sync for one in cluster.copies(cluster.jobs_id)] == [True]
        assert len(hosts_with_copies(trial)) == 1

    play(2, events)


def test_a_replica_comes_in_sync_also_if_its_host_has_dropped_the_former_one_while_the_owner_was_frozen() -> None:
    """In an earlier version the owner continued the feed of the former replica, which answered that it has nothing."""

    async def events(trial: QueueTrial) -> None:
        cluster = trial.cluster
        owner = cluster.owner_of(cluster.jobs_id)
        (number,) = hosts_with_copies(trial)
        owner.running.clear()
        epoch = cluster.queue(cluster.jobs_id).epoch
        removal = replace(remove_replica(cluster.jobs_id, number), epoch=epoch, is_of_queue=True)
        cluster.apply(removal)
        cluster.hosts[number].queues.copies.drop(cluster.jobs_id)
        adding = add_replica(cluster.jobs_id, number, epoch=epoch, warm=True, acknowledged=True)
        cluster.apply(replace(adding, is_of_queue=True))
        owner.running.set()
        await asyncio.sleep(SETTLED_SECONDS)
        assert [one.in_sync for one in cluster.copies(cluster.jobs_id)] == [True]

    play(1, events)
