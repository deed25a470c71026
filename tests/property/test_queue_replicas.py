"""A copy of a queue repeats the owner's steps, and equals the owner after each. It can continue as the next owner.

The scenarios are the same as in `test_queue_against_oracle`. Copies begin at any moment, from snapshots that are taken
in pieces while the queue changes. They get steps in parts, get them twice, and begin anew. The owner sends some puts to
the copies that have all steps, before it stores them. A copy that has all steps takes the queue over, and the oracle
checks the rest of the scenario.
"""

from __future__ import annotations

import os
from collections.abc import Collection, Iterable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import HealthCheck, given, note, settings
from hypothesis import strategies as st

from stampede_rt.errors import InvalidArgument
from stampede_rt.v1 import migration_service_pb2 as pb
from stampede_rt_channel_host.copies.queues.queue_messages import parts_of
from stampede_rt_channel_host.copies.queues.queue_puts import encode_put, read_put
from stampede_rt_channel_host.copies.queues.queue_steps import ArrivingParts, WholeQueue, step_parts, whole_parts
from stampede_rt_channel_host.core.channel import Pieces, UnfinishedWork, first_of
from stampede_rt_channel_host.core.channel.pieces import run_to_end
from stampede_rt_channel_host.core.dedup import KEPT_NANOS
from stampede_rt_channel_host.core.queue import (
    AheadPut,
    Enqueue,
    QueueCore,
    QueueJournal,
    QueueStep,
    TakerState,
    changes,
    queue_snapshot,
)
from stampede_rt_channel_host.core.queue.queue_snapshot import QueueSnapshot
from stampede_rt_channel_host.queues.replicated_queue import ReplicatedQueue
from tests.oracle.queue import Setup
from tests.property import test_queue_against_oracle as scenarios
from tests.property.queue_pair import QueuePair, limits_of
from tests.property.random_source import RandomSource

EXAMPLES = int(os.environ.get("STAMPEDE_PROPERTY_EXAMPLES", "500"))


def contents(core: QueueCore, clock: int) -> list[bytes]:
    """Everything that the queue holds and knows at `clock`, without a call that changes it."""
    state = queue_snapshot.export(core._queue_items, core._queue_leases, core._enqueue_line, clock)
    messages = [*sorted(state.items, key=lambda one: one.seq)]
    acknowledged = [*sorted(state.acknowledged)]
    state = replace(state, items=messages, acknowledged=acknowledged)
    return [part.SerializeToString(deterministic=True) for part in parts_of(state)]


def sent(parts: Iterable[pb.FedQueuePart]) -> list[pb.FedQueuePart]:
    return [pb.FedQueuePart.FromString(part.SerializeToString()) for part in parts]


class Copy:
    """A copy at another host, whose clock shows the same time."""

    def __init__(self, pair: ReplicatedPair, snapshot: QueueSnapshot) -> None:
        self.arriving = ArrivingParts()
        self.arriving.begin_anew()
        (whole,) = self.arriving.add(sent(whole_parts(snapshot, snapshot.next_step)))
        assert isinstance(whole, WholeQueue)
        self.core = QueueCore.restored(limits_of(pair.oracle.setup), whole.state(), pair.clock, incarnation=7)
        self.journal = self.core.journal(whole.next_step)
        assert whole.next_step == pair.journal.next_step
        assert contents(self.core, pair.clock) == contents(pair.core, pair.clock)
        run_to_end(snapshot.freeing())

    def take(self, step: QueueStep, clock: int) -> None:
        for arrived in self.arriving.add(sent(step_parts(step, clock))):
            assert not isinstance(arrived, WholeQueue)
            self.journal.apply(arrived[0], clock - arrived[1])

    def take_put(self, put: AheadPut, clock: int) -> None:
        found = read_put(encode_put(put))
        assert self.journal.surely_takes_put(found)
        self.journal.apply(self.journal.step_of(found), clock)


class OwnersQueue(ReplicatedQueue):
    """The queue at its owner, for one put."""

    def __init__(self, pair: ReplicatedPair) -> None:
        replication: Any = SimpleNamespace(journal=pair.journal, send_ahead=pair.send_ahead)
        self.queue, self.replication, self._now = pair.core, replication, lambda: pair.clock

    def follow_up(self) -> None:
        raise AssertionError("a put needs none")

    def takers(self) -> Collection[TakerState]:
        raise AssertionError("a put needs none")


class ReplicatedPair(QueuePair):
    """A queue with copies. `seen`: the queue's contents after each step, with the clock of that step. `ahead`: the puts
    that have been sent to copies, but are not in a step yet.
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        self.journal: QueueJournal = self.core.journal()
        self.copies: list[Copy] = []
        self.begun: list[Pieces[QueueSnapshot]] = []
        self.seen: dict[int, tuple[int, list[bytes]]] = {}
        self.ahead: list[AheadPut] = []

    def put(self, run: Enqueue) -> None:
        try:
            OwnersQueue(self).put(run)
        finally:
            self._note()

    def send_ahead(self, put: AheadPut) -> None:
        self.ahead.append(put)
        for copy in self.copies:
            if copy.journal.next_step == put.number:
                copy.take_put(put, self.clock)

    def check(self) -> None:
        super().check()
        self._note()

    def _note(self) -> None:
        next_step, ahead = self.journal.next_step, self.ahead
        self._note_step()
        self.ahead = []
        for put in ahead:
            assert put.number == next_step
            assert self.journal.has_made(put)
            for copy in self.copies:
                if copy.journal.next_step == self.journal.next_step:
                    assert contents(copy.core, self.clock) == self.seen[copy.journal.next_step][1]

    def _note_step(self) -> None:
        if self.journal.note(self.clock, self.ahead[-1] if self.ahead else None):
            self.seen[self.journal.next_step] = self.clock, contents(self.core, self.clock)

    def feed(self, copy: Copy, back: int, bytes_max: int) -> None:
        """Send some steps to the copy. It may have some of them already."""
        steps = self.journal.steps_from(max(self._oldest(), copy.journal.next_step - back), bytes_max)
        assert steps is not None
        for step in steps:
            is_new = step.number == copy.journal.next_step
            before = contents(copy.core, self.clock)
            copy.take(step, self.clock)
            if is_new:
                clock, expected = self.seen[copy.journal.next_step]
                assert contents(copy.core, clock) == expected
            else:  # the whole queue came after the step, and may lack producers that were forgotten since the step
                assert contents(copy.core, self.clock) == before

    def begin_copy(self) -> None:
        self.begun.append(self.journal.snapshot(self._noted, 10**6))

    def take_piece(self, at: int) -> None:
        """Take a piece of a snapshot for a new copy. The copy begins with the last piece."""
        taken = first_of(self.begun.pop(at))
        if isinstance(taken, UnfinishedWork):
            self.begun.append(taken.rest)
        else:
            self.copies.append(Copy(self, taken))

    def _noted(self) -> int:
        self._note()
        return self.clock

    def _oldest(self) -> int:
        return self.journal.next_step - len(self.journal._steps)

    def hand_over(self) -> None:
        """Send all steps to a copy, and then make it the owner. The former owner sends it nothing more."""
        while self.takers:
            self.leave(0, drain=False)
        while self.waiting:
            self.withdraw(0)
        self.begun.clear()
        while not self.copies:
            self.begun = self.begun or [self.journal.snapshot(self._noted, 10**6)]
            self.take_piece(0)
        copy = self.copies.pop()
        self.feed(copy, 0, 10**9)
        assert copy.journal.next_step == self.journal.next_step
        self.core, self.journal = copy.core, copy.journal
        self.core.configure(limits_of(self.oracle.setup), self.clock)
        self.copies = [one for one in self.copies if one.journal.next_step >= self._oldest()]
        self.check()


def begin(rng: RandomSource, pair: ReplicatedPair) -> None:
    if len(pair.copies) + len(pair.begun) < 3:
        pair.begin_copy()


def take_piece(rng: RandomSource, pair: ReplicatedPair) -> None:
    if pair.begun:
        pair.take_piece(rng.below(len(pair.begun)))


def feed(rng: RandomSource, pair: ReplicatedPair) -> None:
    if pair.copies:
        pair.feed(rng.pick(pair.copies), rng.pick((0, 0, 1, 3)), rng.pick((1, 1000, 10**6)))


def lose(rng: RandomSource, pair: ReplicatedPair) -> None:
    if pair.copies:
        pair.copies.pop(rng.below(len(pair.copies)))


LARGE_SETUPS = (
    Setup(), Setup(copies=3), Setup(lease=7), Setup(max_deliveries=2, dead_letters=True), Setup(copies=2, lease=7),
)  # fmt: skip
STEPS = (*scenarios.STEPS, begin, *[take_piece] * 6, *[feed] * 4, lose, scenarios.hand_over)


@pytest.mark.timeout(0 if EXAMPLES > 5000 else 240)
@settings(max_examples=EXAMPLES, deadline=None, suppress_health_check=list(HealthCheck), database=None)
@given(st.lists(st.integers(0, 2**96), min_size=10, max_size=50))
def test_a_copy_of_a_queue_equals_its_owner_after_each_step_and_can_replace_it(numbers: list[int]) -> None:
    first = RandomSource(numbers[0])
    pair = ReplicatedPair(first.pick(scenarios.SETUPS), scenarios.FIRST_CLOCK)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(changes, "WHOLE_LEASES_MAX", first.pick((0, 0, 1, changes.WHOLE_LEASES_MAX)))
        patch.setattr(queue_snapshot, "MESSAGES_PER_PIECE", first.pick((1, 1, 2, 3)))
        for number in numbers[1:]:
            rng = RandomSource(number)
            step = rng.pick(STEPS)
            note(step.__name__)
            step(rng, pair)
            if rng.below(40) == 0:  # as if a replica of an earlier release came
                pair.journal.takes_changes = False


@pytest.mark.timeout(0 if EXAMPLES > 5000 else 240)
@settings(max_examples=EXAMPLES // 2, deadline=None, suppress_health_check=list(HealthCheck), database=None)
@given(st.lists(st.integers(0, 2**96), min_size=30, max_size=60))
def test_a_snapshot_shows_a_queue_with_many_leases_as_it_is_after_the_last_piece(numbers: list[int]) -> None:
    pair = ReplicatedPair(RandomSource(numbers[0]).pick(LARGE_SETUPS), scenarios.FIRST_CLOCK)
    pair.enqueue([8] * 20, 5, 1, None, "")
    for position in range(2):
        pair.attach(1 + position, 50)
        pair.grant(position, 9)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(queue_snapshot, "MESSAGES_PER_PIECE", 1)
        for number in numbers[1:]:
            if not pair.begun:
                pair.copies.clear()
                pair.begin_copy()
            rng = RandomSource(number)
            rng.pick(scenarios.STEPS_OF_ONE_OWNER)(rng, pair)
            pair.take_piece(0)


def test_a_copy_begins_after_the_owner_forgot_a_producer_and_gets_an_old_step() -> None:
    pair = ReplicatedPair(scenarios.SETUPS[1], scenarios.FIRST_CLOCK)
    pair.enqueue([8], 5, 1, None, "")
    pair.tick(2 * KEPT_NANOS)
    pair.begin_copy()
    pair.take_piece(0)
    pair.feed(pair.copies[0], 1, 10**6)


def test_a_put_goes_to_a_copy_before_the_owner_stores_it() -> None:
    pair = ReplicatedPair(scenarios.SETUPS[1], scenarios.FIRST_CLOCK)
    for _ in range(2):
        pair.begin_copy()
        pair.take_piece(0)
    pair.enqueue([8, 8], 5, 1, None, "")
    assert [copy.journal.next_step for copy in pair.copies] == [1, 1]
    pair.feed(pair.copies[0], 0, 10**6)
    pair.enqueue([8], 5, 3, None, "")
    assert [copy.journal.next_step for copy in pair.copies] == [3, 1]
    pair.attach(1, None)
    pair.grant(0, 10)
    pair.feed(pair.copies[0], 0, 10**6)
    pair.sent(0, begun=False)
    pair.enqueue([8], 5, 4, None, "")
    assert [copy.journal.next_step for copy in pair.copies] == [4, 1], "a taker gets the message in the same step"


def test_a_copy_refuses_a_step_after_a_missing_one() -> None:
    pair = ReplicatedPair(scenarios.SETUPS[1], scenarios.FIRST_CLOCK)
    pair.begin_copy()
    pair.take_piece(0)
    (copy,) = pair.copies
    pair.copies.clear()
    pair.enqueue([8], 5, 1, None, "")
    pair.enqueue([8], 5, 2, None, "")
    steps = pair.journal.steps_from(2, 10**9)
    assert steps is not None
    with pytest.raises(InvalidArgument):
        copy.journal.apply(steps[0], pair.clock)


def test_the_journal_drops_its_oldest_steps_above_its_limit() -> None:
    pair = ReplicatedPair(scenarios.SETUPS[1], scenarios.FIRST_CLOCK)
    pair.journal.bytes_max = 3000
    for number in range(1, 20):
        pair.enqueue([8], 5, number, None, "")
    assert pair.journal.size_bytes <= 3000
    assert pair.journal.steps_from(1, 10**9) is None
    assert pair.journal.steps_from(pair.journal.next_step, 1) == []
