"""Whatever happens to the channels of a group, its cut, its views and its events tell what the oracle tells.

`STAMPEDE_PROPERTY_EXAMPLES=1000000 pytest tests/property/test_group_against_oracle.py` searches at length.
"""

from __future__ import annotations

import os

import pytest
from hypothesis import HealthCheck, given, note, settings
from hypothesis import strategies as st

from stampede_rt.model import Policy
from stampede_rt_channel_host.core.group import GroupDefinition
from tests.property.dice import Dice
from tests.property.group_world import CHANNELS, World
from tests.property.test_channel_against_oracle import FIRST_CLOCK, a_query, a_time, an_offer

EXAMPLES = int(os.environ.get("STAMPEDE_PROPERTY_EXAMPLES", "600"))
MAX_WAIT = 6

POLICIES = (
    Policy(max_age_nanos=200, max_future_nanos=8),
    Policy(max_items=4, max_future_nanos=8),
    Policy(max_age_nanos=12, max_items=5, max_bytes=500, max_future_nanos=8),
    Policy(max_items=40, max_future_nanos=8),
    Policy(max_age_nanos=9, max_future_nanos=0),
)


def a_definition(dice: Dice) -> GroupDefinition:
    members = dice.pick((CHANNELS, CHANNELS, CHANNELS[:2], CHANNELS[:1]))
    return GroupDefinition(
        members=frozenset(members),
        reference=dice.pick((None, None, members[0])),
        by_end=dice.one_in(3),
        max_lead_nanos=dice.pick((5, 0, 50)),
        idle_after_nanos=dice.pick((None, None, 7)),
    )


def put(dice: Dice, world: World) -> None:
    channel_id = dice.pick(CHANNELS)
    pair = world.pairs[channel_id]
    pair.put(an_offer(dice, pair))
    world.spoken(channel_id)


def advance(dice: Dice, world: World) -> None:
    channel_id = dice.pick(CHANNELS)
    pair = world.pairs[channel_id]
    pair.advance(min(a_time(dice, pair), pair.clock))
    world.spoken(channel_id)


def tick(dice: Dice, world: World) -> None:
    nanos = dice.pick((1, 2, 0, 5, 9, 30))
    world.clock += nanos
    for pair in world.pairs.values():
        pair.tick(nanos)


def read(dice: Dice, world: World) -> None:
    channel_id = dice.pick(CHANNELS)
    world.read(channel_id, a_query(dice, world.pairs[channel_id]))


def begin(dice: Dice, world: World) -> None:
    channel_id = dice.pick(CHANNELS)
    if len(world.gets) < 4:
        world.begin(channel_id, a_query(dice, world.pairs[channel_id]))


def subscribe(dice: Dice, world: World) -> None:
    if len(world.readers) < 3:
        world.subscribe(dice.pick(CHANNELS))


def deliver(dice: Dice, world: World) -> None:
    world.deliver(dice.pick((10**6, 1, 150)))


def subscribe_cuts(dice: Dice, world: World) -> None:
    if len(world.events) < 2:
        world.subscribe_cuts(MAX_WAIT)


def take_events(dice: Dice, world: World) -> None:
    world.take_events(MAX_WAIT, dice.pick((10**6, 1, 150)))


def match(dice: Dice, world: World) -> None:
    if len(world.matchers) < 2:
        world.match(dice.pick((2, 0, 5)))


def take_matches(dice: Dice, world: World) -> None:
    world.take_matches()


def exchange(dice: Dice, world: World) -> None:
    world.exchange()


def change_member(dice: Dice, world: World) -> None:
    world.change_member(dice.pick(CHANNELS), joins=bool(dice.below(2)))


def stale_words(dice: Dice, world: World) -> None:
    world.stale_words(dice.pick(CHANNELS))


def rest(dice: Dice, world: World) -> None:
    """Nothing happens: what a step shrinks to."""


STEPS = (
    rest, put, put, tick, read, put, deliver, take_events, subscribe, put, subscribe_cuts, exchange, match, put, begin,
    take_matches, advance, tick, change_member, stale_words, put,
)  # fmt: skip


def play(numbers: list[int]) -> None:
    """One story: a group, then a step for each number."""
    first = Dice(numbers[0])
    definition = a_definition(first)
    world = World([first.pick(POLICIES) for _ in CHANNELS], definition, first.one_in(2), FIRST_CLOCK)
    for number in numbers[1:]:
        dice = Dice(number)
        step = dice.pick(STEPS)
        note(step.__name__)
        step(dice, world)
        world.look()
        world.poll_all()
    world.deliver(10**6)
    world.take_events(MAX_WAIT, 10**6)
    world.take_matches()
    world.agree()
    world.check()


@pytest.mark.timeout(0 if EXAMPLES > 5000 else 240)
@settings(max_examples=EXAMPLES, deadline=None, suppress_health_check=list(HealthCheck), database=None)
@given(st.lists(st.integers(0, 2**96), min_size=10, max_size=40))
def test_a_group_does_what_the_oracle_does_in_every_story(numbers: list[int]) -> None:
    play(numbers)
