"""One stream carries one move after the other, while something breaks in a later move, or between two of them."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import pytest

from stampede_rt.errors import StampedeError
from stampede_rt.v1 import replica_service_pb2 as pb
from stampede_rt_channel_host.copies import replica_servicer
from stampede_rt_channel_host.copies.moves import incoming_moves, move_streams
from tests.robustness.moves.links import Link
from tests.robustness.moves.test_crashes_at_each_step import Scenario, quick
from tests.robustness.moves.two_hosts import DESTINATION, SOURCE, STEPS, World

__all__ = ["quick"]  # the fixture of short waits


class SuccessiveMoves:
    """Scenarios of channels that move one after the other, in one world."""

    def __init__(self, channels: int = 2) -> None:
        self.world = World("", lambda world: None, channels=channels)
        self.scenarios = [Scenario(world=self.world, channel_id=one) for one in self.world.channel_ids]

    async def move_first(self) -> None:
        """Move the first channel. Afterwards its stream waits for the next move."""
        assert await self.scenarios[0].move() is None
        assert len(self.world.links) == 1

    async def move_next(self, crash_at: str, happens: Callable[[World], None]) -> StampedeError | None:
        """Move the second channel, and call `happens` at the step `crash_at`."""
        self.world.reached.clear()
        self.world.crash_at, self.world.happens = crash_at, happens
        return await self.scenarios[1].move()

    async def check(self, *scenarios: Scenario) -> None:
        """Check that nothing acknowledged is lost, and that puts go on."""
        for scenario in scenarios or self.scenarios:
            scenario.check(await scenario.settle())
            scenario.put()
            scenario.check(await scenario.settle())


async def test_moves_that_follow_each_other_share_a_stream(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(incoming_moves, "RELEASED_SECONDS_MAX", 20.0)  # a stream with a late release is not used again
    moves = SuccessiveMoves(channels=4)
    for scenario in moves.scenarios:
        assert await scenario.move() is None
    assert len(moves.world.links) == 1
    await moves.check()


@pytest.mark.parametrize("step", STEPS)
async def test_the_second_move_of_a_stream_loses_nothing_if_the_link_breaks(step: str) -> None:
    moves = SuccessiveMoves()
    await moves.move_first()
    await moves.move_next(step, lambda world: world.cut_links())
    await moves.check()


@pytest.mark.parametrize("step", STEPS)
async def test_the_second_move_of_a_stream_loses_nothing_if_the_source_dies(step: str) -> None:
    moves = SuccessiveMoves()
    await moves.move_first()
    await moves.move_next(step, lambda world: world.kill(SOURCE))
    moves.world.expire(SOURCE)
    first, second = moves.scenarios
    moved = moves.world.owner_of(second.channel_id) is second.destination
    assert moved or STEPS.index(step) < STEPS.index("committed")
    await moves.check(first, *[second] * moved)


@pytest.mark.parametrize("step", STEPS)
async def test_the_second_move_of_a_stream_loses_nothing_if_the_destination_dies(step: str) -> None:
    moves = SuccessiveMoves()
    await moves.move_first()
    await moves.move_next(step, lambda world: world.kill(DESTINATION))
    moves.world.expire(DESTINATION)
    second = moves.scenarios[1]
    if STEPS.index(step) < STEPS.index("removed"):  # from then on only the destination has the items, like any owner
        assert moves.world.owner_of(second.channel_id) is second.source
        await moves.check(second)


async def test_a_move_over_a_stream_that_broke_meanwhile_uses_a_new_one() -> None:
    moves = SuccessiveMoves()
    await moves.move_first()
    moves.world.cut_links()
    assert await moves.move_next("", lambda world: None) is None
    assert len(moves.world.links) == 2
    await moves.check()


async def test_a_failed_move_ends_its_stream() -> None:
    moves = SuccessiveMoves(channels=3)
    await moves.move_first()
    assert await moves.move_next("held", lambda world: world.cut_links()) is not None
    await moves.check(*moves.scenarios[:2])
    assert await moves.scenarios[2].move() is None
    assert len(moves.world.links) == 2
    await moves.check(moves.scenarios[2])


async def test_a_refused_move_ends_its_stream_and_keeps_the_reason() -> None:
    moves = SuccessiveMoves(channels=3)
    await moves.move_first()
    second = moves.scenarios[1]
    await second.source.store.bind(second.channel_id, 1)
    with pytest.raises(StampedeError, match="no caller has asked this host"):
        await second.destination.incoming.move_here(*moves.world.placed(second.channel_id))
    assert await moves.scenarios[2].move() is None
    await moves.check(moves.scenarios[0], moves.scenarios[2])


async def test_a_source_of_an_older_release_ends_the_stream_after_each_move(monkeypatch: pytest.MonkeyPatch) -> None:
    write = Link.write

    async def as_older(link: Link, request: pb.FeedRequest) -> None:
        if request.HasField("open"):
            request.open.ClearField("another_may_follow")
        await write(link, request)

    monkeypatch.setattr(Link, "write", as_older)
    moves = SuccessiveMoves()
    for scenario in moves.scenarios:
        assert await scenario.move() is None
    assert len(moves.world.links) == 2
    await moves.check()


@pytest.mark.parametrize(("module", "name"), [(move_streams, "FREE_SECONDS"), (replica_servicer, "FREE_SECONDS_MAX")])
async def test_a_stream_without_a_next_move_ends(module: object, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, name, 0.01)
    moves = SuccessiveMoves()
    await moves.move_first()
    serving = moves.world.links[0].serving
    assert serving is not None
    async with asyncio.timeout(30):
        await asyncio.wait({serving})
    assert await moves.move_next("", lambda world: None) is None
    await moves.check()
    assert len(moves.world.links) == 2


async def test_a_host_that_ends_also_ends_the_streams_that_wait_for_a_move() -> None:
    moves = SuccessiveMoves()
    await moves.move_first()
    await moves.scenarios[0].destination.incoming.aclose()
    serving = moves.world.links[0].serving
    assert serving is not None
    async with asyncio.timeout(30):
        await asyncio.wait({serving})
