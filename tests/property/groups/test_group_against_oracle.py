"""After any changes of channels and hosts, the cuts, views and events of groups are the oracle's.

The changes are puts, late items, collection, consumption, members that join and leave, channels that move, and hosts
that are lost and return. No reader of a descriptor sees an item at or past the cut. No cut moves back. Every item
becomes visible exactly once, in order. The original channels are not affected.

`STAMPEDE_PROPERTY_EXAMPLES=1000000 pytest tests/property/groups/test_group_against_oracle.py` tries more changes.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, field
from unittest import mock

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from stampede_rt.values.model import Policy
from stampede_rt_channel_host.core.channel import item_blocks, pieces
from stampede_rt_channel_host.core.group import GroupDefinition
from tests.property.channel_pair import INCARNATION
from tests.property.groups.listeners import Listeners
from tests.property.groups.readers import Readers
from tests.property.groups.world import CHANNELS, World
from tests.property.random_source import RandomSource
from tests.property.test_channel_against_oracle import (
    FIRST_CLOCK,
    a_bound,
    a_query,
    a_time,
    an_item_position,
    an_offer,
    consume,
)

EXAMPLES = int(os.environ.get("STAMPEDE_PROPERTY_EXAMPLES", "400"))

POLICIES = (
    Policy(max_age_nanos=200, max_future_nanos=8),
    Policy(max_items=4, max_future_nanos=8),
    Policy(max_age_nanos=12, max_items=5, max_bytes=500, max_future_nanos=8),
    Policy(max_items=40, max_future_nanos=8),
    Policy(max_age_nanos=9, max_future_nanos=0),
    Policy(consumers=1, max_items=12, max_future_nanos=8),
    Policy(consumers=2, max_age_nanos=30, max_future_nanos=8),
)


@dataclass
class Scenario:
    """A world with its readers, and the history of the scenario."""

    world: World
    readers: Readers
    listeners: Listeners
    steps: list[str] = field(default_factory=list)

    def a_group(self, rng: RandomSource) -> int:
        return rng.below(len(self.world.definitions))

    def a_member(self, rng: RandomSource) -> tuple[int, bytes]:
        """A group, and one of its channels."""
        group = self.a_group(rng)
        return group, rng.pick(sorted(self.world.definitions[group].members))


def a_definition(rng: RandomSource) -> GroupDefinition:
    members = rng.pick((CHANNELS, CHANNELS, CHANNELS[:2], CHANNELS[:1], CHANNELS[1:]))
    return GroupDefinition(
        members=frozenset(members),
        reference=rng.pick((None, None, members[0])),
        by_end=rng.one_in(3),
        max_lead_nanos=rng.pick((5, 0, 50)),
        idle_after_nanos=rng.pick((None, None, 7)),
    )


def put(rng: RandomSource, scenario: Scenario) -> None:
    put_into(rng, scenario, rng.pick(CHANNELS))


def put_into(rng: RandomSource, scenario: Scenario, channel_id: bytes) -> None:
    pair = scenario.world.pair(channel_id)
    pair.put(an_offer(rng, pair))
    scenario.world.note_change(channel_id)


def advance(rng: RandomSource, scenario: Scenario) -> None:
    channel_id = rng.pick(CHANNELS)
    pair = scenario.world.pair(channel_id)
    pair.advance(min(a_time(rng, pair), pair.clock))
    scenario.world.note_change(channel_id)


def tick(rng: RandomSource, scenario: Scenario) -> None:
    nanos = rng.pick((1, 2, 0, 5, 9, 30))
    scenario.world.clock += nanos
    for channel_id in CHANNELS:
        scenario.world.pair(channel_id).tick(nanos)


def use_up(rng: RandomSource, scenario: Scenario) -> None:
    """Consume on a channel. A channel without consumers must refuse the call."""
    consume(rng, scenario.world.pair(rng.pick(CHANNELS)))


def original(rng: RandomSource, scenario: Scenario) -> None:
    """Read the channel itself, without a group."""
    pair = scenario.world.pair(rng.pick(CHANNELS))
    if len(pair.all_subscriptions) < 2:
        pair.subscribe(None, False, None)
    pair.deliver(rng.pick((10**6, 1)))
    if pair.incarnation == INCARNATION:
        pair.read(a_query(rng, pair))


def read(rng: RandomSource, scenario: Scenario) -> None:
    group, channel_id = scenario.a_member(rng)
    earlier = rng.pick((None, None, FIRST_CLOCK))
    scenario.readers.read(group, channel_id, a_query(rng, scenario.world.pair(channel_id)), earlier)


def begin(rng: RandomSource, scenario: Scenario) -> None:
    group, channel_id = scenario.a_member(rng)
    if len(scenario.readers.gets) < 4:
        scenario.readers.begin(group, channel_id, a_query(rng, scenario.world.pair(channel_id)))


def give_up(rng: RandomSource, scenario: Scenario) -> None:
    scenario.readers.give_up()


def subscribe(rng: RandomSource, scenario: Scenario) -> None:
    group, channel_id = scenario.a_member(rng)
    pair, kind = scenario.world.pair(channel_id), rng.below(4)
    start = a_bound(rng, pair) if kind == 1 else None
    after = an_item_position(rng, pair) if kind == 2 and pair.oracle.log else None
    if len(scenario.readers.subscribers) < 4:
        scenario.readers.subscribe(group, channel_id, start, bool(rng.below(2)), after)


def resume(rng: RandomSource, scenario: Scenario) -> None:
    scenario.readers.resume(rng.below(12))


def resume_by_cursor(rng: RandomSource, scenario: Scenario) -> None:
    scenario.readers.resume_by_cursor(rng.below(4))


def deliver(rng: RandomSource, scenario: Scenario) -> None:
    scenario.readers.deliver(rng.pick((10**6, 1, 150)))


def subscribe_cuts(rng: RandomSource, scenario: Scenario) -> None:
    if len(scenario.listeners.events) < 2:
        scenario.listeners.subscribe_cuts(
            scenario.a_group(rng), rng.pick(scenario.world.up), rng.pick((6, 0, 15)), rng.pick((0, 0, 4))
        )


def take_events(rng: RandomSource, scenario: Scenario) -> None:
    limit_bytes, changes = rng.pick((10**6, 1, 150)), bool(rng.below(2))

    def change_channel(channel_id: bytes) -> None:
        if changes:
            put_into(rng, scenario, channel_id)

    scenario.listeners.take_events(limit_bytes, change_channel)


def match(rng: RandomSource, scenario: Scenario) -> None:
    if len(scenario.listeners.matches) < 2:
        scenario.listeners.match(rng.pick((2, 0, 5)), rng.pick((0, 0, 3)), unique=bool(rng.below(2)))


def take_matches(rng: RandomSource, scenario: Scenario) -> None:
    scenario.listeners.take_matches()


def exchange(rng: RandomSource, scenario: Scenario) -> None:
    """Let all hosts tell all others their times, or one host tell one other."""
    sender, receiver = rng.pick(scenario.world.up), rng.pick(scenario.world.up)
    if rng.below(2) and sender != receiver:
        scenario.world.send_times(sender, receiver)
    else:
        scenario.world.exchange()


def change_member(rng: RandomSource, scenario: Scenario) -> None:
    group, channel_id, joins = scenario.a_group(rng), rng.pick(CHANNELS), bool(rng.below(2))
    if scenario.world.change_member(group, channel_id, joins=joins):
        scenario.listeners.member_changed(group, channel_id, joins=joins)
        if not joins:
            scenario.readers.end_readers_of_member(group, channel_id)


def migrate(rng: RandomSource, scenario: Scenario) -> None:
    channel_id = rng.pick(CHANNELS)
    if scenario.world.migrate(channel_id, rng.below(len(scenario.world.hosts)), is_received=bool(rng.below(2))):
        scenario.listeners.channel_moved(channel_id)
        scenario.readers.end_readers_of_channels([channel_id])


def lose(rng: RandomSource, scenario: Scenario) -> None:
    """Lose a host. One of the other hosts gets its channels."""
    if not rng.one_in(3):
        return
    world = scenario.world
    host = rng.pick(world.up)
    successor = rng.pick([one for one in world.up if one != host] or [host])
    incarnations = [one.incarnation for one in world.definitions]
    lost = world.lose(host, successor)
    anew = [group for group, one in enumerate(world.definitions) if one.incarnation != incarnations[group]]
    scenario.listeners.channels_lost(host, lost, successor)
    scenario.readers.end_readers_of_channels(lost)
    for one in (scenario.listeners, scenario.readers):
        one.end_readers_of_groups(anew)


def bring_back(rng: RandomSource, scenario: Scenario) -> None:
    scenario.world.bring_back(rng.below(len(scenario.world.hosts)))


def deliver_stale_message(rng: RandomSource, scenario: Scenario) -> None:
    scenario.world.deliver_stale_message(rng.pick(CHANNELS))


def rest(rng: RandomSource, scenario: Scenario) -> None:
    """Do nothing. Hypothesis replaces steps by this one when it shortens a failing test."""


Happening = Callable[[RandomSource, Scenario], None]

STEPS: tuple[Happening, ...] = (
    rest, put, put, tick, read, put, deliver, take_events, subscribe, put, subscribe_cuts, exchange, match, put, begin,
    take_matches, advance, tick, change_member, deliver_stale_message, put, use_up, original, migrate, resume, exchange,
    lose, bring_back, put, read, give_up, take_events, deliver, resume_by_cursor,
)  # fmt: skip


def play(numbers: list[int]) -> None:
    """Run one scenario: hosts, channels and groups, then a step for each number."""
    first = RandomSource(numbers[0])
    definitions = [a_definition(first) for _ in range(first.pick((1, 2, 3)))]
    policies = [first.pick(POLICIES) for _ in CHANNELS]
    with (
        mock.patch.object(item_blocks, "BLOCK_ITEMS", first.pick((2, 1, 3, 1024))),
        mock.patch.object(pieces, "STEPS_PER_PIECE", first.pick((1, 2, 512))),
    ):
        world = World(policies, definitions, first.pick((1, 2, 2, 3)), FIRST_CLOCK)
        scenario = Scenario(world, Readers(world), Listeners(world))
        try:
            _play_steps(scenario, numbers[1:])
        except BaseException as error:
            error.add_note(f"{definitions} {policies}, {len(world.hosts)} hosts: " + ", ".join(scenario.steps))
            raise


def _play_steps(scenario: Scenario, numbers: list[int]) -> None:
    world, readers, listeners = scenario.world, scenario.readers, scenario.listeners
    for number in numbers:
        rng = RandomSource(number)
        step = rng.pick(STEPS)
        scenario.steps.append(step.__name__)
        step(rng, scenario)
        world.look()
        listeners.note()
        readers.poll_all()
    readers.deliver(10**6)
    listeners.take_events(10**6, lambda _: None)
    listeners.take_matches()
    world.agree()
    world.check()


@pytest.mark.timeout(0 if EXAMPLES > 5000 else 240)
@settings(max_examples=EXAMPLES, deadline=None, suppress_health_check=list(HealthCheck), database=None)
@given(st.lists(st.integers(0, 2**96), min_size=10, max_size=40))
def test_a_group_agrees_with_the_oracle_in_every_scenario(numbers: list[int]) -> None:
    play(numbers)
