"""Take-overs and moves of a queue with replicas under random faults.

Producers put numbered messages, and put a message again until it is acknowledged. Takers ack, give back and terminate
messages, or let their leases end. No acknowledged message may be lost, and none may come back after its ack. The next
owner keeps leases and counts of deliveries. Dead letters arrive once. Two hosts never serve a queue at the same time.
When the faults are over, no caller is stuck.
"""

from __future__ import annotations

import asyncio
import random
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import Any, NamedTuple

from stampede_rt.errors import StampedeError
from stampede_rt.values.model import Policy
from stampede_rt_channel_host.channels.limits.memory import MemoryBudget
from stampede_rt_channel_host.copies.moves.allowed_moves import AllowedMoves
from stampede_rt_channel_host.queues.queue_replication import QueueReplication
from tests.robustness.takeovers.faults import Faults
from tests.robustness.takeovers.queue_callers import BREAKS, Taker, put
from tests.robustness.takeovers.queue_ledger import Ledger
from tests.robustness.takeovers.queue_world import QueueCluster, serving_queue
from tests.support.virtual_time import VirtualClock, run_virtually

HEALED_SECONDS = 120.0  # enough time for the leases that takers let end, and then for deliveries to other takers
PRODUCERS, TAKERS, PAUSE_SECONDS = 2, 2, 0.15
CHECK_SECONDS = 0.2
WITH_CLOCKS = (QueueReplication.__init__, MemoryBudget.__init__, AllowedMoves.__init__)


class RunFigures(NamedTuple):
    """The figures of one run."""

    acknowledged: int
    acked: int
    dead_letters: int
    owners: int
    moves: int
    lost: int


class QueueTrial:
    """One run."""

    def __init__(self, clock: VirtualClock, seed: int, replicas: int | None = None) -> None:
        """`replicas`: the number of replicas, at three hosts. None: the seed chooses both numbers."""
        rng = self.rng = random.Random(seed)
        self.clock = clock
        count, drawn = rng.choice(((3, 1), (3, 2), (4, 1), (4, 2)))
        policy = Policy(replicas=drawn, ack="replica", min_replicas=rng.choice((0, 1)))
        if replicas is not None:
            count, policy = 3, Policy(replicas=replicas, ack="replica", min_replicas=1)
        self.policy = policy
        lease_s = rng.choice((3, 10, 20))
        self.cluster = QueueCluster(
            clock, seed, count, policy, lease_nanos=lease_s * 10**9, max_deliveries=rng.choice((2, 5))
        )
        self.jobs, self.dead = Ledger(), Ledger()
        takers = [Taker(self.cluster, self.cluster.jobs_id, one, rng, self.jobs) for one in range(1, TAKERS + 1)]
        dead_letter_taker = Taker(self.cluster, self.cluster.dead_id, TAKERS + 1, rng, self.dead)
        dead_letter_taker.finishes_all = True
        self.takers = [*takers, dead_letter_taker]
        self.moves = 0
        self.faults = Faults(self.cluster, rng, self.owner_number, self.move)

    def owner_number(self) -> int:
        """The owner of one of the queues."""
        queue_id = self.rng.choice((self.cluster.jobs_id, self.cluster.dead_id))
        return int.from_bytes(self.cluster.queue(queue_id).host_id, "big")

    async def move(self, number: int) -> None:
        """Move one of the queues to a host."""
        await self.cluster.move(self.rng.choice((self.cluster.jobs_id, self.cluster.dead_id)), number)
        self.moves += 1

    async def produce(self, producer: int) -> None:
        """Put messages one after the other."""
        number = 1
        while True:
            with suppress(*BREAKS):
                if await put(self.cluster, self.cluster.jobs_id, (producer, number), self.jobs):
                    number += 1
            await asyncio.sleep(self.rng.uniform(0, 2 * PAUSE_SECONDS))

    async def check_owners(self) -> None:
        """Check again and again that at most one host serves each queue."""
        while True:
            await asyncio.sleep(CHECK_SECONDS)
            for queue_id in (self.cluster.jobs_id, self.cluster.dead_id):
                assert len(serving_queue(self.cluster, queue_id)) <= 1, "two hosts serve a queue"

    # The judgement.

    async def settle(self, running: list[asyncio.Task[None]], producers: list[asyncio.Task[None]]) -> None:
        """Wait until puts go on and all replicas are in sync, and then until the queues are empty. Raises
        AssertionError.
        """
        ends_s, goal = self.clock.now_s + HEALED_SECONDS, self.jobs.put() + 2 * PRODUCERS
        while self.jobs.put() < goal or not self.cluster.is_complete(self.policy.replicas or 0):
            self._check(running, ends_s, f"{goal - self.jobs.put()} puts are missing")
            await asyncio.sleep(0.1)
        for one in producers:
            one.cancel()
        for taker in self.takers:
            taker.finishes_all = True
        while (held := self._held()) or any(taker.work for taker in self.takers):
            self._check(running, ends_s, f"{held} messages are left")
            await asyncio.sleep(0.1)

    def _check(self, running: list[asyncio.Task[None]], ends_s: float, what: str) -> None:
        for one in running:
            if one.done() and not one.cancelled():
                one.result()
        for defect in self.cluster.defects:
            raise defect
        assert self.clock.now_s < ends_s, f"stuck: {what}; {self._states()}, {self.policy}"

    def _held(self) -> int:
        """The number of messages in both queues, as their owners know it; 1 if an owner does not answer."""
        held = 0
        for record in self.cluster.queues():
            try:
                hosted = self.cluster.owner_of(record.queue_id).queues.find(record.queue_id, record.epoch)
            except StampedeError:
                return 1
            held += hosted.queue.latest_counters().held
        return held

    def _states(self) -> list[Any]:
        found: list[Any] = []
        for record in self.cluster.queues():
            hosted = self.cluster.hosts[int.from_bytes(record.host_id, "big")].queues.known(record.queue_id)
            found.append(None if hosted is None or hosted.replication is None else hosted.replication.states())
        return found

    def judge(self) -> int:
        """Check the messages of the last incarnation: all must be acked or dead letters, and none may be both.

        Returns the number of messages that were lost with all copies of a queue.
        """
        cluster = self.cluster
        dead, last = self.dead.messages(), self.jobs.of(cluster.queue(cluster.jobs_id).incarnation)
        lost = last.lost() - dead
        if len(cluster.incarnations[cluster.dead_id]) == 1:
            assert not lost, f"{len(lost)} messages are lost: {sorted(lost)[:3]}"
        if len(cluster.incarnations[cluster.jobs_id]) == 1:
            both = sorted(last.acked & dead)
            assert not both, f"{both[:3]} are among the dead letters after their ack"
        return sum(len(one.lost() - dead) for one in self.jobs.incarnations.values())


async def play(trial: QueueTrial, disturb: Callable[[], Awaitable[None]]) -> RunFigures:
    """Play one run. `disturb` makes the faults, which `heal` ends. Raises AssertionError if a promise was broken."""
    producers = [asyncio.create_task(trial.produce(one + 1)) for one in range(PRODUCERS)]
    works = [trial.check_owners(), *(taker.run() for taker in trial.takers)]
    running = [asyncio.create_task(one) for one in works]
    try:
        await asyncio.sleep(3.0)
        await disturb()
        trial.cluster.heal()
        await trial.settle([*producers, *running], producers)
        lost = trial.judge()
    finally:
        for task in (*producers, *running, *(one for taker in trial.takers for one in taker.work)):
            task.cancel()
        await trial.cluster.aclose()
    epochs = trial.cluster.queue(trial.cluster.jobs_id).epoch
    acked = sum(len(one.acked) for one in trial.jobs.incarnations.values())
    return RunFigures(trial.jobs.put(), acked, len(trial.dead.messages()), epochs, trial.moves, lost)


async def _main(clock: VirtualClock, seed: int) -> RunFigures:
    trial = QueueTrial(clock, seed)
    return await play(trial, trial.faults.disturb)


def run(seed: int) -> RunFigures:
    """Play one seed. Raises AssertionError if a promise was broken."""
    return run_virtually(lambda clock: _main(clock, seed), seed, *WITH_CLOCKS)
