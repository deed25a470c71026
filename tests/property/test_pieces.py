"""Long work in pieces has the result of its first moment, whatever changes in the channel between two pieces."""

from __future__ import annotations

import os
import random
from collections.abc import Sequence
from dataclasses import replace
from typing import Any
from unittest import mock

import pytest

from stampede_rt.errors import StampedeError
from stampede_rt.values.model import Policy
from stampede_rt.values.timeline import Match, parse_interval
from stampede_rt_channel_host.core.channel import (
    ChannelCore,
    ChannelSnapshot,
    Offer,
    PendingGet,
    Pieces,
    Position,
    Query,
    ReadAnswer,
    Slice,
    UnfinishedWork,
    WakeAt,
    first_of,
    item_blocks,
    pieces,
    run_to_end,
)
from stampede_rt_channel_host.core.group import Horizon, VisibleChannel, polling

NOW = 10_000
SEEDS = int(os.environ.get("STAMPEDE_PROPERTY_EXAMPLES", "100"))
POLICIES = {
    "all is kept": Policy(max_age_nanos=10**9, max_future_nanos=1000),
    "age": Policy(max_age_nanos=300, max_future_nanos=1000),
    "count": Policy(max_items=60, max_future_nanos=1000),
    "bytes": Policy(max_bytes=60 * 70, max_future_nanos=1000),
    "consumption": Policy(consumers=1, max_age_nanos=10**9, max_future_nanos=1000),
}


class BusyChannel:
    """A channel that random steps change."""

    def __init__(self, policy: Policy, seed: int) -> None:
        self.rng = random.Random(seed)
        self.channel = ChannelCore(policy, incarnation=1)
        self.now = NOW
        self.consumes = policy.consumers is not None
        for _ in range(100):
            self.change()

    def change(self) -> None:
        """Put an item, in order or late, and perhaps consume."""
        rng = self.rng
        self.now += rng.randrange(12)
        times = [self.now - (0 if rng.random() < 0.6 else rng.randrange(200)) for _ in range(rng.randrange(1, 5))]
        durations = [rng.randrange(-1, 30) for _ in times] if rng.random() < 0.3 else None
        self.channel.put(Offer(times=times, durations=durations, lengths=[1] * len(times)), self.now, _seal)
        if self.consumes and rng.random() < 0.7:
            end = max(1, self.channel.next_seq - 25)
            self.channel.consume(1, range(max(1, end - 20), end), self.now)
        if rng.random() < 0.5:
            self.channel.collect(self.now)

    def query(self) -> Query:
        """A random read."""
        rng = self.rng
        low = self.now - rng.randrange(500)
        after = Position(self.now - rng.randrange(300), rng.randrange(1, self.channel.next_seq))
        return Query(
            interval=parse_interval(low, low + rng.randrange(600)),
            match=rng.choice(list(Match)),
            limit=rng.choice((None, None, 1, 7, 50)),
            newest_first=rng.random() < 0.5,
            after=after if rng.random() < 0.3 else None,
        )

    def finish(self, rest: Pieces[Any]) -> Any:
        """Run the pieces to their end, and change the channel between them."""

        def between() -> Pieces[Any]:
            while True:
                self.change()
                try:
                    next(rest)
                except StopIteration as end:
                    return end.value
                yield

        return run_to_end(between())


def _seal(first_seq: int, kept: Sequence[int] | None, stamped_time: int | None) -> bytes:
    return b""


def places(slices: Sequence[Slice]) -> list[tuple[int, int]]:
    return [(part.run.times[at], part.run.first_seq + at) for part in slices for at in range(part.lo, part.hi)]


def shown(answer: ReadAnswer) -> tuple[Any, ...]:
    return (places(answer.slices), *answer[1:])


@pytest.mark.parametrize("name", POLICIES)
def test_an_answer_built_in_pieces_shows_the_channel_at_its_first_piece(name: str) -> None:
    unfinished = 0
    with mock.patch.object(pieces, "STEPS_PER_PIECE", 3), mock.patch.object(item_blocks, "BLOCK_ITEMS", 4):
        for seed in range(SEEDS):
            busy = BusyChannel(POLICIES[name], seed)
            query = busy.query()
            expected = busy.channel.read(query, busy.now)
            found = first_of(busy.channel.reading(query, busy.now))
            if isinstance(found, UnfinishedWork):
                unfinished += 1
                found = busy.finish(found.rest)
            assert shown(found) == shown(expected), f"seed {seed}"
            assert not busy.channel.look(busy.now)[0]._snapshots, "the channel still keeps a snapshot"
    assert unfinished > SEEDS // 10


def test_a_group_answer_built_in_pieces_shows_the_group_at_its_first_piece() -> None:
    unfinished = 0
    with mock.patch.object(pieces, "STEPS_PER_PIECE", 3):
        for seed in range(SEEDS):
            busy = BusyChannel(POLICIES["age"], seed)
            query, view = busy.query(), VisibleChannel(busy.channel)
            horizon = Horizon(busy.now - busy.rng.randrange(100), lambda: "held back")
            expected = view.read(query, horizon, busy.now)
            found = first_of(view.reading(query, horizon, busy.now))
            if isinstance(found, UnfinishedWork):
                unfinished += 1
                found = busy.finish(found.rest)
            assert shown(found) == shown(expected), f"seed {seed}"
    assert unfinished > SEEDS // 10


def polled(
    source: ChannelCore | ChannelSnapshot, query: Query, horizon: Horizon | None, now: int
) -> ReadAnswer | WakeAt:
    pending = PendingGet(query, None)
    return run_to_end(source.polling(pending, now) if horizon is None else polling(source, pending, horizon, now))


@pytest.mark.parametrize("name", POLICIES)
def test_a_snapshot_gives_the_same_answer_later(name: str) -> None:
    """Each get reads the channel alone, and then through a group."""
    answered = {False: 0, True: 0}
    for seed in range(SEEDS):
        busy = BusyChannel(POLICIES[name], seed)
        query = replace(busy.query(), complete=busy.rng.random() < 0.3)
        horizon = Horizon(busy.now - busy.rng.randrange(100), lambda: "held back")

        now, horizons = busy.now, (None, horizon)
        expected, snapshot = [polled(busy.channel, query, one, now) for one in horizons], busy.channel.snapshot(now)
        for _ in range(20):
            busy.change()
        found = [polled(snapshot, query, one, now) for one in horizons]
        snapshot.close()
        for through_group, before, later in zip((False, True), expected, found, strict=True):
            if isinstance(before, ReadAnswer):
                answered[through_group] += 1
                assert isinstance(later, ReadAnswer), f"seed {seed}"
                assert shown(later) == shown(before), f"seed {seed}"
            else:
                assert later == before, f"seed {seed}"
        assert not busy.channel.look(busy.now)[0]._snapshots, "the channel still keeps a snapshot"
    assert min(answered.values()) > SEEDS // 10


@pytest.mark.parametrize("name", POLICIES)
def test_a_subscription_that_begins_in_pieces_yields_the_items_held_at_its_beginning(name: str) -> None:
    with mock.patch.object(pieces, "STEPS_PER_PIECE", 3):
        for seed in range(SEEDS):
            busy = BusyChannel(POLICIES[name], seed)
            time = busy.now - busy.rng.randrange(500)
            start = parse_interval(time, busy.now).start
            held, _ = busy.channel.look(busy.now)
            expected = {seq for place_time, seq in places([*held.slices()]) if place_time >= time}
            first_later_seq = busy.channel.next_seq
            opening = first_of(busy.channel.subscribing_all(busy.now, start=start))
            cursor = busy.finish(opening.rest) if isinstance(opening, UnfinishedWork) else opening
            expected |= set(range(first_later_seq, busy.channel.next_seq))
            given: list[int] = []
            lost = 0
            while not (part := busy.channel.since(cursor, busy.now, 10**6)).is_empty:
                given += [seq for one in part.slices for _, seq in places([one.slice])]
                lost += part.gap.items if part.gap else 0
            assert len(given) == len(set(given))
            assert set(given) <= expected, f"seed {seed}"
            assert lost == len(expected) - len(given), f"seed {seed}"


def test_an_abandoned_answer_in_pieces_keeps_no_item_from_collection() -> None:
    with mock.patch.object(pieces, "STEPS_PER_PIECE", 3):
        busy = BusyChannel(POLICIES["all is kept"], 1)
        found = first_of(busy.channel.reading(Query(interval=parse_interval(0, 2 * NOW)), busy.now))
        assert isinstance(found, UnfinishedWork)
        held, _ = busy.channel.look(busy.now)
        assert held._snapshots
        found.rest.close()
        assert not held._snapshots


def test_a_get_with_a_wrong_position_is_refused_immediately() -> None:
    busy = BusyChannel(POLICIES["all is kept"], 1)
    query = Query(interval=parse_interval(0, 2 * NOW), after=Position(NOW, 1, incarnation=2))
    with pytest.raises(StampedeError, match="incarnation 2"):
        busy.channel.reading(query, busy.now)
