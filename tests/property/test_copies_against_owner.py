"""A copy that is fed with any breaks, repetitions and reconnections equals its owner up to its lag.

The owner is the core of the channel's scenarios, which the oracle checks step by step. `STAMPEDE_PROPERTY_EXAMPLES`
sets the number of scenarios.
"""

from __future__ import annotations

import os
from unittest import mock

import pytest
from hypothesis import HealthCheck, given, note, settings
from hypothesis import strategies as st

from stampede_rt.values.model import Policy
from stampede_rt_channel_host.core.channel import Offer, SavedCursor, item_blocks, pieces
from tests.property.channel_pair import INCARNATION, ChannelPair, facts
from tests.property.fed_copies import FedCopy, MovingSubscription, check_refusal, held_by
from tests.property.random_source import RandomSource
from tests.property.test_channel_against_oracle import FIRST_CLOCK, SET_UPS, STEPS, a_query, consume

EXAMPLES = int(os.environ.get("STAMPEDE_PROPERTY_EXAMPLES", "500"))


class Scenario:
    """A channel in the core and in the oracle, two copies of the owner, and a copy of the first copy."""

    def __init__(self, policy: Policy, lost_before: int | None = None) -> None:
        self.pair = ChannelPair(policy, FIRST_CLOCK, lost_before)
        near = FedCopy(self.pair)
        self.copies = [near, FedCopy(self.pair), FedCopy(self.pair, near)]
        self.reader = MovingSubscription(SavedCursor(incarnation=INCARNATION, next_seq=1))

    def step(self, rng: RandomSource) -> None:
        copy, limit_bytes = rng.pick(self.copies), rng.pick((0, 1, 150, 10**6))
        kind = rng.below(6)
        if kind == 0:
            copy.break_stream()
        elif kind == 1:
            copy.repeat()
        elif kind == 2:
            channel = rng.pick((self.pair.core, *(one.channel for one in self.copies)))
            self.reader.visit(channel, self.pair.clock, rng.pick((1, 150, 10**6)))
        elif kind == 3:
            copy.check_equal(a_query(rng, self.pair))
        else:
            copy.take(limit_bytes)

    def end(self, rng: RandomSource) -> None:
        for copy in self.copies:
            copy.check_equal(a_query(rng, self.pair))
            assert copy.channel.next_seq == self.pair.core.next_seq


def play(numbers: list[int]) -> None:
    first = RandomSource(numbers[0])
    scenario = Scenario(first.pick(SET_UPS), FIRST_CLOCK if first.one_in(5) else None)
    counts = scenario.pair.oracle.consumers is not None
    with (
        mock.patch.object(item_blocks, "BLOCK_ITEMS", first.pick((2, 1, 3, 1024))),
        mock.patch.object(pieces, "STEPS_PER_PIECE", first.pick((1, 2, 512))),
    ):
        for number in numbers[1:]:
            rng = RandomSource(number)
            if rng.one_in(2):
                scenario.step(rng)
                continue
            step = consume if counts and rng.one_in(3) else rng.pick(STEPS)
            note(step.__name__)
            step(rng, scenario.pair)
        scenario.end(RandomSource(numbers[0]))


@pytest.mark.timeout(0 if EXAMPLES > 5000 else 240)
@settings(max_examples=EXAMPLES, deadline=None, suppress_health_check=list(HealthCheck), database=None)
@given(st.lists(st.integers(0, 2**96), min_size=8, max_size=40))
def test_a_copy_equals_its_owner_up_to_its_lag_in_every_scenario(numbers: list[int]) -> None:
    play(numbers)


def _timed(*times: int) -> Offer:
    return Offer(times=times, durations=None, lengths=[8] * len(times))


def test_a_copy_that_lacks_only_the_last_run_gets_a_message_with_only_this_run() -> None:
    scenario = Scenario(Policy(max_items=4, max_future_nanos=8))
    copy, pair = scenario.copies[0], scenario.pair
    got_single_run = []
    for times in ((100,), (101,), (101, 103), (102,), (103,), (107, 106), (106,)):
        pair.put(_timed(*times))
        before, copy.takes = copy.single_runs, 0
        copy.catch_up()
        got_single_run.append(copy.single_runs > before)
        assert held_by(copy.channel, FIRST_CLOCK) == held_by(pair.core, FIRST_CLOCK)
    # A copy gets its first state, the first collection, and a run with descending times in another form.
    assert got_single_run == [False, True, True, False, True, False, True]


def test_a_copy_gets_the_duration_of_an_item_whose_run_lost_its_other_items() -> None:
    scenario = Scenario(Policy(max_bytes=1000, max_future_nanos=8))
    copy, pair = scenario.copies[0], scenario.pair
    pair.put(_timed(100))
    copy.catch_up()
    pair.put(Offer(times=(101, 102), durations=(3, 3), lengths=[8, 2000]))
    copy.takes = 0
    copy.catch_up()
    assert copy.single_runs == 1
    assert facts(held_by(copy.channel, FIRST_CLOCK)) == facts(held_by(pair.core, FIRST_CLOCK))


def test_a_copy_counts_the_items_that_left_before_it_could_get_them_as_missed() -> None:
    scenario = Scenario(Policy(max_items=2, max_future_nanos=8))
    copy = scenario.copies[0]
    scenario.pair.put(_timed(100))
    copy.catch_up()
    scenario.pair.put(_timed(101, 102, 103, 104))
    copy.catch_up()
    assert [item.seq for item in held_by(copy.channel, FIRST_CLOCK)] == [4, 5]
    assert (copy.channel.missed, copy.channel.next_seq) == (2, 6)


def test_a_copy_continues_after_a_late_item_before_consumed_items() -> None:
    """The floor then moves back. If the feed did not say this, the copy would keep items that the owner has freed."""
    scenario = Scenario(Policy(consumers=1, max_future_nanos=8))
    copy, pair = scenario.copies[0], scenario.pair
    pair.put(_timed(100, 101, 102))
    copy.catch_up()
    pair.consume(1, [1, 2], 10**6)
    pair.put(_timed(99))
    copy.catch_up()
    assert [item.seq for item in held_by(copy.channel, FIRST_CLOCK)] == [4, 3]
    assert copy.begun_anew == 0


def test_a_copy_begins_anew_if_the_cut_floor_went_back_while_its_stream_was_broken() -> None:
    scenario = Scenario(Policy(consumers=1, max_future_nanos=8))
    copy, pair = scenario.copies[0], scenario.pair
    pair.put(_timed(100, 101, 102))
    copy.catch_up()
    copy.break_stream()
    pair.consume(1, [1, 2], 10**6)
    pair.put(_timed(99))
    copy.catch_up()
    assert [item.seq for item in held_by(copy.channel, FIRST_CLOCK)] == [4, 3]
    assert copy.begun_anew == 1


def test_a_copy_refuses_to_feed_a_copy_that_has_more_items() -> None:
    scenario = Scenario(Policy(max_items=4, max_future_nanos=8))
    near, other = scenario.copies[:2]
    scenario.pair.put(_timed(100, 101))
    other.catch_up()
    check_refusal(near.channel, other.channel, FIRST_CLOCK)
