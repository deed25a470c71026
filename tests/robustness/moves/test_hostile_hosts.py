"""A host with its own valid certificate cannot take a channel that it was not given, at any step of a move."""

from __future__ import annotations

import asyncio
from contextlib import suppress

import pytest

from stampede_rt.errors import PermissionDenied, StaleBinding, StampedeError
from stampede_rt_runtime.access.move_permits import move_permit
from stampede_rt_supernode.core.moves.commands import CommitMove
from tests.robustness.moves.test_crashes_at_each_step import Scenario, quick
from tests.robustness.moves.two_hosts import DESTINATION, SOURCE, STEPS, THIRD, World, key_of
from tests.support.supernode.operations import id_of

BEFORE_THE_HANDOFF = STEPS[: STEPS.index("handed over")]
assert quick  # the fixture of the other module, which pytest finds by this name


def steal(world: World, thief: int, permits: list[bytes], epoch: int | None = None) -> None:
    """Let a host ask for the channel, with each permit that it knows or can make. The directory must refuse all."""
    epoch = epoch or world.record.epoch
    own = move_permit(key_of(thief), world.channel_id, epoch, id_of(thief))
    for permit in (b"", bytes(32), own, *permits):
        with pytest.raises((PermissionDenied, StaleBinding)):
            world.apply(CommitMove(
                channel_id=world.channel_id, epoch=epoch, to_host_id=id_of(thief), to_boot_incarnation=1, permit=permit
            ))  # fmt: skip


def known_permits(world: World) -> list[bytes]:
    """All permits that any host has given."""
    return [permit for host in world.hosts.values() for permit in host.directory.permits]


@pytest.mark.parametrize("thief", [DESTINATION, THIRD])
async def test_a_host_that_no_move_names_neither_gets_the_channel_nor_stops_its_puts(thief: int) -> None:
    scenario = Scenario(third=True)
    hosted = await scenario.source.store.bind(scenario.world.channel_id, 1)
    scenario.put()
    with pytest.raises(StampedeError, match="no caller has asked"):
        await scenario.world.hosts[thief].incoming.move_here(*scenario.world.placed())
    steal(scenario.world, thief, [])
    scenario.put()
    assert (hosted.moving, scenario.acknowledged, scenario.world.record.epoch) == (None, [1, 2], 1)
    scenario.check(await scenario.settle())
    await scenario.world.aclose()


@pytest.mark.parametrize("step", STEPS)
async def test_a_third_host_steals_nothing_at_any_step_of_a_move(step: str) -> None:
    scenario = Scenario(step, lambda world: steal(world, THIRD, known_permits(world)), third=True)
    assert await scenario.move() is None
    assert step in scenario.world.reached
    steal(scenario.world, THIRD, known_permits(scenario.world))
    scenario.check(await scenario.settle())
    assert scenario.world.owner is scenario.destination
    await scenario.world.aclose()


@pytest.mark.parametrize("step", BEFORE_THE_HANDOFF)
async def test_the_destination_does_not_get_the_channel_before_it_has_everything(step: str) -> None:
    scenario = Scenario(step, lambda world: steal(world, DESTINATION, known_permits(world)))
    assert await scenario.move() is None
    assert step in scenario.world.reached
    scenario.check(await scenario.settle())
    await scenario.world.aclose()


async def test_the_permit_of_a_failed_move_is_refused() -> None:
    """At the commit the directory is out of reach, and the hosts' connection breaks: the source takes a new epoch."""

    def lose(world: World) -> None:
        world.is_cut_off = True
        world.cut_links()

    scenario = Scenario("commit is asked for", lose)
    world = scenario.world
    move = asyncio.create_task(scenario.move())
    await scenario.until(lambda: world.is_cut_off)
    world.hosts[DESTINATION].incoming._moves[world.channel_id].cancel()
    await asyncio.gather(move, return_exceptions=True)  # afterwards no request of the move is under way
    world.is_cut_off = False
    await scenario.until(lambda: world.record.epoch == 2)
    permits = known_permits(world)
    assert permits, "the source has handed over"
    for epoch in (1, 2):
        steal(world, DESTINATION, permits, epoch)
    assert world.owner is world.hosts[SOURCE]
    scenario.check(await scenario.settle())
    await world.aclose()


async def test_a_destination_that_is_no_longer_the_owner_when_it_hears_of_its_commit_drops_the_channel() -> None:
    """The lease of the destination ends right after the commit.

    If the destination kept the channel, the directory would wrongly count the destination as a replica.
    """
    scenario = Scenario("committed", lambda world: world.expire(DESTINATION))
    with suppress(StampedeError):
        await scenario.move()
    world = scenario.world
    await scenario.until(lambda: world.owner is world.hosts[SOURCE])
    assert world.hosts[DESTINATION].store.known(world.channel_id) is None
    await world.aclose()
