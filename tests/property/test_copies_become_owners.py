"""A copy that was fed with all facts of its owner becomes the owner, and no client notices.

The scenario goes on at the new owner: its items, consumers, counts and answers to repeated runs agree with the oracle.
`STAMPEDE_PROPERTY_EXAMPLES` sets the number of scenarios.
"""

from __future__ import annotations

import os
import random
from collections.abc import Sequence
from dataclasses import dataclass, field
from unittest import mock

import pytest
from hypothesis import HealthCheck, currently_in_test_context, given, note, settings
from hypothesis import strategies as st

from stampede_rt.errors import InvalidArgument
from stampede_rt.values.model import Policy
from stampede_rt_channel_host.core.channel import (
    ABSENT,
    ChannelCore,
    FedChannel,
    FedItem,
    NewItem,
    Offer,
    Slice,
    item_blocks,
    owner_facts,
    pieces,
)
from stampede_rt_channel_host.core.dedup import RetryWindow
from stampede_rt_channel_host.core.run_outcome import RunOutcome, RunProgress
from tests.oracle import Item, OracleRetries, RefusedItem
from tests.oracle.runs import RunOutcome as OracleOutcome
from tests.property.channel_pair import ChannelPair
from tests.property.draws import an_offer
from tests.property.fed_copies import FedCopy, stored
from tests.property.random_source import RandomSource
from tests.property.test_channel_against_oracle import FIRST_CLOCK, SET_UPS, STEPS, consume

EXAMPLES = int(os.environ.get("STAMPEDE_PROPERTY_EXAMPLES", "600"))


@dataclass
class Producers:
    """Two producers that number their items, and sometimes repeat one of their last runs."""

    next_numbers: dict[int, int] = field(default_factory=lambda: {1: 1, 2: 1})
    runs: list[tuple[int, int, Offer]] = field(default_factory=list)

    def run(self, rng: RandomSource, pair: ChannelPair) -> tuple[int, int, Offer]:
        if self.runs and rng.one_in(2):
            return rng.pick(self.runs[-6:])
        producer_id, offer = 1 + rng.below(2), an_offer(rng, pair)
        number = self.next_numbers[producer_id]
        self.next_numbers[producer_id] += len(offer.lengths)
        self.runs.append((producer_id, number, offer))
        return self.runs[-1]


class Scenario:
    """A channel with its retry window, in the core and in the oracle, and two copies that may become the owner."""

    def __init__(self, policy: Policy) -> None:
        self.pair = ChannelPair(policy, FIRST_CLOCK)
        self.window, self.retries = RetryWindow(), OracleRetries()
        self.producers = Producers()
        self.copies = self._new_copies()
        self.moves = self.sent_ahead = 0

    def _new_copies(self) -> list[FedCopy]:
        return [FedCopy(self.pair, window=self.window), FedCopy(self.pair, window=self.window)]

    def step(self, rng: RandomSource) -> None:
        copy, kind = rng.pick(self.copies), rng.below(8)
        if kind == 0:
            copy.break_stream()
        elif kind == 1:
            copy.repeat()
        elif kind == 2:
            self.move(copy)
        elif kind <= 4:
            copy.catch_up()  # so that it may get an item ahead
            self.produce(rng)
        elif kind == 5:
            self.produce(rng)
        else:
            copy.take(rng.pick((0, 1, 150, 10**6)))

    def produce(self, rng: RandomSource) -> None:
        """Put a run or repeat one, through the retry window of the host and of the oracle."""
        producer_id, number, offer = self.producers.run(rng, self.pair)
        clock, items = self.pair.clock, len(offer.lengths)
        expected = self.retries.find(producer_id, number, items, clock)
        if isinstance(expected, RefusedItem):
            with pytest.raises(InvalidArgument):
                self.window.find(producer_id, number, items, clock)
            return
        known = self.window.find(producer_id, number, items, clock)
        assert (known is None) == (expected is None)
        judged = 0
        if known is not None and expected is not None:
            check_known(known, expected)
            judged = known.judged_items
        if judged < items:
            offer = offer if not judged else offer.rest(judged, clock)
            self._judge(producer_id, number, items, offer, known, [] if expected is None else [*expected.verdicts])

    def _judge(
        self, producer_id: int, number: int, items: int, offer: Offer, known: RunOutcome | None,
        verdicts: list[Item | RefusedItem],
    ) -> None:  # fmt: skip
        progress = RunProgress(items)
        if known is not None:
            progress.resume(known)
        ahead: list[tuple[FedCopy, FedItem]] = []

        def send_ahead(first_seq: int, kept: Sequence[int] | None, stamped_time: int | None) -> None:
            """Like `ReplicatedPuts`, but to the copies that lack nothing else."""
            if len(offer.lengths) < items or kept is not None or first_seq != self.pair.core.next_seq:
                return
            time = min(offer.times) if offer.times is not None else stamped_time
            assert time is not None
            duration = ABSENT if offer.durations is None or items > 1 else offer.durations[0]
            is_stamped = stamped_time is not None
            item = NewItem(
                first_seq, producer_id, number, time, duration, sum(offer.lengths), is_stamped, self.pair.clock,
                b"body", items=items,
            )  # fmt: skip
            ahead.extend((copy, found) for copy in self.copies if (found := copy.take_ahead(item)) is not None)

        outcome, more = self.pair.put(offer, send_ahead)
        offered, accepted = progress.judged_items, [at for at, one in enumerate(more) if isinstance(one, Item)]
        if outcome.run is not None:
            progress.accept(offered + accepted[0], outcome.run.first_seq, len(accepted), outcome.stamped_time)
        for one in outcome.rejections:
            progress.refuse(offered + one.index, one.error)
        progress.judged_items += len(more)
        if outcome.waiting is not None:
            self.pair.waiting.pop()  # the producer does not wait
        self.window.record(producer_id, number, progress.outcome(self.pair.clock))
        self.retries.record(producer_id, number, items, [*verdicts, *more], self.pair.clock)
        for copy, fed in ahead:
            assert outcome.run is not None
            copy.apply_item(fed, stored(Slice(outcome.run, 0, len(outcome.run))))
            self.sent_ahead += 1

    def move(self, copy: FedCopy) -> None:
        """Give the copy everything, and make it the owner."""
        clock = self.pair.clock
        self.pair.oracle.age(clock)
        self.pair.core.collect(clock)  # so that both have applied the present time
        copy.catch_up()
        while (
            copy.feed is not None and copy.feed.owner_facts is not None and not copy.feed.owner_facts.is_complete(clock)
        ):
            copy.take(10**6)
        former, window = self.pair.core, self.window
        for one in self.copies:
            one.break_stream()
        core, self.window = copy.channel.as_owner(clock)
        self.pair.move_to(core)
        if self.pair.oracle.consumers is not None:
            self.pair.oracle.consumers.move(clock)
        self.copies = [self._demoted(former, window), FedCopy(self.pair, window=self.window)]
        self.moves += 1

    def _demoted(self, former: ChannelCore, window: RetryWindow) -> FedCopy:
        """The former owner, as a copy. The new owner feeds it from the copy's place on."""
        copy = FedCopy(self.pair, window=self.window)
        copy.channel = FedChannel.of_owner(former, window, self.pair.clock)
        copy.take(0)
        assert not copy.begun_anew
        return copy


def check_known(known: RunOutcome, expected: OracleOutcome) -> None:
    """Check the former answer to a repeated run."""
    accepted = [(at, one.seq) for at, one in enumerate(expected.verdicts) if isinstance(one, Item)]
    refused = [(at, one.reason) for at, one in enumerate(expected.verdicts) if isinstance(one, RefusedItem)]
    assert known.judged_items == len(expected.verdicts)
    assert [(one.position, one.error.reason) for one in known.refusals] == refused
    seqs = [seq for part in known.parts for seq in range(part.first_seq, part.first_seq + part.items)]
    assert seqs == [seq for _, seq in accepted]


def play(numbers: list[int]) -> int:
    first = RandomSource(numbers[0])
    scenario = Scenario(first.pick(SET_UPS))
    counts = scenario.pair.oracle.consumers is not None
    with (
        mock.patch.object(item_blocks, "BLOCK_ITEMS", first.pick((2, 1, 3, 1024))),
        mock.patch.object(pieces, "STEPS_PER_PIECE", first.pick((1, 2, 512))),
        mock.patch.object(owner_facts, "RUNS_PER_PART", first.pick((1, 2, 1024))),
        mock.patch.object(owner_facts, "RANGES_PER_PART", first.pick((1, 2, 4096))),
        mock.patch.object(owner_facts, "ROUND_NANOS", first.pick((0, 5))),
    ):
        for number in numbers[1:]:
            rng = RandomSource(number)
            if rng.one_in(2):
                scenario.step(rng)
            else:
                step = consume if counts and rng.one_in(3) else rng.pick(STEPS)
                if currently_in_test_context():
                    note(step.__name__)
                step(rng, scenario.pair)
            scenario.pair.poll_all()
            scenario.pair.check()
        scenario.pair.deliver(10**6)
        scenario.pair.check()
    return scenario.moves


@pytest.mark.timeout(0 if EXAMPLES > 5000 else 240)
@settings(max_examples=EXAMPLES, deadline=None, suppress_health_check=list(HealthCheck), database=None)
@given(st.lists(st.integers(0, 2**96), min_size=8, max_size=40))
def test_a_copy_that_becomes_the_owner_answers_as_the_old_owner_would(
    numbers: list[int],
) -> None:
    play(numbers)


@pytest.mark.parametrize("seed", range(4))
def test_long_random_scenarios_agree_too(seed: int) -> None:
    """Hypothesis prefers small numbers, and so has few rounds of facts that take several parts and some time."""
    source = random.Random(seed)
    for _ in range(max(1, EXAMPLES // 6)):
        play([source.getrandbits(96) for _ in range(40)])
