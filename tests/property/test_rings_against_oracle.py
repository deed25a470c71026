"""After any random steps, a channel's ring in shared memory gives the oracle's answers, or none."""

from __future__ import annotations

import os
import random
from collections import Counter
from unittest import mock

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from stampede_rt.ring import facts
from tests.property.draws import a_query_near_the_newest, an_offer_in_order
from tests.property.random_source import RandomSource
from tests.property.ring_pair import SIZES, RingPair
from tests.property.test_channel_against_oracle import (
    FIRST_CLOCK,
    SET_UPS,
    advance,
    collect,
    configure,
    deliver,
    give_up,
    put,
    read,
    rest,
    retry_put,
    subscribe,
    tick,
)

EXAMPLES = int(os.environ.get("STAMPEDE_PROPERTY_EXAMPLES", "500"))
SUITED = tuple(one for one in SET_UPS if not (one.consumers or one.max_age_unconsumed_nanos))


def put_in_order(rng: RandomSource, pair: RingPair) -> None:
    pair.put(an_offer_in_order(rng, pair))
    pair.tick(rng.pick((0, 1, 2, 3)))


def read_near_the_newest(rng: RandomSource, pair: RingPair) -> None:
    query = a_query_near_the_newest(rng, pair)
    if query is not None:
        pair.read(query)


STEPS = (
    rest, put, put_in_order, put_in_order, put_in_order, put_in_order, read, read_near_the_newest, read_near_the_newest,
    read, tick, subscribe, deliver, deliver, advance, configure, retry_put, give_up, collect, put_in_order,
    read_near_the_newest,
)  # fmt: skip


def play(numbers: list[int]) -> RingPair:
    """Run one scenario: a policy, then a step for each number."""
    first = RandomSource(numbers[0])
    policy, lost_before = first.pick(SUITED), FIRST_CLOCK if first.one_in(5) else None
    pair = RingPair(policy, FIRST_CLOCK, lost_before, size=first.pick(SIZES))
    with mock.patch.object(facts, "AGE_MARGIN_NANOS", 0):
        for number in numbers[1:]:
            rng = RandomSource(number)
            rng.pick(STEPS)(rng, pair)
        pair.deliver(10**6)
    return pair


@pytest.mark.timeout(0 if EXAMPLES > 5000 else 240)
@settings(max_examples=EXAMPLES, deadline=None, suppress_health_check=list(HealthCheck), database=None)
@given(st.lists(st.integers(0, 2**96), min_size=8, max_size=40))
def test_a_ring_answers_as_the_oracle_in_every_scenario(numbers: list[int]) -> None:
    play(numbers)


def test_a_ring_answers_a_large_share_of_the_reads() -> None:
    answered: Counter[str] = Counter()
    for seed in range(60):
        source = random.Random(seed)
        answered.update(play([source.getrandbits(96) for _ in range(40)]).answered)
    assert min(answered.values()) >= 30, answered
