"""Recorded channels with a small memory give the same matches as channels that have everything in memory."""

from __future__ import annotations

import random

import pytest

from stampede_rt.values.model import Policy
from stampede_rt_channel_host.core.archive import archived_read
from stampede_rt_channel_host.core.channel import ChannelCore, DeliveredSlice, Offer, Position
from stampede_rt_channel_host.core.group import FoundMatch, LocalTrack, Matcher, recorded_track
from stampede_rt_channel_host.core.group.recorded_track import (
    ItemsNotLoaded,
    RecordedOwnTrack,
    RecordedTrack,
    archived_item,
    found_item,
)
from tests.property.archived_channel import ArchivedChannel
from tests.property.test_archive_against_memory import put_in_both

SCENARIOS = 150
OWN, OTHER, THIRD = b"", b"other", b"third"
Match = tuple[object, ...]


@pytest.fixture(autouse=True)
def small_windows(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a read load one block or a few blocks in each window, and a few windows for each answer."""
    monkeypatch.setattr(archived_read, "FIRST_WINDOW_BYTES", 1)
    monkeypatch.setattr(archived_read, "WINDOW_BYTES", 300)
    monkeypatch.setattr(archived_read, "ANSWER_BYTES", 12)


class Pair:
    """The same channels twice: in memory, and recorded with a small memory. Each has its matcher."""

    def __init__(self, draw: random.Random) -> None:
        pairs = {name: put_in_both(draw) for name in (OWN, OTHER, THIRD)}
        self.large: dict[bytes, ChannelCore] = {name: one[0] for name, one in pairs.items()}
        self.small: dict[bytes, ArchivedChannel] = {name: one[1] for name, one in pairs.items()}
        self.now = max(one[3] for one in pairs.values())
        self.tolerance = draw.choice([0, 1, 3, 8, 50])
        self.begin(Position(draw.randrange(-1, self.now + 1)), None, {} if draw.random() < 0.5 else None)

    def begin(self, after: Position, next_seq: int | None, partners: dict[bytes, tuple[int, int]] | None) -> None:
        """Begin, or continue, at a position."""
        self.memory = Matcher(
            self.large[OWN], {name: LocalTrack(self.large[name]) for name in (OTHER, THIRD)}, self.tolerance, self.now,
            after, next_seq, partners,
        )  # fmt: skip
        small = {name: one.channel for name, one in self.small.items()}
        tracks = {name: RecordedTrack(small[name], name, is_ascending=partners is None) for name in (OTHER, THIRD)}
        own = RecordedOwnTrack(small[OWN], OWN, self.small[OWN].kept_from)
        self.archived = Matcher(small[OWN], tracks, self.tolerance, self.now, after, next_seq, partners, recorded=own)

    def put(self, name: bytes, time: int) -> None:
        offer = Offer(times=[time], durations=None, lengths=[3])
        if self.small[name].put(offer, self.now).run is not None:
            self.large[name].put(offer, self.now, lambda first_seq, kept, stamped: b"x")

    def take_archived(self, most: int) -> list[Match]:
        taken: list[Match] = []
        for _ in range(10_000):
            try:
                found = self.archived.take(
                    lambda member, instant: True, self.now, min(most - len(taken), 3), looks_max=4
                )
            except ItemsNotLoaded as missing:
                self.small[missing.channel_id].load(missing.reads())
                continue
            taken += [shown(one, self.partner) for one in found]
            if not found and not self.archived.has_more:
                return taken
        raise AssertionError("the matcher makes no progress")

    def partner(self, member: bytes, time: int, seq: int) -> DeliveredSlice | None:
        return found_item(self.small[member].performed(archived_item(time, seq)))


def fail(member: bytes, time: int, seq: int) -> DeliveredSlice | None:
    raise AssertionError("memory has the item")


def shown(one: FoundMatch, partner: object) -> Match:
    near = {
        name: (two.time, two.seq, facts(partner(name, two.time, two.seq) if two.is_archived else two.item))  # type: ignore[operator]
        for name, two in one.matched.items()
    }
    return facts(one.item), near, one.missing


def facts(item: DeliveredSlice | None) -> Match:
    assert item is not None
    part = item.slice
    assert part.items == 1
    return part.first_time, part.first_seq, item.next_time


@pytest.mark.parametrize("seed", range(SCENARIOS))
def test_matches_over_archives_equal_matches_over_memory(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    draw = random.Random(seed)
    monkeypatch.setattr(recorded_track, "PAGE_KEYS_MAX", 2 + 2**13 * (seed % 2))
    pair = Pair(draw)
    for _ in range(4):
        most = draw.choice([0, 1, 3, 1000])
        expected = pair.memory.take(lambda member, instant: True, pair.now, most)
        assert pair.take_archived(most) == [shown(one, fail) for one in expected]
        assert (pair.archived.unmatched, pair.archived.dropped) == (pair.memory.unmatched, pair.memory.dropped)
        assert (pair.archived.position, pair.archived.next_seq) == (pair.memory.position, pair.memory.next_seq)
        assert pair.archived.partners == pair.memory.partners
        pair.now += draw.randrange(4)
        for name in pair.small:
            for _ in range(draw.randrange(4)):
                pair.put(name, max(0, pair.now - draw.choice([0, 0, 0, 1, 2, 5])))
            for matcher in (pair.archived, pair.memory):
                matcher.take(lambda member, instant: True, pair.now, 0, credit_bytes=0)  # as at each change
            if draw.random() < 0.5:
                pair.small[name].archive()
        if draw.random() < 0.3:
            at = pair.memory
            partners = dict(at.partners) if at._partners is not None else None
            pair.begin(at.position, at.next_seq, partners)


def recorded(times: range) -> ArchivedChannel:
    """A channel with items at these times, of which memory has the last three."""
    channel = ArchivedChannel(Policy(max_items=3, archive_nanos=10**18), runs_per_block=4, blocks_per_segment=8)
    for time in times:
        channel.put(Offer(times=[time], durations=None, lengths=[3]), time)
        channel.archive()
    return channel


@pytest.mark.parametrize("step", [3, 150])
def test_a_track_holds_few_keys_for_any_tolerance_if_matches_need_not_be_unique(
    monkeypatch: pytest.MonkeyPatch, step: int
) -> None:
    monkeypatch.setattr(recorded_track, "KEYS_MAX", 60)
    own, other = recorded(range(0, 400, step)), recorded(range(400))
    tracks = {OTHER: RecordedTrack(other.channel, OTHER, is_ascending=True)}
    recorded_own = RecordedOwnTrack(own.channel, OWN, own.kept_from)
    matcher = Matcher(own.channel, tracks, 1000, 500, Position(-1), recorded=recorded_own)
    found: list[FoundMatch] = []
    while len(found) < len(range(0, 400, step)):
        try:
            found += matcher.take(lambda member, instant: True, 500, 3)
        except ItemsNotLoaded as missing:
            {OWN: own, OTHER: other}[missing.channel_id].load(missing.reads())
    assert [one.matched[OTHER].time for one in found] == [*range(0, 400, step)]


def test_a_match_accepts_a_page_of_many_tiny_items(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(archived_read, "ANSWER_BYTES", 10**6)
    monkeypatch.setattr(recorded_track, "KEYS_MAX", 60)
    monkeypatch.setattr(recorded_track, "PAGE_KEYS_MAX", 20)
    other = recorded(range(400))
    track = RecordedTrack(other.channel, OTHER)
    for _ in range(100):
        try:
            near = track.nearest(100, 2, 500)
            break
        except ItemsNotLoaded as missing:
            other.load(missing.reads())
    assert near is not None
    assert near.time == 100


@pytest.mark.parametrize("seed", range(SCENARIOS))
def test_matches_count_the_items_that_the_limits_of_the_archive_remove(seed: int) -> None:
    draw = random.Random(seed)
    own = ArchivedChannel(Policy(max_items=draw.randrange(1, 5)), runs_per_block=2, blocks_per_segment=2)
    own.put(Offer(times=[0], durations=None, lengths=[3]), 0)
    track = RecordedOwnTrack(own.channel, OWN, own.kept_from)
    matcher = Matcher(own.channel, {}, 0, 0, None, None, None, recorded=track)  # begins after the first item
    found, now = 0, 0

    def take(most: int) -> int:
        try:
            return len(matcher.take(lambda member, instant: True, now, most))
        except ItemsNotLoaded as missing:
            own.load(missing.reads())
            return len(matcher.take(lambda member, instant: True, now, most))

    for _ in range(draw.randrange(1, 6)):
        for _ in range(draw.randrange(1, 30)):
            now += 1
            own.put(Offer(times=[now], durations=None, lengths=[3]), now)
            own.archive()
        own.drop_segments(draw.randrange(4))
        found += sum(take(3) for _ in range(draw.choice([0, 1, 3])))
    while more := take(1000):
        found += more
    assert found + matcher.dropped == now
