"""Several channels move at the same time, and their moves share entries of the log, while something breaks.

As in `test_crashes_at_each_step`, the protocol's real code runs over the real state machine of the directory. The step
of a scenario is reached when the first channel reaches it, while the others are at the same step or at earlier ones.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

import pytest

from stampede_rt.errors import StampedeError
from stampede_rt_channel_host.channels import move_under_way
from stampede_rt_channel_host.copies.moves import outgoing_moves
from stampede_rt_channel_host.core.records import RecordedChannel
from stampede_rt_supernode.core.records import ReplicaKind
from tests.robustness.moves.simulated_directory import SimulatedDirectory
from tests.robustness.moves.test_crashes_at_each_step import Scenario, quick
from tests.robustness.moves.two_hosts import DESTINATION, SOURCE, STEPS, World
from tests.support.supernode.operations import id_of

CHANNELS = 5

__all__ = ["quick"]  # the fixture of short waits


class Several:
    """A scenario for each channel, in one world."""

    def __init__(self, crash_at: str = "", happens: Callable[[World], None] = lambda world: None) -> None:
        self.world = World(crash_at, happens, channels=CHANNELS)
        self.scenarios = [Scenario(world=self.world, channel_id=one) for one in self.world.channel_ids]

    async def move(self) -> list[StampedeError | None]:
        """Move all channels. Returns the errors of the moves that failed."""
        return await asyncio.gather(*(scenario.move() for scenario in self.scenarios))

    async def check(self) -> None:
        """Check that nothing acknowledged is lost in any channel, and puts go on."""
        for scenario in self.scenarios:
            scenario.check(await scenario.settle())
            scenario.put()
            scenario.check(await scenario.settle())

    def has_fallback(self, scenario: Scenario) -> bool:
        copies = self.world.log.directory.tables.replicas.of(scenario.channel_id)
        return any(one.kind is ReplicaKind.MOVE for one in copies)


async def test_moves_at_the_same_time_share_entries_and_lose_nothing() -> None:
    several = Several()
    assert await several.move() == [None] * CHANNELS
    assert several.world.channels_per_entry_max > 1, "no entry has committed several moves"
    await several.check()
    for scenario in several.scenarios:
        await scenario.until(lambda one=scenario: several.world.hosts[SOURCE].store.known(one.channel_id) is None)  # type: ignore[misc]


@pytest.mark.parametrize("step", STEPS)
async def test_a_move_loses_nothing_if_the_destination_dies(step: str) -> None:
    several = Several(step, lambda world: world.kill(DESTINATION))
    await several.move()
    alone = [
        scenario
        for scenario in several.scenarios
        if several.world.owner_of(scenario.channel_id) is scenario.destination and not several.has_fallback(scenario)
    ]
    several.world.expire(DESTINATION)
    several.scenarios = [scenario for scenario in several.scenarios if scenario not in alone]
    assert all(several.world.owner_of(scenario.channel_id) is scenario.source for scenario in several.scenarios)
    assert not alone or STEPS.index(step) >= STEPS.index("removed")
    await several.check()


@pytest.mark.parametrize("step", STEPS)
async def test_a_move_loses_nothing_if_the_source_dies(step: str) -> None:
    several = Several(step, lambda world: world.kill(SOURCE))
    await several.move()
    several.world.expire(SOURCE)
    several.scenarios = [
        scenario
        for scenario in several.scenarios
        if several.world.owner_of(scenario.channel_id) is scenario.destination
    ]
    assert several.scenarios or STEPS.index(step) < STEPS.index("committed")
    await several.check()


@pytest.mark.parametrize("step", STEPS)
async def test_a_move_loses_nothing_if_the_link_between_the_hosts_breaks(step: str) -> None:
    several = Several(step, lambda world: world.cut_links())
    await several.move()
    await several.check()


@pytest.mark.parametrize("step", STEPS)
async def test_a_move_loses_nothing_if_the_directory_cannot_be_reached_for_a_while(
    step: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The directory cannot be reached for longer than a change waits.

    So the source ends the moves when it reaches the directory again.
    """
    for module in (move_under_way, outgoing_moves):
        monkeypatch.setattr(module, "HELD_SECONDS_MAX", 0.05)

    def cut_off(world: World) -> None:
        world.is_cut_off = True
        asyncio.get_running_loop().call_later(0.15, setattr, world, "is_cut_off", False)

    several = Several(step, cut_off)
    await several.move()
    await several.check()


async def test_no_put_is_acknowledged_while_former_owners_are_fallbacks() -> None:
    """The directory cannot be reached when it should remove the fallbacks.

    Then the destination dies, and the fallbacks become owners again.
    """
    several = Several("removal is asked for", lambda world: setattr(world, "is_cut_off", True))
    moves = asyncio.create_task(several.move())
    committed = [one for one in several.scenarios if several.world.owner_of(one.channel_id) is one.destination]
    async with asyncio.timeout(30):
        while not committed or not all(one.waiting and one.waiting[-1][2] is one.destination for one in committed):
            await asyncio.sleep(0)
            committed = [one for one in several.scenarios if several.world.owner_of(one.channel_id) is one.destination]
    several.world.kill(DESTINATION)
    await asyncio.gather(moves, return_exceptions=True)
    several.world.expire(DESTINATION)
    several.world.is_cut_off = False
    await several.check()


async def test_a_move_that_its_source_has_ended_fails_and_the_other_moves_succeed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """In the common entry of several moves, one move has an epoch that has changed meanwhile."""
    several = Several()
    commit_all: Any = SimulatedDirectory.commit_all
    ended: list[bytes] = []

    async def commit_after_an_end(directory: SimulatedDirectory, moves: Any) -> list[RecordedChannel]:
        if not ended and len(moves) > 1:
            ended.append(moves[0].channel_id)
            source = several.world.hosts[SOURCE].directory
            await source.commit(moves[0].channel_id, moves[0].epoch, b"r" * 16)
        return await commit_all(directory, moves)  # type: ignore[no-any-return]

    monkeypatch.setattr(SimulatedDirectory, "commit_all", commit_after_an_end)
    failures = await several.move()
    assert [failure.reason for failure in failures if failure is not None] == ["WRONG_EPOCH"]
    assert ended
    assert several.world.record_of(ended[0]).host_id == id_of(SOURCE)
    await several.check()
