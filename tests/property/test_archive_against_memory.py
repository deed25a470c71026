"""Reads over an archive and a small memory give the answers of a channel that has all items in memory."""

from __future__ import annotations

import os
import random
from collections.abc import Callable
from dataclasses import replace

import pytest

from stampede_rt.errors import StampedeError
from stampede_rt.values.model import Policy
from stampede_rt.values.timeline import NEWEST, NOW, OLDEST, Bound, Interval, Match
from stampede_rt_channel_host.core.archive import archived_read
from stampede_rt_channel_host.core.channel import ChannelCore, Offer, Position, Query, ReadAnswer, SubscriptionBatch
from tests.property.archived_channel import ArchivedChannel
from tests.property.channel_pair import ends_as_read, facts, items_of
from tests.property.moved_channel import MovedChannel

SCENARIOS = int(os.environ.get("STAMPEDE_PROPERTY_EXAMPLES", "60"))
READS = 25


@pytest.fixture(autouse=True)
def small_windows(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a read load one block or a few blocks in each window, and a few windows for each answer."""
    monkeypatch.setattr(archived_read, "FIRST_WINDOW_BYTES", 1)
    monkeypatch.setattr(archived_read, "WINDOW_BYTES", 300)
    monkeypatch.setattr(archived_read, "ANSWER_BYTES", 12)


def bound(draw: random.Random, last: int) -> Bound:
    kind = draw.randrange(8)
    if kind == 0:
        return replace(NEWEST, offset=-draw.randrange(5))
    if kind == 1:
        return replace(NOW, offset=-draw.randrange(8))
    if kind == 2:
        return replace(OLDEST, offset=draw.randrange(4))
    return Bound(None, draw.randrange(-2, last + 4))


def query_of(draw: random.Random, last: int, positions: list[Position]) -> Query:
    start, end = bound(draw, last), bound(draw, last)
    if start.meta is None and end.meta is None:
        start, end = sorted((start, end), key=lambda one: one.offset)
    interval = Interval(start, end, draw.random() < 0.4, draw.random() < 0.4)
    return Query(
        interval=interval,
        match=draw.choice(list(Match)),
        limit=draw.choice([None, None, 1, 2, 5]),
        newest_first=draw.random() < 0.4,
        after=draw.choice(positions) if draw.random() < 0.2 else None,
        newer_than=draw.choice(positions) if draw.random() < 0.1 else None,
    )


def shown(answer: ReadAnswer, overlap: int) -> tuple[object, ...]:
    items = items_of(answer.slices)
    ends = ends_as_read(items, answer.next_time, overlap, answer.next_times)
    reason = None if answer.reason is None else str(answer.reason)
    return facts(items), ends, answer.interval, answer.complete, answer.truncated, answer.more, reason


def put_in_both(
    draw: random.Random, *, advances: bool = False, moves: bool = False
) -> tuple[ChannelCore, ArchivedChannel, list[Position], int]:
    """Put the same items into a channel in memory and into a recorded channel.

    With `moves` the recorded channel moves between hosts. Returns both channels, the positions of the items, and the
    time.
    """
    overlap = draw.choice([None, None, 3, 8])
    large = ChannelCore(Policy(max_items=10**6, overlap_nanos=overlap), incarnation=7)
    limits = draw.choice([{"max_items": draw.randrange(1, 5)}, {"max_age_nanos": draw.randrange(1, 9)}])
    small = (MovedChannel if moves else ArchivedChannel)(
        Policy(**limits, overlap_nanos=overlap),
        runs_per_block=draw.randrange(1, 4),
        blocks_per_segment=draw.randrange(1, 4),
    )
    now, positions = 0, [Position(0, 1)]
    for _ in range(draw.randrange(2, 40)):
        now += draw.choice([0, 0, 1, 1, 2, 3])
        count = draw.choice([1, 1, 1, 2, 4])
        times = [max(0, now - draw.choice([0, 0, 0, 0, 1, 2, 5])) for _ in range(count)]
        durations = draw.choice([None, [draw.choice([-1, 0, 1, 4, 9]) for _ in range(count)]])
        for time, duration in zip(times, durations or [None] * count, strict=True):
            offer = Offer(times=[time], durations=None if duration is None else [duration], lengths=[3])
            outcome = small.put(offer, now)
            if outcome.run is not None:
                kept = large.put(offer, now, lambda first_seq, kept, stamped: b"x")
                assert kept.run is not None
                assert kept.run.first_seq == outcome.run.first_seq
                positions.append(Position(time, outcome.run.first_seq))
        if advances and draw.random() < 0.2:
            now += 1  # so that the instants have the order of the acceptances
            instant = now - draw.randrange(3)
            small.advance(instant, now)
            large.advance(instant, now)
            now += 1
        if draw.random() < 0.5:
            small.archive()
        if isinstance(small, MovedChannel) and draw.random() < 0.3:
            small.move(draw)
    return large, small, positions, now


@pytest.mark.parametrize("moves", [False, True])
@pytest.mark.parametrize("seed", range(SCENARIOS))
def test_a_read_over_an_archive_and_a_small_memory_equals_one_over_a_large_memory(seed: int, moves: bool) -> None:
    draw = random.Random(seed)
    large, small, positions, now = put_in_both(draw, moves=moves)
    overlap = large.policy.overlap_nanos
    for _ in range(READS):
        query = query_of(draw, now, positions)
        try:
            expected = large.read(query, now)
        except StampedeError as error:
            with pytest.raises(type(error)):
                small.read(query)
            continue
        assert shown(small.read(query), overlap or 0) == shown(expected, overlap or 0), query


@pytest.mark.parametrize("moves", [False, True])
@pytest.mark.parametrize("seed", range(SCENARIOS))
def test_a_read_as_of_an_instant_equals_the_read_at_that_instant(seed: int, moves: bool) -> None:
    draw = random.Random(seed)
    large, small, positions, now = put_in_both(draw, advances=not moves, moves=moves)
    small.archive()
    overlap = large.policy.overlap_nanos
    for _ in range(READS):
        as_of = draw.randrange(small.first_accepted, now + 2)
        then = ChannelCore(large.policy, incarnation=7)
        for accepted, change in sorted([*small.offers, *small.advances], key=lambda one: one[0]):
            if accepted <= as_of and isinstance(change, Offer):
                then.put(change, accepted, lambda first_seq, kept, stamped: b"x")
            elif accepted <= as_of and isinstance(change, int):
                then.advance(change, accepted)
        query = query_of(draw, now, positions)
        try:
            expected = then.read(query, as_of)
        except StampedeError as error:
            with pytest.raises(type(error)):
                small.read_as_of(query, as_of)
            continue
        assert shown(small.read_as_of(query, as_of), overlap or 0) == shown(expected, overlap or 0), (query, as_of)


@pytest.mark.parametrize("moves", [False, True])
@pytest.mark.parametrize("seed", range(SCENARIOS))
def test_a_subscription_that_starts_in_the_archive_yields_the_same_items_as_one_over_memory(
    seed: int, moves: bool
) -> None:
    draw = random.Random(seed)
    large, small, _, now = put_in_both(draw, moves=moves)
    start = draw.randrange(-1, now + 2)
    expected = large.subscribe_all(now, start=Bound(None, start))
    cursor, limit = small.subscribe(start), draw.choice([1, 100, 300, 10**6])
    assert drained(lambda: small.take(cursor, limit)) == drained(lambda: large.since(expected, now, limit))


def drained(take: Callable[[], SubscriptionBatch]) -> list[tuple[object, ...]]:
    """The items of a subscription in their order, each with the end that a reader computes."""
    found: list[tuple[object, ...]] = []
    while True:
        batch = take()
        assert batch.gap is None
        for part in batch.slices:
            items = items_of([part.slice])
            found += zip(facts(items), ends_as_read(items, part.next_time, 0), strict=True)
        if batch.is_empty and not batch.more:
            return found


def test_a_read_of_the_newest_items_in_memory_loads_nothing_from_the_archive() -> None:
    small = ArchivedChannel(Policy(max_items=3), runs_per_block=1, blocks_per_segment=2)
    for time in range(20):
        small.put(Offer(times=[time], durations=None, lengths=[3]), time)
        small.archive()
    query = Query(interval=Interval(OLDEST, NOW), newest_first=True, limit=1)
    assert facts(items_of(small.read(query).slices)) == [(19, 20, None, 3)]
    assert small.loads == 0


def test_a_newest_item_without_a_duration_lasts_up_to_now_on_each_page() -> None:
    small = ArchivedChannel(Policy(max_items=1), runs_per_block=1, blocks_per_segment=2)
    for time in range(20):
        small.put(Offer(times=[time], durations=None, lengths=[3]), time)
        small.archive()
    answer = small.read(Query(interval=Interval(Bound(None, 0), NOW), match=Match.WHOLE))
    assert [item[0] for item in facts(items_of(answer.slices))] == list(range(20))


def test_a_read_with_a_long_overlap_loads_the_archive_in_small_windows() -> None:
    small = ArchivedChannel(Policy(max_items=3, overlap_nanos=1000), runs_per_block=1, blocks_per_segment=4)
    for time in range(400):
        small.put(Offer(times=[time], durations=[500 if time == 7 else 1], lengths=[3]), time)
    small.archive()
    for newest_first in (False, True):
        small.loaded_max = 0
        query = Query(interval=Interval(Bound(None, 390), Bound(None, 391)), newest_first=newest_first)
        assert [item[0] for item in facts(items_of(small.read(query).slices))] == [7, 390, 391]
        assert small.loaded_max < 1500  # bytes; the archive has 50 times as many


def test_items_that_are_not_archived_stay_in_memory_until_max_bytes_removes_them() -> None:
    small = ArchivedChannel(Policy(max_items=2, max_bytes=64 * 8), runs_per_block=1, blocks_per_segment=2)
    for time in range(6):
        small.put(Offer(times=[time], durations=None, lengths=[0]), time)
    assert small.channel.counters(6).held == 6
    for time in range(6, 12):
        small.put(Offer(times=[time], durations=None, lengths=[0]), time)
    assert small.channel.counters(12).held == 8
    small.archive()
    assert small.channel.counters(12).held == 2


@pytest.mark.parametrize("overlap", [None, 5])
def test_an_item_that_left_memory_before_the_next_bucket_came_lasts_up_to_this_bucket(overlap: int | None) -> None:
    small = ArchivedChannel(Policy(max_items=1, overlap_nanos=overlap), runs_per_block=1, blocks_per_segment=1)
    large = ChannelCore(Policy(max_items=10, overlap_nanos=overlap), incarnation=7)
    for now, time, durations in ((10, 10, None), (11, 10, [0]), (50, 50, None)):
        offer = Offer(times=[time], durations=durations, lengths=[3])
        small.put(offer, now)
        large.put(offer, now, lambda first_seq, kept, stamped: b"x")
        small.archive()  # so the first item leaves memory at 11, when nobody knows where its span will end
    for start in (12, 30, 49):
        query = Query(interval=Interval(Bound(None, start), Bound(None, 60)))
        found, expected = small.read(query), large.read(query, small.now)
        assert shown(found, overlap or 0) == shown(expected, overlap or 0)
        assert [one.seq for one in items_of(found.slices)] == [1, 3]
