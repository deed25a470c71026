"""Matches from archives as of an instant equal the matches that a host would have decided then with all items in
memory.
"""

from __future__ import annotations

import random
from types import SimpleNamespace
from typing import Any

import pytest

from stampede_rt._sync import archived_matching
from stampede_rt._sync.archived_matching import ArchivedMatching, ArchivedMember
from stampede_rt.values.answers import Items, PastState
from stampede_rt.values.grouping import GroupInfo
from stampede_rt.values.match_rule import MatchRule
from stampede_rt.values.model import Item
from stampede_rt.values.reading import ReadQuery
from stampede_rt.values.timeline import OLDEST, parse_bound
from stampede_rt_channel_host.core.archive import archived_read
from stampede_rt_channel_host.core.channel import Position, Query
from stampede_rt_channel_host.core.group import LocalTrack, Matcher, OwnChannelTimes
from tests.property.archived_channel import ArchivedChannel
from tests.property.channel_pair import items_of
from tests.property.groups.test_groups_as_of import NAMES, PastGroup
from tests.property.test_archive_against_memory import put_in_both

SCENARIOS = 120
GROUP = GroupInfo(
    group_id=b"g", name="g", channel_ids=NAMES, reference_id=None, bound="start", idle_after_nanos=None,
    max_lead_nanos=0, incarnation=1, spec_version=1,
)  # fmt: skip


@pytest.fixture(autouse=True)
def small_pages(monkeypatch: pytest.MonkeyPatch) -> None:
    """Windows and pages of a few items."""
    monkeypatch.setattr(archived_read, "FIRST_WINDOW_BYTES", 1)
    monkeypatch.setattr(archived_read, "WINDOW_BYTES", 300)
    monkeypatch.setattr(archived_read, "ANSWER_BYTES", 12)
    monkeypatch.setattr(archived_matching, "KEYS_PER_PAGE", 3)


def read(channel: ArchivedChannel, query: ReadQuery, as_of: int) -> Items:
    """The answer that a client gets from the host of the channel."""
    after = None
    if isinstance(query.after, Item):
        after = Position(query.after.time, query.after.seq)
    core_query = Query(
        interval=query.interval, match=query.match, limit=query.limit, newest_first=query.newest_first, after=after
    )
    found, past = channel.read_as_of(core_query, as_of), channel.past(as_of)
    items = [Item(one.time, None, one.duration, one.seq, b"", {}, "", 0, 7) for one in items_of(found.slices)]
    if query.newest_first:
        items.reverse()
    return Items(
        items, interval=found.interval, complete=found.complete, truncated=found.truncated, more=found.more,
        reason=found.reason, incarnation=7, past=PastState(past.advance, None, None),
    )  # fmt: skip


def member(name: bytes, channel: ArchivedChannel) -> ArchivedMember:
    handle: Any = SimpleNamespace(info=SimpleNamespace(channel_id=name, name=name.decode()), name=name.decode())
    return ArchivedMember(handle, lambda query, as_of: read(channel, query, as_of))


def decided(then: PastGroup, rule: MatchRule, start: int, as_of: int) -> tuple[list[object], int]:
    """The matches that a host decides at that instant, from the item at `start` on."""
    own, other = (then.channels[name] for name in NAMES)
    times = {NAMES[0]: OwnChannelTimes(own, 0), NAMES[1]: OwnChannelTimes(other, 0)}
    matcher = Matcher(
        own, {NAMES[1]: LocalTrack(other)}, rule.tolerance_nanos, as_of, Position(start - 1),
        partners={} if rule.unique else None,
    )  # fmt: skip

    def has_passed(name: bytes, instant: int) -> bool:
        return times[name or NAMES[0]].times(1).has_passed(instant, rule.lateness_nanos)

    found = matcher.take(has_passed, as_of, 10**6)
    keys = [
        ((one.item.slice.first_time, one.item.slice.first_seq), {name: two[:2] for name, two in one.matched.items()})
        for one in found
    ]
    return list(keys), matcher.unmatched


@pytest.mark.parametrize("seed", range(SCENARIOS))
def test_matches_as_of_an_instant_equal_the_matches_that_a_host_decides_then(seed: int) -> None:
    draw = random.Random(seed)
    pairs = {name: put_in_both(draw, advances=True) for name in NAMES}
    large, small = {name: one[0] for name, one in pairs.items()}, {name: one[1] for name, one in pairs.items()}
    for channel in small.values():
        channel.archive()
    first, last = max(one.first_accepted for one in small.values()), max(one[3] for one in pairs.values())
    for _ in range(6):
        as_of, start = draw.randrange(first, max(first, last) + 2), draw.randrange(last + 1)
        rule = MatchRule(
            tolerance_nanos=draw.choice([0, 1, 3, 8, 50]), lateness_nanos=draw.choice([0, 0, 1, 4]),
            unique=draw.random() < 0.5, partial=True, payloads=False, start=parse_bound(start),
        )  # fmt: skip
        members = [member(name, channel) for name, channel in small.items()]
        matching = ArchivedMatching(GROUP, members, members[0], rule)
        matching.begin(as_of)
        found = []
        while (match := matching.next_match()) is not None:
            matched = matching.matched(match)
            assert matched is not None
            keys = {one: (item.time, item.seq) for one, item in matched._values.items()}
            assert keys == {NAMES[0]: match.key, **match.partners}
            found.append((match.key, dict(match.partners)))
        expected = decided(PastGroup(large, small, as_of), rule, start, as_of)
        assert (found, matching.unmatched) == expected, (rule, start, as_of)
        assert (matching.dropped, matching.reason) == (0, None)


def test_matches_whose_archive_has_dropped_items_say_so() -> None:
    reported_losses = 0
    for seed in range(20):
        draw = random.Random(seed)
        small = {name: put_in_both(draw, advances=True) for name in NAMES}
        channels = {name: one[1] for name, one in small.items()}
        for channel in channels.values():
            channel.archive()
        channels[NAMES[1]].drop_segments(2)
        members = [member(name, channel) for name, channel in channels.items()]
        rule = MatchRule(tolerance_nanos=3, lateness_nanos=0, unique=False, partial=True, payloads=False, start=OLDEST)
        matching = ArchivedMatching(GROUP, members, members[0], rule)
        matching.begin(max(one[3] for one in small.values()))
        while matching.next_match() is not None:
            pass
        if channels[NAMES[1]].is_cut and matching.reason is not None:
            assert matching.reason == "COLLECTED"
            assert "right" in matching.reason.detail
            reported_losses += 1
    assert reported_losses > 5
