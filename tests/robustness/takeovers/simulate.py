"""Take-overs and moves of a channel with replicas under random faults.

Producers put numbered items one after the other, and put an item again until it is acknowledged. A reader reads all
items. No acknowledged or seen item may be lost, with the exception of those that `ack="host"` allows, and none may be
there twice. Two hosts never serve the channel at the same time. When the faults are over, nobody is stuck.
"""

from __future__ import annotations

import asyncio
import random
from contextlib import suppress
from typing import NamedTuple

from stampede_rt.errors import StampedeError
from stampede_rt.values.model import Policy
from stampede_rt.wire.runs import encode_run
from stampede_rt_channel_host.channels.copy_state import CopyState
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.puts.held_acks import AckOfReplicas
from stampede_rt_channel_host.channels.puts.incoming_run import IncomingRun
from stampede_rt_channel_host.channels.puts.put_requests import Put
from stampede_rt_channel_host.channels.puts.wanted_acks import held_ack
from stampede_rt_channel_host.channels.replication import Replication
from stampede_rt_channel_host.copies.allowed_moves import AllowedMoves
from tests.robustness.takeovers.faults import Faults
from tests.robustness.takeovers.virtual_time import VirtualClock, run_virtually
from tests.robustness.takeovers.world import Cluster, LeasedHost, serving
from tests.support.supernode.operations import id_of

HEALED_SECONDS = 60.0
PRODUCERS, PAUSE_SECONDS, ACK_SECONDS = 2, 0.15, 2.0
LAG_SECONDS_MAX, SLACK_SECONDS = 1.0, 0.1
FACTOR = 16  # more than the producers
WITH_CLOCKS = (CopyState.__init__, Replication.__init__, AllowedMoves.__init__)

Item = tuple[int, int]
"""A producer and the number of its item."""


class Found(NamedTuple):
    """The figures of one run."""

    acknowledged: int
    takeovers: int
    moves: int
    lost: int


class Trial:
    """One run."""

    def __init__(self, clock: VirtualClock, seed: int) -> None:
        self.rng = random.Random(seed)
        self.clock = clock
        ack = self.rng.choice(("host", "replica"))
        count, replicas = self.rng.choice(((3, 1), (3, 2), (4, 1), (4, 2)))
        policy = Policy(replicas=replicas, ack=ack, min_replicas=self.rng.choice((0, 1)))
        self.policy, self.cluster = policy, Cluster(clock, seed, count, policy)
        self.acknowledged: set[Item] = set()
        self.last_ack_s: dict[int, float] = {}  # by incarnation
        self.known: dict[int, dict[Item, float]] = {}  # by incarnation: when each item was first acknowledged or seen
        self.moves = 0

    # Callers.

    def owner(self) -> LeasedHost | None:
        """The owner, if callers reach it."""
        host = self.cluster.hosts[self.owner_number()]
        return host if host.alive and host.running.is_set() else None

    def owner_number(self) -> int:
        return int.from_bytes(self.cluster.channel.host_id, "big")

    async def produce(self, producer: int) -> None:
        """Put items one after the other."""
        number = 1
        while True:
            with suppress(StampedeError, TimeoutError):
                async with asyncio.timeout(ACK_SECONDS + 1):
                    if await self._put(producer, number):
                        number += 1
            await asyncio.sleep(self.rng.uniform(0, 2 * PAUSE_SECONDS))

    async def _put(self, producer: int, number: int) -> bool:
        host = self.owner()
        if host is None:
            return False
        hosted = await host.store.bind(self.cluster.channel_id, self.cluster.channel.epoch)
        run = IncomingRun(
            encode_run([b"an item"], times=[number * FACTOR + producer]), producer_id=producer, first_number=number,
            wait_nanos=round(ACK_SECONDS * 1e9),
        )  # fmt: skip
        run.keep()
        ack = hosted.puts.put(run, host.store.now())
        if ack is None:
            try:
                ack = await run.wait(hosted.puts.give_up)
            finally:
                hosted.puts.withdraw(run)
        held = held_ack(ack, hosted, Put(number, round(ACK_SECONDS * 1e9), b""), self.clock.monotonic())
        if isinstance(held, AckOfReplicas):
            ack = await held.due()
        if not host.alive or ack.HasField("error") or not ack.HasField("first_seq"):
            return False
        self.acknowledged.add((producer, number))
        self.last_ack_s[ack.incarnation] = self.clock.now_s
        self._know(ack.incarnation, (producer, number))
        return True

    def _know(self, incarnation: int, item: Item) -> None:
        self.known.setdefault(incarnation, {}).setdefault(item, self.clock.now_s)

    async def read(self) -> None:
        """Read the items at the owner again and again."""
        while True:
            await asyncio.sleep(self.rng.uniform(0.1, 0.5))
            self.look()

    def look(self) -> list[Item]:
        """Note what readers see."""
        at = serving(self.cluster)
        assert len(at) <= 1, "two hosts serve the channel"
        host = self.owner()
        hosted = None if host is None else host.store.known(self.cluster.channel_id)
        if hosted is None or not at or self.cluster.hosts[at[0]] is not host:
            return []
        items = items_of(hosted)
        assert len(set(items)) == len(items), "an item is there twice"
        for item in items:
            self._know(hosted.channel.incarnation, item)
        return items

    async def move(self, number: int) -> None:
        record, host = self.cluster.record, self.cluster.hosts[number]
        if host.alive and record.host_id != id_of(number):
            self.cluster.allow(number)
            await host.incoming.move_here(*await host.directory.owner_of(record.channel_id))
            self.moves += 1

    # The judgement.

    async def settle(self) -> None:
        """Wait until puts go on and all replicas are in sync. Raises AssertionError."""
        acknowledged = len(self.acknowledged)
        ends_s = self.clock.now_s + HEALED_SECONDS
        while len(self.acknowledged) < acknowledged + 2 * PRODUCERS or not self._is_complete():
            assert self.clock.now_s < ends_s, self._stuck(len(self.acknowledged) - acknowledged)
            await asyncio.sleep(0.1)

    def _is_complete(self) -> bool:
        return self.cluster.is_complete(self.policy.replicas or 0)

    def _stuck(self, puts: int) -> str:
        host = self.owner()
        hosted = None if host is None else host.store.known(self.cluster.channel_id)
        states = None if hosted is None or hosted.replication is None else hosted.replication.states()
        return f"stuck: {puts} puts since the faults were over; the owner has {states}, {self.policy}"

    def judge(self, items: list[Item]) -> int:
        """Check that nothing else is lost than what may be. Returns the number of lost items."""
        there, order = set(items), self.cluster.incarnations[self.cluster.channel_id]
        lost = 0
        for at, incarnation in enumerate(order):
            times = self.known.get(incarnation, {})
            if not goes_on(order, at):
                continue  # no replica was in sync
            missing = {item: since for item, since in times.items() if item not in there}
            lost += len(missing)
            last_s = self.last_ack_s.get(incarnation, 0.0)  # later items were seen, and nobody has an answer for them
            ends_at = self.policy.ack == "host" and at + 1 < len(order)
            early = [
                item
                for item, since in missing.items()
                if not ends_at or since < last_s - LAG_SECONDS_MAX - SLACK_SECONDS
            ]
            assert not early, f"{len(early)} items of incarnation {at} are lost too early: {sorted(early)[:3]}"
        return lost


def goes_on(order: list[int], at: int) -> bool:
    """Whether all later incarnations have begun with the items of a replica."""
    return all(after == (before + 1) % 2**64 for before, after in zip(order[at:], order[at + 1 :], strict=False))


def items_of(hosted: HostedChannel) -> list[Item]:
    """The items that readers see. The time of an item names it."""
    times = [time for part in hosted.channel.accepted_from(1) for time in part.run.times[part.lo : part.hi]]
    return [(time % FACTOR, time // FACTOR) for time in times]


async def _main(clock: VirtualClock, seed: int) -> Found:
    trial = Trial(clock, seed)
    producers = [asyncio.create_task(trial.produce(one + 1)) for one in range(PRODUCERS)]
    reader = asyncio.create_task(trial.read())
    try:
        await asyncio.sleep(3.0)
        await Faults(trial.cluster, trial.rng, trial.owner_number, trial.move).disturb()
        trial.cluster.heal()
        await trial.settle()
        for task in producers:
            task.cancel()
        await asyncio.gather(*producers, return_exceptions=True)
        if reader.done():
            await reader
        lost = trial.judge(trial.look())
    finally:
        for task in (reader, *producers):
            task.cancel()
        await trial.cluster.aclose()
    return Found(
        len(trial.acknowledged), len(trial.cluster.incarnations[trial.cluster.channel_id]) - 1, trial.moves, lost
    )


def run(seed: int) -> Found:
    """Play one seed. Raises AssertionError if a promise was broken."""
    return run_virtually(lambda clock: _main(clock, seed), seed, *WITH_CLOCKS)
