"""Drains of hosts with several channels under random faults.

The streams of drains and of moves also break at random messages, and hosts die or stop at such a message. Some channels
are idle: their owner holds them before the destination requests this. No acknowledged or seen item may be lost unless
its owner's lease ends, and none may be there twice. Two hosts never serve a channel at the same time. When the faults
are over, puts go on, and a drain whose stream breaks once more leaves no channel at its host.
"""

from __future__ import annotations

import asyncio
import random
from collections.abc import Callable
from contextlib import suppress
from typing import NamedTuple

from stampede_rt.values.model import Policy
from stampede_rt_channel_host.channels.copy_state import CopyState
from stampede_rt_channel_host.copies.moves.allowed_moves import AllowedMoves
from tests.robustness.moves.links import Link
from tests.robustness.takeovers.channel_callers import ChannelCallers
from tests.robustness.takeovers.drain_world import DrainCluster
from tests.robustness.takeovers.faults import Fault, Faults
from tests.robustness.takeovers.streams import Call
from tests.support.virtual_time import VirtualClock, run_virtually

HEALED_SECONDS = 30.0
DRAIN_SECONDS_MAX = 30.0  # without faults a drain takes less than a second
PAUSES_SECONDS = (0.1, 0.1, 1.5, 4.0)  # the mean pauses of producers; a channel is idle after a second
MESSAGES_MAX = 40
HANDOFF_PUT_SHARE = 0.3
DRAINS_AT_END = 3
WITH_CLOCKS = (CopyState.__init__, AllowedMoves.__init__)


class RunFigures(NamedTuple):
    """The figures of one run."""

    acknowledged: int
    losses: int
    moved: int
    early_holds: int
    breaks: int


class HandoffCallers(ChannelCallers):
    """The callers of one channel. The producer often puts just when a channel is handed over, perhaps its own
    channel.
    """

    async def pause(self) -> None:
        if self.rng.random() >= HANDOFF_PUT_SHARE:
            await super().pause()
            return
        assert isinstance(self.cluster, DrainCluster)
        with suppress(TimeoutError):
            async with asyncio.timeout(self.rng.uniform(0, 4 * self.pause_seconds)):
                await self.cluster.handed_over.wait()


class DrainFaults(Faults):
    """The faults of one run: the faults of all simulators, and breaks at the messages of drains and of moves."""

    breaks = 0

    def kinds(self) -> list[Fault]:
        breaks = [self.cut_at_a_message, self.kill_at_a_message, self.stop_at_a_message]
        return [*super().kinds(), self.move, *breaks, *breaks]

    async def cut_at_a_message(self, _: int) -> None:
        await self._drain_and_break(lambda link: link.cut())

    async def kill_at_a_message(self, _: int) -> None:
        await self._drain_and_break(lambda link: self.begin(self.kill, self._end_of(link)))

    async def stop_at_a_message(self, _: int) -> None:
        await self._drain_and_break(lambda link: self.begin(self.stop, self._end_of(link)))

    async def _drain_and_break(self, fault: Callable[[Call | Link], None]) -> None:
        """Drain a host that owns something. Causes `fault` at one of the messages of the drain."""
        self.break_soon(fault)
        await self.move(self.owner_number())

    def break_soon(self, fault: Callable[[Call | Link], None]) -> None:
        """Call `fault` with the stream of a drain or of a move, at one of the next messages."""

        def count(link: Call | Link) -> None:
            self.breaks += 1
            fault(link)

        assert isinstance(self.cluster, DrainCluster)
        self.cluster.break_at(self.rng.randint(1, MESSAGES_MAX), count)

    def _end_of(self, link: Call | Link) -> int:
        host = self.rng.choice([one for one in (link.source, link.caller) if one is not None])
        return int.from_bytes(host.identity.host_id, "big")


class DrainTrial:
    """One run."""

    def __init__(self, clock: VirtualClock, seed: int) -> None:
        rng = self.rng = random.Random(seed)
        self.clock = clock
        cluster = self.cluster = DrainCluster(clock, seed, rng.choice((2, 3, 3)), rng.choice((1, 4, 8)))
        self.callers = [
            HandoffCallers(cluster, one, Policy(), rng, rng.choice(PAUSES_SECONDS)) for one in cluster.channel_ids
        ]
        self.faults = DrainFaults(cluster, rng, self.owner_number, self.drain)
        self.moved = 0

    def owner_number(self) -> int:
        """The owner of one of the channels."""
        return self.rng.choice(self.callers).owner_number()

    async def drain(self, number: int) -> None:
        """Drain a host."""
        host = self.cluster.hosts[number]
        if host.alive:
            self.moved += (await host.drain(self.rng.choice((2.0, 10.0)))).moved

    async def drain_all(self) -> None:
        """Drain a host while its streams break, but no host is lost. Raises AssertionError if a channel stays."""
        number = self.owner_number()
        self.faults.break_soon(lambda link: link.cut())
        drained = await self.cluster.hosts[number].drain(DRAIN_SECONDS_MAX)
        assert not drained.unmoved, f"a drain left channels: {drained.unmoved}"
        assert not self.cluster.owned_channels(number)
        self.moved += drained.moved

    async def settle(self) -> None:
        """Wait until puts into each channel go on, and all hosts are live. Raises AssertionError."""
        before = [len(one.acknowledged) for one in self.callers]
        ends_s = self.clock.now_s + HEALED_SECONDS
        for callers, count in zip(self.callers, before, strict=True):
            while len(callers.acknowledged) < count + 2 or callers.served() is None:
                assert self.clock.now_s < ends_s, "stuck: puts do not go on"
                await asyncio.sleep(0.1)
        while len([*self.cluster.log.directory.tables.live_hosts()]) < len(self.cluster.hosts):
            assert self.clock.now_s < ends_s, "stuck: a host does not register"
            await asyncio.sleep(0.1)


async def _main(clock: VirtualClock, seed: int) -> RunFigures:
    trial = DrainTrial(clock, seed)
    running = [asyncio.create_task(work) for one in trial.callers for work in (one.produce(1), one.read())]
    try:
        await asyncio.sleep(3.0)
        await trial.faults.disturb()
        trial.cluster.heal()
        await trial.settle()
        for _ in range(DRAINS_AT_END):
            await trial.drain_all()
        await trial.settle()
        for callers in trial.callers:
            callers.judge(callers.look())
        for task in running:
            if task.done():
                await task
    finally:
        for task in running:
            task.cancel()
        await trial.cluster.aclose()
    incarnations = trial.cluster.incarnations.values()
    return RunFigures(
        sum(len(one.acknowledged) for one in trial.callers), sum(len(one) - 1 for one in incarnations), trial.moved,
        trial.cluster.early_holds, trial.faults.breaks,
    )  # fmt: skip


def run(seed: int) -> RunFigures:
    """Play one seed. Raises AssertionError if a promise was broken."""
    return run_virtually(lambda clock: _main(clock, seed), seed, *WITH_CLOCKS)
