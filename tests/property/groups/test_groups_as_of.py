"""A read of a group as of an instant gets the answer of the group at that instant, up to the cut at that instant."""

from __future__ import annotations

import random

import pytest

from stampede_rt.errors import StampedeError
from stampede_rt.values.model import Reason
from stampede_rt.values.past import PastCut, PastMark, past_cut_of
from stampede_rt.values.timeline import MAX_INSTANT, MIN_INSTANT, Match, parse_interval
from stampede_rt_channel_host.core.archive import archived_read
from stampede_rt_channel_host.core.channel import ChannelCore, Offer, Query, ReadAnswer
from stampede_rt_channel_host.core.group import (
    GroupCut,
    GroupDefinition,
    Horizon,
    OwnChannelTimes,
    TimesBoard,
    VisibleChannel,
)
from tests.property.archived_channel import ArchivedChannel
from tests.property.test_archive_against_memory import put_in_both, query_of, shown

SCENARIOS = 60
READS = 15
NAMES = (b"left", b"right")
NEWEST = Query(interval=parse_interval(MIN_INSTANT, MAX_INSTANT), match=Match.START, limit=1, newest_first=True)


@pytest.fixture(autouse=True)
def small_windows(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a read load one block or a few blocks in each window, and a few windows for each answer."""
    monkeypatch.setattr(archived_read, "FIRST_WINDOW_BYTES", 1)
    monkeypatch.setattr(archived_read, "WINDOW_BYTES", 300)
    monkeypatch.setattr(archived_read, "ANSWER_BYTES", 12)


class PastGroup:
    """A group of channels in memory, as it was at the instant `as_of`: it gets all changes up to `as_of` in order."""

    def __init__(self, large: dict[bytes, ChannelCore], small: dict[bytes, ArchivedChannel], as_of: int) -> None:
        self.channels = {name: ChannelCore(one.policy, incarnation=7) for name, one in large.items()}
        board = TimesBoard()
        self.cut = GroupCut(GroupDefinition(members=frozenset(NAMES)), board)
        self.cut.confirm()
        own = {name: OwnChannelTimes(channel, 0) for name, channel in self.channels.items()}
        changes = [(at, name, one) for name, past in small.items() for at, one in [*past.offers, *past.advances]]
        for at, name, change in sorted((one for one in changes if one[0] <= as_of), key=lambda one: one[0]):
            if isinstance(change, Offer):
                self.channels[name].put(change, at, lambda first_seq, kept, stamped: b"x")
            else:
                self.channels[name].advance(change, at)
            own[name].observe(at)
            board.enter_own(name, own[name].times(1), at)
            self.cut.refresh(at)


def past_cut(small: dict[bytes, ArchivedChannel], as_of: int) -> PastCut:
    """Compute the cut as a client does. The mark of a member is its newest time or its advance at that instant,
    whichever is later. The cut is the earliest mark.
    """
    marks = []
    for one in small.values():
        found, advance = one.read_as_of(NEWEST, as_of), one.past(as_of).advance
        newest = max((part.last_time for part in found.slices), default=None)
        marks.append(PastMark("member", newest, advance, None if found.slices else lack_of(found), None))
    return past_cut_of(marks)


def lack_of(answer: ReadAnswer) -> Reason | None:
    return answer.reason if answer.reason in (Reason.COLLECTED, Reason.LOST) else None


def cut_of(small: dict[bytes, ArchivedChannel], as_of: int) -> int | None:
    found = past_cut(small, as_of)
    assert found.reason is None
    return None if found.cut == MIN_INSTANT else found.cut


@pytest.mark.parametrize("seed", range(SCENARIOS))
def test_a_past_cut_from_archives_that_have_dropped_items_is_right_or_names_the_missing_items(seed: int) -> None:
    draw = random.Random(seed)
    pairs = {name: put_in_both(draw, advances=True) for name in NAMES}
    large, small = {name: one[0] for name, one in pairs.items()}, {name: one[1] for name, one in pairs.items()}
    for channel in small.values():
        channel.archive()
    first, last = max(one.first_accepted for one in small.values()), max(one[3] for one in pairs.values())
    for _ in range(4):
        draw.choice(list(small.values())).drop_segments(draw.randrange(3))
        for _ in range(3):
            as_of = draw.randrange(first, max(first, last) + 2)
            found, then = past_cut(small, as_of), PastGroup(large, small, as_of).cut.cut
            assert found.cut <= (MIN_INSTANT if then is None else then)
            if found.reason is not None:
                assert found.reason == "COLLECTED"
            elif not any(has_lost_its_newest(one, as_of) for one in small.values()):
                assert found.cut == then


def has_lost_its_newest(channel: ArchivedChannel, as_of: int) -> bool:
    """Whether a dropped item was the latest item at that instant. The kept items do not show this."""
    gone = channel.segments[0].first_seq
    accepted = [(offer.times[0], seq) for seq, (at, offer) in enumerate(channel.offers, 1) if at <= as_of]
    return bool(accepted) and max(accepted)[1] < gone and any(seq >= gone for _, seq in accepted)


@pytest.mark.parametrize("seed", range(SCENARIOS))
def test_a_group_read_as_of_an_instant_equals_the_read_at_that_instant(seed: int) -> None:
    draw = random.Random(seed)
    pairs = {name: put_in_both(draw, advances=True) for name in NAMES}
    large, small = {name: one[0] for name, one in pairs.items()}, {name: one[1] for name, one in pairs.items()}
    for channel in small.values():
        channel.archive()
    first, last = max(one.first_accepted for one in small.values()), max(one[3] for one in pairs.values())
    for _ in range(READS):
        as_of, name = draw.randrange(first, max(first, last) + 2), draw.choice(NAMES)
        then = PastGroup(large, small, as_of)
        cut = cut_of(small, as_of)
        assert cut == then.cut.cut
        query, horizon = query_of(draw, last, pairs[name][2]), Horizon(cut, lambda: "held back by nobody")
        overlap = large[name].policy.overlap_nanos or 0
        try:
            expected = VisibleChannel(then.channels[name]).read(query, horizon, as_of)
        except StampedeError as error:
            with pytest.raises(type(error)):
                small[name].read_in_group_as_of(query, horizon, as_of)
            continue
        found = small[name].read_in_group_as_of(query, horizon, as_of)
        assert shown(found, overlap) == shown(expected, overlap), (query, as_of, cut)
