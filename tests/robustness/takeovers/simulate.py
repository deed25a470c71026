"""Take-overs and moves of a channel with replicas under random faults.

No acknowledged or seen item may be lost, except the items that may be lost with `ack="host"`. No item may be there
twice. Two hosts never serve the channel at the same time. When the faults are over, no caller is stuck.
"""

from __future__ import annotations

import asyncio
import random
from typing import NamedTuple

from stampede_rt.values.model import Policy
from stampede_rt_channel_host.channels.copy_state import CopyState
from stampede_rt_channel_host.channels.replication import Replication
from stampede_rt_channel_host.copies.moves.allowed_moves import AllowedMoves
from tests.robustness.takeovers.channel_callers import ChannelCallers, Item
from tests.robustness.takeovers.faults import Faults
from tests.robustness.takeovers.world import Cluster
from tests.support.supernode.operations import id_of
from tests.support.virtual_time import VirtualClock, run_virtually

HEALED_SECONDS = 60.0
PRODUCERS, PAUSE_SECONDS = 2, 0.15
WITH_CLOCKS = (CopyState.__init__, Replication.__init__, AllowedMoves.__init__)


class RunFigures(NamedTuple):
    """The figures of one run."""

    acknowledged: int
    takeovers: int
    moves: int
    lost: int


class Trial:
    """One run."""

    def __init__(self, clock: VirtualClock, seed: int) -> None:
        rng = self.rng = random.Random(seed)
        self.clock = clock
        ack = rng.choice(("host", "replica"))
        count, replicas = rng.choice(((3, 1), (3, 2), (4, 1), (4, 2)))
        policy = Policy(replicas=replicas, ack=ack, min_replicas=rng.choice((0, 1)))
        self.policy, self.cluster = policy, Cluster(clock, seed, count, policy)
        self.callers = ChannelCallers(self.cluster, self.cluster.channel_id, policy, rng, PAUSE_SECONDS)
        self.producers = [asyncio.create_task(self.callers.produce(one + 1)) for one in range(PRODUCERS)]
        self.moves = 0

    async def move(self, number: int) -> None:
        record, host = self.cluster.record, self.cluster.hosts[number]
        if host.alive and record.host_id != id_of(number):
            self.cluster.allow(number)
            await host.incoming.move_here(*await host.directory.owner_of(record.channel_id))
            self.moves += 1

    async def settle(self) -> list[Item]:
        """Wait until puts go on and all replicas are in sync. Returns the items that readers see then. Raises
        AssertionError.
        """
        callers, cluster = self.callers, self.cluster
        acknowledged, ends_s = len(callers.acknowledged), self.clock.now_s + HEALED_SECONDS
        while (
            len(callers.acknowledged) < acknowledged + 2 * PRODUCERS
            or not cluster.is_complete(self.policy.replicas or 0)
            or callers.served() is None
        ):
            for one in self.producers:
                if one.done():
                    one.result()
            assert self.clock.now_s < ends_s, self._stuck(len(callers.acknowledged) - acknowledged)
            await asyncio.sleep(0.1)
        return callers.look()

    def _stuck(self, puts: int) -> str:
        host = self.callers.owner()
        hosted = None if host is None else host.store.known(self.cluster.channel_id)
        states = None if hosted is None or hosted.replication is None else hosted.replication.states()
        return f"stuck: {puts} puts since the faults were over; the owner has {states}, {self.policy}"


async def _main(clock: VirtualClock, seed: int) -> RunFigures:
    trial = Trial(clock, seed)
    callers = trial.callers
    reader = asyncio.create_task(callers.read())
    try:
        await asyncio.sleep(3.0)
        await Faults(trial.cluster, trial.rng, callers.owner_number, trial.move).disturb()
        trial.cluster.heal()
        lost = callers.judge(await trial.settle())
        if reader.done():
            await reader
    finally:
        for task in (reader, *trial.producers):
            task.cancel()
        await trial.cluster.aclose()
    takeovers = len(trial.cluster.incarnations[trial.cluster.channel_id]) - 1
    return RunFigures(len(callers.acknowledged), takeovers, trial.moves, lost)


def run(seed: int) -> RunFigures:
    """Play one seed. Raises AssertionError if a promise was broken."""
    return run_virtually(lambda clock: _main(clock, seed), seed, *WITH_CLOCKS)
