"""Readers of a channel with replicas see the states of the channel in order, each state as soon as it is replicated."""

from __future__ import annotations

import os
from unittest import mock

import pytest
from hypothesis import HealthCheck, given, note, settings
from hypothesis import strategies as st

from stampede_rt.values.model import Policy
from stampede_rt_channel_host.core.channel import Offer, ReplicatedView, item_blocks, pieces, run_to_end
from tests.oracle import Item
from tests.property.channel_pair import ChannelPair, facts
from tests.property.fed_copies import held_by
from tests.property.random_source import RandomSource
from tests.property.test_channel_against_oracle import FIRST_CLOCK, SET_UPS, STEPS, consume

EXAMPLES = int(os.environ.get("STAMPEDE_PROPERTY_EXAMPLES", "500"))


class Scenario:
    """A channel, the state that its readers see, and the states that they must still see."""

    def __init__(self, policy: Policy) -> None:
        self.pair = ChannelPair(policy, FIRST_CLOCK)
        self.shown: list[tuple[int, int, int | None, int]] = []
        self.states: list[tuple[int, list[Item]]] = []
        self.view: ReplicatedView | None = None

    def begin(self) -> None:
        """Begin the view. The channel may have items already, like a replica that becomes the owner."""
        self.view = ReplicatedView(self.pair.core, self.pair.clock, lambda body, lo, hi: body)
        run_to_end(self.view.filling(self.pair.clock))
        self.shown = facts(held_by(self.pair.core, self.pair.clock))
        assert facts(held_by(self.view.shown, self.pair.clock)) == self.shown

    def note(self) -> None:
        assert self.view is not None
        self.view.stage(self.pair.clock)
        self.states.append((self.pair.core.next_seq, held_by(self.pair.core, self.pair.clock)))

    def show(self, rng: RandomSource) -> None:
        assert self.view is not None
        replicated = rng.pick(self.states)[0] if self.states else self.pair.core.next_seq
        self.view.show(replicated, self.pair.clock)
        while self.states and self.states[0][0] <= replicated:
            self.shown = facts(self.states.pop(0)[1])
        assert facts(held_by(self.view.shown, self.pair.clock)) == self.shown


def play(numbers: list[int]) -> None:
    first = RandomSource(numbers[0])
    scenario = Scenario(first.pick(SET_UPS))
    counts, begins = scenario.pair.oracle.consumers is not None, first.below(len(numbers))
    with (
        mock.patch.object(item_blocks, "BLOCK_ITEMS", first.pick((2, 1, 3, 1024))),
        mock.patch.object(pieces, "STEPS_PER_PIECE", first.pick((1, 2, 512))),
    ):
        for at, number in enumerate(numbers[1:]):
            rng = RandomSource(number)
            if at == begins:
                scenario.begin()
            step = consume if counts and rng.one_in(3) else rng.pick(STEPS)
            note(step.__name__)
            step(rng, scenario.pair)
            if scenario.view is not None:
                scenario.note()
                if rng.one_in(2):
                    scenario.show(rng)


@pytest.mark.timeout(0 if EXAMPLES > 5000 else 240)
@settings(max_examples=EXAMPLES, deadline=None, suppress_health_check=list(HealthCheck), database=None)
@given(st.lists(st.integers(0, 2**96), min_size=8, max_size=40))
def test_readers_see_the_states_of_the_channel_in_order_and_none_that_is_not_replicated(numbers: list[int]) -> None:
    play(numbers)


def test_a_channel_of_one_item_shows_the_last_replicated_item_until_the_next_one_is_replicated() -> None:
    pair = ChannelPair(Policy(max_items=1, max_future_nanos=8), FIRST_CLOCK)
    view = ReplicatedView(pair.core, FIRST_CLOCK, lambda body, lo, hi: body)
    for at in range(3):
        pair.put(Offer(times=(100 + at,), durations=None, lengths=[8]))
        view.stage(FIRST_CLOCK)
    assert view.show(3, FIRST_CLOCK)
    assert [item.seq for item in held_by(view.shown, FIRST_CLOCK)] == [2]
    assert view.shown.next_seq == 3
