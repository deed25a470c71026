"""The work of a group's reader in one step does not grow with the number of late or held items."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from stampede_rt.values.model import Policy
from stampede_rt.values.timeline import parse_interval
from stampede_rt_channel_host.core.channel import ChannelCore, Slice, index, pieces
from stampede_rt_channel_host.core.group import (
    CutFollower,
    Horizon,
    VisibleAllCursor,
    VisibleChannel,
    VisibleNewestCursor,
    following,
)
from tests.support.channel_host.group_channels import NOW, channel, put

ITEMS = 10_000
POLICY = Policy(max_items=10**6, max_future_nanos=10**9)


class Counter:
    """The number of slices that were read in any index."""

    def __init__(self) -> None:
        self.slices = 0


@pytest.fixture
def looked(monkeypatch: pytest.MonkeyPatch) -> Counter:
    counter = Counter()
    for name in ("clipped", "clipped_by_seq"):
        clipped = getattr(index, name)

        def counting(*args: Any, clipped: Any = clipped) -> Iterator[Slice]:
            counter.slices += 1
            yield from clipped(*args)

        monkeypatch.setattr(index, name, counting)
    return counter


def reader_with_late_items() -> tuple[ChannelCore, CutFollower]:
    """A reader at cut 1,000,000, and 10,000 items below this cut that came afterwards, the latest first."""
    made = channel(1_000_000, policy=POLICY)
    follower = CutFollower(made, 1_000_001, NOW)
    for time in range(ITEMS, 0, -1):
        put(made, time)
    return made, follower


def test_the_late_items_of_a_reader_that_leaves_during_a_step_are_freed_in_parts() -> None:
    _, follower = reader_with_late_items()
    follower.begin(1_000_002)
    while not follower._late._heap or not follower._is_searched:
        follower.take(NOW, 1)
    counts = [len(follower._late._heap)]
    counts += [len(follower._late._heap) for _ in follower.emptying()]
    assert counts == [*range(counts[0], -1, -1)]
    assert counts[0] >= ITEMS // pieces.STEPS_PER_PIECE


def test_many_late_items_are_sent_in_order_in_bounded_parts(looked: Counter) -> None:
    _, follower = reader_with_late_items()
    looked.slices = 0
    follower.begin(1_000_002)
    times: list[int] = []
    while follower.under_way:
        before = looked.slices
        step = follower.take(NOW, 2**20)
        times += [one.slice.first_time for one in step.late]
        assert looked.slices - before <= 2 * pieces.STEPS_PER_PIECE
    assert times == list(range(1, ITEMS + 1))
    assert looked.slices <= 2 * ITEMS


def test_the_merge_of_late_items_begins_with_one_list_in_each_part(monkeypatch: pytest.MonkeyPatch) -> None:
    """In an earlier version, the merge of 1200 lists began with one step of 6 ms."""
    monkeypatch.setattr(pieces, "STEPS_PER_PIECE", 16)
    keys, order = 0, following._order

    def counting(part: Slice) -> index.ItemKey:
        nonlocal keys
        keys += 1
        return order(part)

    monkeypatch.setattr(following, "_order", counting)
    _, follower = reader_with_late_items()  # the reader holds the items in 625 lists
    follower.begin(1_000_002)
    times: list[int] = []
    while follower.under_way:
        before = keys
        times += [one.slice.first_time for one in follower.take(NOW, 2**20).late]
        assert keys - before <= 3 * pieces.STEPS_PER_PIECE
    assert times == list(range(1, ITEMS + 1))


def test_a_read_through_a_group_reports_that_unread_items_remain() -> None:
    made = channel(1_000_000, policy=POLICY)
    horizon = Horizon(1_000_001, lambda: "held back")
    reader, newest = VisibleAllCursor(made, horizon, NOW), VisibleNewestCursor(made, horizon, NOW)
    for time in range(ITEMS, 0, -1):
        put(made, time)
    first = reader.take(horizon, NOW, 2**20)
    assert (first.is_empty, first.more) == (True, True)
    counts = []
    while (part := newest.take(horizon, NOW)).more:
        counts.append(newest.skipped)
        assert part.is_empty
    assert newest.skipped == ITEMS
    assert len(counts) > 2


def test_a_subscription_through_a_group_from_the_oldest_item_on_begins_without_a_scan(looked: Counter) -> None:
    made = channel(*range(1, ITEMS + 1), policy=POLICY)
    looked.slices = 0
    horizon = Horizon(ITEMS + 1, lambda: "held back")
    VisibleAllCursor(made, horizon, NOW, start=parse_interval(0, NOW).start)
    assert looked.slices <= 5000
    looked.slices = 0
    assert VisibleChannel(made).hidden_items(ITEMS // 2, NOW) == ITEMS // 2 + 1
    assert looked.slices <= 3000
