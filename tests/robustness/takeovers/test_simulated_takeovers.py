"""Take-overs and moves of channels and queues with replicas under random faults, in virtual time."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Iterator
from typing import TypeVar

import pytest

from stampede_rt.errors import StampedeError
from stampede_rt.values.model import Policy
from tests.robustness.moves.links import Link
from tests.robustness.takeovers import simulate, simulate_drains, simulate_queues
from tests.robustness.takeovers.channel_callers import ChannelCallers
from tests.robustness.takeovers.world import Cluster
from tests.support.virtual_time import VirtualClock, run_virtually

T = TypeVar("T")
SEEDS_IN_SUITE, BLOCKS = 12, 2
QUEUE_SEEDS_IN_SUITE = 4
DRAIN_SEEDS_IN_SUITE = 6
REPORTS_PER_SECOND_MAX = 12  # one replica and its owner send five each, and answer
IDLE_SECONDS = 10.0


def played(kind: str, run: Callable[[int], T], seeds: Iterable[int]) -> Iterator[T]:
    """The outcome of each seed. An error of `run` says how to play its seed again."""
    for seed in seeds:
        try:
            outcome = run(seed)
        except Exception as error:
            error.add_note(f"replay: python -m tests.robustness.takeovers --of {kind} --first {seed} --seeds 1")
            raise
        yield outcome


@pytest.mark.parametrize("block", range(BLOCKS))
def test_a_channel_loses_and_duplicates_nothing_and_no_caller_is_stuck_under_faults(block: int) -> None:
    acknowledged = changes = 0
    for found in played("channels", simulate.run, range(block, SEEDS_IN_SUITE, BLOCKS)):
        acknowledged += found.acknowledged
        changes += found.takeovers + found.moves
    # Virtual time is the same on every machine, so these numbers do not depend on the load.
    assert acknowledged > 100 * SEEDS_IN_SUITE / BLOCKS, "there were too many faults: nothing was tested"
    assert changes > 0, "there were too few faults: the owner never changed"


def test_no_message_of_a_queue_is_lost_or_comes_back_after_its_ack_under_faults() -> None:
    acknowledged = dead_letters = changes = 0
    for found in played("queues", simulate_queues.run, range(QUEUE_SEEDS_IN_SUITE)):
        acknowledged += found.acknowledged
        dead_letters += found.dead_letters
        changes += found.owners - 1
    assert acknowledged > 100 * QUEUE_SEEDS_IN_SUITE, "there were too many faults: nothing was tested"
    assert dead_letters > 0, "there were no dead letters"
    assert changes > 0, "there were too few faults: the owner never changed"


def test_drains_lose_nothing_of_live_hosts_and_leave_no_channel_when_their_streams_break() -> None:
    early_holds = breaks = losses = moved = 0
    for found in played("drains", simulate_drains.run, range(DRAIN_SEEDS_IN_SUITE)):
        early_holds += found.early_holds
        breaks += found.breaks
        losses += found.losses
        moved += found.moved
    assert min(early_holds, breaks, losses) > 0
    assert moved > 2 * breaks, "there were too many faults: nothing was tested"


@pytest.mark.parametrize("ack", ["host", "replica"])
def test_an_idle_replica_and_its_owner_exchange_a_few_messages_a_second(
    ack: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    sent: list[float] = []
    write = Link.write

    async def counted(link: Link, request: object) -> None:
        sent.append(asyncio.get_running_loop().time())
        await write(link, request)  # type: ignore[arg-type]

    monkeypatch.setattr(Link, "write", counted)

    async def main(clock: VirtualClock) -> int:
        cluster = Cluster(clock, 1, 2, Policy(replicas=1, ack=ack))
        try:
            while not cluster.is_complete(1):
                await asyncio.sleep(0.1)
                try:
                    await cluster.owner.store.bind(cluster.channel_id, cluster.channel.epoch)
                except StampedeError:
                    continue
            sent.clear()
            await asyncio.sleep(IDLE_SECONDS)
            return len(sent)
        finally:
            await cluster.aclose()

    assert 0 < run_virtually(main, 1, *simulate.WITH_CLOCKS) <= REPORTS_PER_SECOND_MAX * IDLE_SECONDS


def test_no_ack_counts_a_replica_whose_host_has_lost_its_lease() -> None:
    """The replica reaches the owner, but not the directory. When its lease has ended, it would not become the owner."""
    policy = Policy(replicas=1, ack="replica", min_replicas=1)

    async def main(clock: VirtualClock) -> tuple[int, int]:
        cluster = Cluster(clock, 1, 2, policy)
        callers = ChannelCallers(cluster, cluster.channel_id, policy, cluster.rng, 0.02)
        producing = asyncio.create_task(callers.produce(1))
        try:
            await asyncio.sleep(IDLE_SECONDS)
            (replica,) = cluster.successors(cluster.channel_id)
            cluster.cut_off.add(int.from_bytes(replica, "big"))
            await asyncio.sleep(IDLE_SECONDS)
            before = len(callers.acknowledged)
            cluster.cut_off.clear()
            await asyncio.sleep(IDLE_SECONDS)
            if producing.done():
                await producing
            return before, len(callers.acknowledged)
        finally:
            producing.cancel()
            await cluster.aclose()

    before, after = run_virtually(main, 1, *simulate.WITH_CLOCKS)
    assert 20 < before < after


def test_a_queue_counts_no_replica_whose_host_has_lost_its_lease() -> None:
    async def main(clock: VirtualClock) -> tuple[int, int]:
        trial = simulate_queues.QueueTrial(clock, 1, replicas=1)
        cluster, unsafe = trial.cluster, 0
        producing = asyncio.create_task(trial.produce(1))
        try:
            await asyncio.sleep(IDLE_SECONDS)
            (replica,) = cluster.successors(cluster.jobs_id)
            cluster.cut_off.add(int.from_bytes(replica, "big"))
            before = trial.jobs.put()
            for _ in range(round(2 * IDLE_SECONDS / 0.05)):
                has_replica, count = [*cluster.successors(cluster.jobs_id)], trial.jobs.put()
                await asyncio.sleep(0.05)
                if not has_replica and not [*cluster.successors(cluster.jobs_id)]:
                    unsafe += trial.jobs.put() - count
            return unsafe, trial.jobs.put() - before
        finally:
            producing.cancel()
            await cluster.aclose()

    unsafe, puts = run_virtually(main, 1, *simulate_queues.WITH_CLOCKS)
    assert puts > 20
    assert not unsafe, "puts are acknowledged that no replica would keep"
