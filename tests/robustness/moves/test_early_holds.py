"""The source of a drain holds an idle channel before the destination asks it to. At each step something breaks, and
puts still come.
"""

from __future__ import annotations

import pytest

from stampede_rt.errors import PermissionDenied
from stampede_rt.v1 import replica_service_pb2 as pb
from stampede_rt_channel_host.copies.moves import early_holds, handoff_decision
from stampede_rt_channel_host.core.channel import ChannelFeed, FeedPart
from tests.robustness.moves.links import Link
from tests.robustness.moves.test_crashes_at_each_step import AFTER_THE_COMMIT, AFTER_THE_REMOVAL, Scenario, quick
from tests.robustness.moves.two_hosts import DESTINATION, SOURCE, STEPS, World

__all__ = ["quick"]  # the fixture of short waits

EARLY_STEPS = STEPS[STEPS.index("handed over") :]


@pytest.fixture
def all_idle(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each channel counts as idle, although the scenario puts in each turn of the loop."""
    monkeypatch.setattr(handoff_decision, "IDLE_NANOS", 0)


@pytest.mark.usefixtures("all_idle")
async def test_one_response_has_the_items_and_the_permit_of_an_idle_channel() -> None:
    scenario = Scenario()
    assert await scenario.move(is_of_drain=True) is None
    assert scenario.world.reached[0] == "handed over"
    assert "held" not in scenario.world.reached
    scenario.check(await scenario.settle())
    assert scenario.world.owner is scenario.destination


@pytest.mark.usefixtures("all_idle")
async def test_the_source_does_not_look_for_items_in_a_channel_that_it_has_handed_over(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    take, looks = ChannelFeed.take, list[ChannelFeed]()

    def noted(feed: ChannelFeed, now: int, limit_bytes: int) -> FeedPart | None:
        looks.append(feed)
        return take(feed, now, limit_bytes)

    monkeypatch.setattr(ChannelFeed, "take", noted)
    scenario = Scenario()
    assert await scenario.move(is_of_drain=True) is None
    assert len(looks) == 1
    scenario.check(await scenario.settle())


async def test_a_channel_with_a_late_put_is_held_when_the_destination_asks() -> None:
    scenario = Scenario()
    assert await scenario.move(is_of_drain=True) is None
    assert set(scenario.world.reached) == set(STEPS)
    scenario.check(await scenario.settle())


@pytest.mark.usefixtures("all_idle")
async def test_the_destination_of_a_move_outside_a_drain_asks_for_the_hold() -> None:
    scenario = Scenario()
    assert await scenario.move() is None
    assert set(scenario.world.reached) == set(STEPS)


@pytest.mark.usefixtures("all_idle")
@pytest.mark.parametrize("step", EARLY_STEPS)
async def test_an_early_hold_loses_nothing_if_the_destination_dies(step: str) -> None:
    scenario = Scenario(step, lambda world: world.kill(DESTINATION))
    await scenario.move(is_of_drain=True)
    scenario.world.expire(DESTINATION)
    if STEPS.index(step) < AFTER_THE_REMOVAL:  # after the removal only the destination has the items, like any owner
        assert scenario.world.owner is scenario.source
        scenario.check(await scenario.settle())


@pytest.mark.usefixtures("all_idle")
@pytest.mark.parametrize("step", EARLY_STEPS)
async def test_an_early_hold_loses_nothing_if_the_source_dies(step: str) -> None:
    scenario = Scenario(step, lambda world: world.kill(SOURCE))
    failure = await scenario.move(is_of_drain=True)
    scenario.world.expire(SOURCE)
    if failure is None:
        scenario.check(await scenario.settle())
    else:
        assert STEPS.index(step) < AFTER_THE_COMMIT


@pytest.mark.usefixtures("all_idle")
@pytest.mark.parametrize("step", EARLY_STEPS)
async def test_an_early_hold_loses_nothing_if_the_link_breaks(step: str) -> None:
    scenario = Scenario(step, lambda world: world.cut_links())
    await scenario.move(is_of_drain=True)
    scenario.check(await scenario.settle())
    scenario.put()
    scenario.check(await scenario.settle())


@pytest.mark.usefixtures("all_idle")
async def test_after_a_slow_message_the_source_holds_no_channel_early(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(early_holds, "SLOW_SECONDS", -1.0)
    world = World("", lambda world: None, channels=2)
    scenarios = [Scenario(world=world, channel_id=one) for one in world.channel_ids]
    assert await scenarios[0].move(is_of_drain=True) is None
    assert "held" not in world.reached
    assert await scenarios[1].move(is_of_drain=True) is None
    assert "held" in world.reached
    for scenario in scenarios:
        scenario.check(await scenario.settle())


@pytest.mark.usefixtures("all_idle")
async def test_after_a_refused_move_the_source_holds_other_channels_early() -> None:
    """A drain also names channels that are deleted meanwhile, or that move already."""
    world = World("", lambda world: None, channels=2)
    refused, other = [Scenario(world=world, channel_id=one) for one in world.channel_ids]
    with pytest.raises(PermissionDenied):
        await refused.destination.incoming.move_here(*world.placed(refused.channel_id), is_of_drain=True)
    assert await other.move(is_of_drain=True) is None
    assert "held" not in world.reached
    other.check(await other.settle())


@pytest.mark.usefixtures("all_idle")
async def test_a_source_of_an_older_release_waits_for_the_hold(monkeypatch: pytest.MonkeyPatch) -> None:
    write = Link.write

    async def as_older(link: Link, request: pb.FeedRequest) -> None:
        if request.HasField("open"):
            request.open.hand_over_when_idle = False
        await write(link, request)

    monkeypatch.setattr(Link, "write", as_older)
    scenario = Scenario()
    assert await scenario.move(is_of_drain=True) is None
    assert set(scenario.world.reached) == set(STEPS)
    scenario.check(await scenario.settle())
