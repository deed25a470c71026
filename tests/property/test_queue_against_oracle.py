"""After any random steps, a queue of the core and the oracle's queue agree.

`STAMPEDE_PROPERTY_EXAMPLES=1000000 pytest tests/property/test_queue_against_oracle.py` tries more steps.
"""

from __future__ import annotations

import os
from unittest.mock import patch

import pytest
from hypothesis import HealthCheck, given, note, settings
from hypothesis import strategies as st

from stampede_rt_channel_host.core.queue import queue_snapshot
from tests.oracle.queue import Setup
from tests.property.queue_pair import QueuePair, Verdict
from tests.property.random_source import RandomSource

EXAMPLES = int(os.environ.get("STAMPEDE_PROPERTY_EXAMPLES", "1000"))
FIRST_CLOCK = 100
TEN_MINUTES = 600 * 10**9

SETUPS = (
    Setup(max_items=3),
    Setup(),
    Setup(max_items=4, copies=2),
    Setup(max_items=3, on_full="drop_oldest"),
    Setup(max_bytes=300, on_full="reject", max_deliveries=2),
    Setup(max_items=4, max_deliveries=2, dead_letters=True),
    Setup(copies=2, max_items=5, on_full="drop_oldest", max_deliveries=3),
    Setup(copies=3),
    Setup(copies=2, max_deliveries=2, dead_letters=True, max_item_bytes=50),
    Setup(max_bytes=400, lease=7),
    Setup(max_deliveries=1, dead_letters=True),
)


def enqueue(rng: RandomSource, pair: QueuePair) -> None:
    lengths = [rng.pick((8, 0, 40, 100, 400)) for _ in range(rng.pick((1, 2, 1, 3, 6)))]
    wait = rng.pick((None, 0, 5, 20, None))
    if rng.one_in(3) and pair.runs:  # a repeated run, or one with nearly the same numbers
        before = rng.pick(pair.runs)
        number = before.first_number + rng.pick((0, 0, 0, 1))
        pair.enqueue(list(before.lengths), before.producer_id, number, wait, before.message_id)
    else:
        message_id = rng.pick(("", "one", "", "two")) if len(lengths) == 1 else ""
        pair.enqueue(lengths, rng.pick((0, 5, 6)), 1 + 10 * len(pair.runs), wait, message_id)


def attach(rng: RandomSource, pair: QueuePair) -> None:
    if len(pair.takers) < 4:
        pair.attach(1 + rng.below(3), rng.pick((None, 5, 50)))
        pair.grant(len(pair.takers) - 1, rng.pick((1, 2, 10)))


def grant(rng: RandomSource, pair: QueuePair) -> None:
    pair.grant(rng.below(4), rng.pick((1, 3, 10, 0)))


def sent(rng: RandomSource, pair: QueuePair) -> None:
    pair.sent(rng.below(4), begun=rng.one_in(4))


def leave(rng: RandomSource, pair: QueuePair) -> None:
    pair.leave(rng.below(4), drain=rng.one_in(3))


def settle(rng: RandomSource, pair: QueuePair) -> None:
    if pair.deliveries:
        taker_id, _ = latest(rng, pair)
        pair.settle(
            4 if rng.one_in(12) else taker_id, [a_verdict(rng, pair, taker_id) for _ in range(rng.pick((1, 2, 4)))]
        )


def latest(rng: RandomSource, pair: QueuePair) -> tuple[int, int]:
    """Pick a delivery, usually one of the newest."""
    return pair.deliveries[-1 - rng.below(min(len(pair.deliveries), rng.pick((2, 5, 50))))]


def a_verdict(rng: RandomSource, pair: QueuePair, taker_id: int) -> Verdict:
    own = [delivery_id for owner, delivery_id in pair.deliveries if owner == taker_id]
    delivery_id = own[-1 - rng.below(min(len(own), 4))] if not rng.one_in(8) else latest(rng, pair)[1]
    kind = rng.pick(("ack", "nack", "ack", "extend", "uncounted", "term"))
    return kind, delivery_id, rng.pick((0, 3, 20)) if kind in ("nack", "uncounted") else rng.pick((10, 1, 100))


def tick(rng: RandomSource, pair: QueuePair) -> None:
    pair.tick(rng.pick((1, 3, 0, 8, 30, 1000, TEN_MINUTES)))


def withdraw(rng: RandomSource, pair: QueuePair) -> None:
    pair.withdraw(rng.below(3))


def dead_letter_moved(rng: RandomSource, pair: QueuePair) -> None:
    pair.dead_letter_moved(rng.below(2), failed=rng.one_in(3))


def configure(rng: RandomSource, pair: QueuePair) -> None:
    pair.configure(rng.pick(SETUPS))


def copy(rng: RandomSource, pair: QueuePair) -> None:
    pair.copy()


def hand_over(rng: RandomSource, pair: QueuePair) -> None:
    pair.hand_over()


def rest(rng: RandomSource, pair: QueuePair) -> None:
    """Do nothing. Hypothesis replaces steps by this one when it shortens a failing test."""


STEPS_OF_ONE_OWNER = (
    rest, enqueue, attach, sent, settle, enqueue, tick, grant, settle, sent, leave, withdraw, dead_letter_moved,
    configure, enqueue, settle, attach, sent,
)  # fmt: skip
STEPS = (*STEPS_OF_ONE_OWNER, hand_over)
STEPS_WITH_COPIES = (*STEPS, copy, copy)


def play(numbers: list[int]) -> None:
    """Run one scenario: the limits, then a step for each number."""
    pair = QueuePair(RandomSource(numbers[0]).pick(SETUPS), FIRST_CLOCK)
    for number in numbers[1:]:
        rng = RandomSource(number)
        step = rng.pick(STEPS_WITH_COPIES)
        note(step.__name__)
        with patch.object(queue_snapshot, "MESSAGES_PER_PIECE", 2):
            step(rng, pair)


@pytest.mark.timeout(0 if EXAMPLES > 5000 else 240)
@settings(max_examples=EXAMPLES, deadline=None, suppress_health_check=list(HealthCheck), database=None)
@given(st.lists(st.integers(0, 2**96), min_size=10, max_size=40))
def test_a_queue_agrees_with_the_oracle_in_every_scenario(numbers: list[int]) -> None:
    play(numbers)


@pytest.mark.parametrize("first_number", [30, 31, 32, 33, 34])
def test_a_run_that_overlaps_a_waiting_run_agrees_with_the_oracle(first_number: int) -> None:
    pair = QueuePair(Setup(max_items=4), FIRST_CLOCK)
    pair.enqueue([8, 8, 8], 0, 0, None, "")
    pair.enqueue([8, 8, 8], 6, 31, None, "")
    pair.enqueue([8, 8, 8], 6, first_number, None, "")
    pair.configure(Setup(max_items=20))
    assert not pair.waiting
