"""The source of a drain holds an idle channel unasked. Something breaks at each step, while puts come all the same."""

from __future__ import annotations

import pytest

from stampede_rt.v1 import replica_service_pb2 as pb
from stampede_rt_channel_host.copies import early_holds, handing_over
from tests.robustness.moves.links import Link
from tests.robustness.moves.test_crashes_at_each_step import AFTER_THE_COMMIT, AFTER_THE_REMOVAL, Story, quick
from tests.robustness.moves.two_hosts import DESTINATION, SOURCE, STEPS, World

__all__ = ["quick"]  # the fixture of short waits

EARLY_STEPS = STEPS[STEPS.index("handed over") :]


@pytest.fixture
def all_idle(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each channel counts as idle, although the story puts in each turn of the loop."""
    monkeypatch.setattr(handing_over, "IDLE_NANOS", 0)


@pytest.mark.usefixtures("all_idle")
async def test_one_response_has_the_items_and_the_permit_of_an_idle_channel() -> None:
    story = Story()
    assert await story.move(is_of_drain=True) is None
    assert story.world.reached[0] == "handed over"
    assert "held" not in story.world.reached
    story.check(await story.settle())
    assert story.world.owner is story.destination


async def test_a_channel_with_a_late_put_is_held_when_the_destination_asks() -> None:
    story = Story()
    assert await story.move(is_of_drain=True) is None
    assert set(story.world.reached) == set(STEPS)
    story.check(await story.settle())


@pytest.mark.usefixtures("all_idle")
async def test_a_lone_move_asks_for_the_hold() -> None:
    story = Story()
    assert await story.move() is None
    assert set(story.world.reached) == set(STEPS)


@pytest.mark.usefixtures("all_idle")
@pytest.mark.parametrize("step", EARLY_STEPS)
async def test_the_destination_dies(step: str) -> None:
    story = Story(step, lambda world: world.kill(DESTINATION))
    await story.move(is_of_drain=True)
    story.world.expire(DESTINATION)
    if STEPS.index(step) < AFTER_THE_REMOVAL:  # from then on only the destination has the items, as any owner
        assert story.world.owner is story.source
        story.check(await story.settle())


@pytest.mark.usefixtures("all_idle")
@pytest.mark.parametrize("step", EARLY_STEPS)
async def test_the_source_dies(step: str) -> None:
    story = Story(step, lambda world: world.kill(SOURCE))
    failure = await story.move(is_of_drain=True)
    story.world.expire(SOURCE)
    if failure is None:
        story.check(await story.settle())
    else:
        assert STEPS.index(step) < AFTER_THE_COMMIT


@pytest.mark.usefixtures("all_idle")
@pytest.mark.parametrize("step", EARLY_STEPS)
async def test_the_link_breaks(step: str) -> None:
    story = Story(step, lambda world: world.cut_links())
    await story.move(is_of_drain=True)
    story.check(await story.settle())
    story.put()
    story.check(await story.settle())


@pytest.mark.usefixtures("all_idle")
async def test_after_a_slow_message_the_source_holds_no_channel_early(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(early_holds, "SLOW_SECONDS", -1.0)
    world = World("", lambda world: None, channels=2)
    stories = [Story(world=world, channel_id=one) for one in world.channel_ids]
    assert await stories[0].move(is_of_drain=True) is None
    assert "held" not in world.reached
    assert await stories[1].move(is_of_drain=True) is None
    assert "held" in world.reached
    for story in stories:
        story.check(await story.settle())


@pytest.mark.usefixtures("all_idle")
async def test_a_source_of_an_older_release_waits_for_the_hold(monkeypatch: pytest.MonkeyPatch) -> None:
    write = Link.write

    async def as_older(link: Link, request: pb.FeedRequest) -> None:
        if request.HasField("open"):
            request.open.hand_over_when_idle = False
        await write(link, request)

    monkeypatch.setattr(Link, "write", as_older)
    story = Story()
    assert await story.move(is_of_drain=True) is None
    assert set(story.world.reached) == set(STEPS)
    story.check(await story.settle())
