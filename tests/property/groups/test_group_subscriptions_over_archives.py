"""A subscription through a group brings the same items from a recorded channel as from a channel with all items in
memory.
"""

from __future__ import annotations

import os
import random
from collections import Counter
from dataclasses import replace

import pytest

from stampede_rt.values.model import Policy
from stampede_rt.values.timeline import Bound
from stampede_rt_channel_host.core.archive import archived_read
from stampede_rt_channel_host.core.channel import ChannelCore, Offer, SubscriptionBatch
from stampede_rt_channel_host.core.group import Horizon, VisibleAllCursor
from tests.property.archived_channel import ArchivedChannel
from tests.property.test_archive_against_memory import drained

SCENARIOS = int(os.environ.get("STAMPEDE_PROPERTY_EXAMPLES", "60"))
archived_steps: Counter[str] = Counter()


@pytest.fixture(autouse=True)
def small_windows(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a read load one block or a few blocks in each window, and a few windows for each answer."""
    monkeypatch.setattr(archived_read, "FIRST_WINDOW_BYTES", 1)
    monkeypatch.setattr(archived_read, "WINDOW_BYTES", 300)
    monkeypatch.setattr(archived_read, "ANSWER_BYTES", 12)


class World:
    """The same items in a channel without an archive and in a recorded channel with a small memory, and one cut."""

    def __init__(self, draw: random.Random) -> None:
        self.draw = draw
        self.large = ChannelCore(Policy(max_items=10**6), incarnation=7)
        limits = draw.choice([{"max_items": draw.randrange(1, 5)}, {"max_age_nanos": draw.randrange(1, 9)}])
        self.small = ArchivedChannel(
            Policy(**limits), runs_per_block=draw.randrange(1, 4), blocks_per_segment=draw.randrange(1, 4)
        )
        self.now = 0
        self.cut: int | None = None

    @property
    def horizon(self) -> Horizon:
        return Horizon(self.cut, lambda: "no channel holds the cut back")

    def put_some(self) -> None:
        """Put some items, in order or late. Perhaps write to the archive, and advance the cut."""
        for _ in range(self.draw.randrange(1, 12)):
            self.now += self.draw.choice([0, 0, 1, 1, 2, 3])
            time = max(0, self.now - self.draw.choice([0, 0, 0, 0, 1, 2, 5]))
            offer = Offer(times=[time], durations=None, lengths=[3])
            if self.small.put(offer, self.now).run is not None:
                self.large.put(offer, self.now, lambda first_seq, kept, stamped: b"x")
            if self.draw.random() < 0.4:
                self.small.archive()
        if self.draw.random() < 0.8:
            self.cut = max(self.cut or 0, self.now - self.draw.choice([0, 1, 4, 9]))


@pytest.mark.parametrize("seed", range(SCENARIOS))
def test_a_group_subscription_over_an_archive_equals_one_over_memory(seed: int) -> None:
    draw = random.Random(seed)
    world = World(draw)
    for _ in range(draw.randrange(4)):
        world.put_some()
    start, small = Bound(None, draw.randrange(-1, world.now + 2)), world.small
    expected = VisibleAllCursor(world.large, world.horizon, world.now, start=start)
    found = VisibleAllCursor(small.channel, world.horizon, world.now, start=start, archived=True)
    for _ in range(draw.randrange(1, 8)):
        limit = draw.choice([1, 100, 300, 10**6])
        place = found

        def take(place: VisibleAllCursor = place, limit: int = limit) -> SubscriptionBatch:
            batch = small.take_in_group(place, world.horizon, limit)
            archived_steps["steps"] += small.step is not None
            return batch

        memory = drained(lambda limit=limit: expected.take(world.horizon, world.now, limit))  # type: ignore[misc]
        assert drained(take) == memory, (world.cut, world.now)
        if draw.random() < 0.3:
            saved = found.saved
            assert saved is not None
            found = VisibleAllCursor(small.channel, world.horizon, world.now, saved=replace(saved), archived=True)
        world.put_some()


def test_the_scenarios_had_steps_that_came_from_the_archive() -> None:
    if archived_steps:  # only if the steps ran in this process
        assert archived_steps["steps"] > SCENARIOS // 3


@pytest.mark.parametrize("seed", range(SCENARIOS))
def test_a_group_subscription_counts_the_items_that_the_limits_of_the_archive_remove(seed: int) -> None:
    draw = random.Random(seed)
    small = ArchivedChannel(Policy(max_items=draw.randrange(1, 5)), runs_per_block=2, blocks_per_segment=2)
    place = VisibleAllCursor(small.channel, Horizon(0, lambda: ""), 0, archived=True)
    found, now, limit = 0, 0, draw.choice([1, 100, 10**6])
    for _ in range(draw.randrange(1, 6)):
        for _ in range(draw.randrange(1, 30)):
            now += 1
            small.put(Offer(times=[now], durations=None, lengths=[3]), now)
            small.archive()
        small.drop_segments(draw.randrange(4))
        cut = Horizon(now + 1 - draw.choice([0, 0, 3]), lambda: "")
        for _ in range(draw.choice([1, 3, 10**6])):
            batch = small.take_in_group(place, cut, limit)
            found += sum(one.slice.items for one in batch.slices)
            if batch.is_empty and not batch.more:
                break
    while not (batch := small.take_in_group(place, Horizon(now + 1, lambda: ""), limit)).is_empty or batch.more:
        found += sum(one.slice.items for one in batch.slices)
    assert found + place.dropped == now


def test_a_group_subscription_counts_a_late_item_that_the_archive_lacks_as_dropped() -> None:
    """In an earlier version it counted only missing items after the last cut, and left this item out without a gap."""
    small = ArchivedChannel(Policy(max_items=2), runs_per_block=1, blocks_per_segment=1)

    def put(*times: int) -> None:
        for time in times:
            small.put(Offer(times=[time], durations=None, lengths=[3]), max(small.now, time))
            small.archive()

    def taken(cut: int) -> list[int]:
        times, horizon = list[int](), Horizon(cut, lambda: "")
        while not (batch := small.take_in_group(place, horizon, 10**6)).is_empty or batch.more:
            times += [time for one in batch.slices for time in one.slice.run.times]
        return times

    place = VisibleAllCursor(small.channel, Horizon(0, lambda: ""), 0, archived=True)
    put(10, 20, 30)
    assert (taken(25), place.dropped) == ([10, 20], 0)
    put(22, 40, 50, 60)
    late = next(one for one in small.segments if one.first_seq == 4)
    small.segments.remove(late)
    assert (taken(70), place.dropped) == ([30, 40, 50, 60], 1)
