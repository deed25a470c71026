"""An owner is lost, and a copy that lags becomes the owner: each reader gets every item once, and learns of each loss.

`STAMPEDE_PROPERTY_EXAMPLES` sets the number of scenarios.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from stampede_rt.errors import IncarnationLost
from stampede_rt.values.model import Policy
from stampede_rt.values.timeline import NEWEST, OLDEST, Bound, Interval
from stampede_rt_channel_host.core.channel import (
    ChannelCore,
    ChannelFeed,
    FedChannel,
    Losses,
    Offer,
    Position,
    Query,
    SavedCursor,
    run_to_end,
)
from stampede_rt_channel_host.core.dedup import RetryWindow
from stampede_rt_channel_host.core.records import next_incarnation
from tests.property.fed_copies import stored
from tests.property.random_source import RandomSource

EXAMPLES = int(os.environ.get("STAMPEDE_PROPERTY_EXAMPLES", "400"))
FIRST = 2**64 - 2  # the third incarnation is 1
POLICY = Policy(max_items=1000)
STEP = 1_000_000

SeenItem = tuple[int, int]
"""A seq, and the time at which the item was put. No two items have the same time."""


def lost(seq: int) -> SeenItem:
    """The note of a reader about a loss at this seq."""
    return seq, -1


@dataclass
class Reader:
    """A subscription that is often interrupted. `expected`: all that it must have got when it has caught up."""

    saved: SavedCursor
    expected: list[SeenItem]
    seen: list[SeenItem] = field(default_factory=list)

    def read(self, core: ChannelCore, clock: int, limit_bytes: int) -> bool:
        """Continue with the last cursor, take one part, and break again. Returns whether the part had anything."""
        cursor = run_to_end(core.subscribing_all(clock, saved=self.saved))
        part = core.since(cursor, clock, limit_bytes)
        for one in part.slices:
            times = one.slice.run.times[one.slice.lo : one.slice.hi]
            self.seen += zip(range(one.slice.first_seq, one.slice.end_seq), times, strict=True)
        if part.gap is not None:
            assert (part.gap.reason, part.gap.items) == ("LOST", 0)
            self.seen.append(lost(part.gap.first_seq))
        self.saved = cursor.saved(core.incarnation)
        return not part.is_empty


class Scenario:
    """An owner, a copy that is fed now and then, readers, and the items that the present owner has."""

    def __init__(self) -> None:
        self.clock = 10**18
        self.core = ChannelCore(POLICY, incarnation=FIRST, name="cam")
        self.window = RetryWindow()
        self.items: list[SeenItem] = []
        self.losses: list[tuple[int, int]] = []  # former incarnations, and the first seq that each lost
        self.readers: list[Reader] = []
        self._begin_copy()

    def _begin_copy(self) -> None:
        self.copy = FedChannel(POLICY, incarnation=self.core.incarnation, name="cam", knows_owner=True)
        self.copy.take_losses(self.core.losses)
        self.feed = ChannelFeed(self.core, None, self.clock, self.window, takes_puts=True)

    def put(self, count: int) -> None:
        times = [self.clock + at for at in range(count)]
        self.clock += STEP
        outcome = self.core.put(
            Offer(times=times, durations=None, lengths=[1] * count), self.clock, lambda seq, kept, stamp: bytes(count)
        )
        assert outcome.run is not None
        self.items += zip(range(outcome.run.first_seq, outcome.run.first_seq + count), times, strict=True)
        for one in self.readers:
            one.expected += self.items[-count:]

    def feed_copy(self, limit_bytes: int) -> None:
        part = self.feed.take(self.clock, limit_bytes)
        if part is not None:
            self.copy.apply(
                first_seq=part.first_seq, cleared=part.cleared, runs=[stored(one) for one in part.slices],
                next_seq=part.next_seq, collection=part.collection, advance=part.advance, now=self.clock,
                owner_part=part.owner_part,
            )  # fmt: skip

    def subscribe(self) -> None:
        cursor = run_to_end(self.core.subscribing_all(self.clock))
        self.readers.append(Reader(cursor.saved(self.core.incarnation), []))

    def take_over(self) -> None:
        """Lose the owner, and with it the items that the copy lacks."""
        former, there = self.core.incarnation, self.copy.next_seq
        self.clock += STEP
        self.core, self.window = self.copy.as_owner(self.clock, next_incarnation(former))
        self.items = [one for one in self.items if one[0] < there]
        self.losses = [(one, min(end, there)) for one, end in self.losses] + [(former, there)]
        for one in self.readers:
            self._expect_loss(one, there)
        self._begin_copy()

    def _expect_loss(self, reader: Reader, there: int) -> None:
        """Expect that the reader gets none of the lost items, and is told of their loss after all other items."""
        known = len(reader.seen)
        rest = [one for one in reader.expected[known:] if one[1] < 0 or one[0] < there]
        ends = [at for at, one in enumerate(rest) if one[1] < 0 and one[0] >= there]  # earlier losses at the same place
        rest = rest[: ends[0]] if ends else rest
        reader.expected = [*reader.seen, *rest, lost(there)]

    def check_positions(self) -> None:
        for incarnation, end in self.losses[-16:]:
            for seq in (end - 1, end):
                query = Query(interval=Interval(OLDEST, NEWEST), after=Position(0, seq, incarnation))
                if seq < end:
                    self.core.check_positions(query)
                else:
                    with pytest.raises(IncarnationLost):
                        self.core.check_positions(query)
                assert self.core.holds(incarnation, [seq]) == (seq < end)

    def step(self, rng: RandomSource) -> None:
        kind = rng.below(10)
        if kind < 3:
            self.put(1 + rng.below(4))
        elif kind < 6:
            self.feed_copy(rng.pick((0, 1, 200, 10**6)))
        elif kind == 6 and len(self.readers) < 4:
            self.subscribe()
        elif kind < 9 and self.readers:
            rng.pick(self.readers).read(self.core, self.clock, rng.pick((1, 200, 10**6)))
        elif kind == 9:
            self.take_over()
        self.check_positions()


@pytest.mark.timeout(0 if EXAMPLES > 5000 else 240)
@settings(max_examples=EXAMPLES, deadline=None, suppress_health_check=list(HealthCheck), database=None)
@given(st.lists(st.integers(0, 2**64), min_size=4, max_size=60))
def test_each_reader_gets_every_item_once_and_each_loss_at_its_position(numbers: list[int]) -> None:
    scenario = Scenario()
    for number in numbers:
        scenario.step(RandomSource(number))
    for reader in scenario.readers:
        while reader.read(scenario.core, scenario.clock, 10**6):
            pass
        assert reader.seen == reader.expected


def test_a_read_reports_the_loss_from_the_newest_inherited_item_on() -> None:
    scenario = Scenario()
    scenario.put(3)
    scenario.feed_copy(10**6)
    scenario.put(2)
    kept, began = scenario.items[2][1], scenario.clock
    scenario.take_over()
    answer = scenario.core.read(Query(interval=Interval(OLDEST, Bound(None, began))), scenario.clock)
    assert (answer.truncated, answer.reason) == (True, "LOST")
    answer = scenario.core.read(Query(interval=Interval(OLDEST, Bound(None, kept - 1))), scenario.clock)
    assert (answer.truncated, answer.reason) == (False, None)
    assert scenario.core.losses.inherited_next_seq == 4


def test_two_losses_at_one_position_are_reported_once() -> None:
    losses = Losses().after(1, 10, None, 100).after(2, 5, None, 200)
    assert [tuple(one) for one in losses.from_incarnation(1)] == [(1, 5), (2, 5)]
