"""Reads through a group as of an instant answer as the group did then, at the cut that its hosts had reached then."""

from __future__ import annotations

import random

import pytest

from stampede_rt.errors import StampedeError
from stampede_rt.values.timeline import MAX_INSTANT, MIN_INSTANT, Match, parse_interval
from stampede_rt_channel_host.core.archive import archived_read
from stampede_rt_channel_host.core.channel import ChannelCore, Offer, Query
from stampede_rt_channel_host.core.group import (
    GroupCut,
    GroupDefinition,
    Horizon,
    OwnTimes,
    TimesBoard,
    VisibleChannel,
)
from tests.property.archived_channel import ArchivedChannel
from tests.property.test_archive_against_memory import query_of, shown, tell

SCENARIOS = 60
READS = 15
NAMES = (b"left", b"right")
NEWEST = Query(interval=parse_interval(MIN_INSTANT, MAX_INSTANT), match=Match.START, limit=1, newest_first=True)


@pytest.fixture(autouse=True)
def small_windows(monkeypatch: pytest.MonkeyPatch) -> None:
    """Windows of one block or a few, and answers of a few windows."""
    monkeypatch.setattr(archived_read, "FIRST_WINDOW_BYTES", 1)
    monkeypatch.setattr(archived_read, "WINDOW_BYTES", 300)
    monkeypatch.setattr(archived_read, "ANSWER_BYTES", 12)


class Then:
    """A group of channels in memory, as it was at an instant: all changes up to then come one after the other."""

    def __init__(self, large: dict[bytes, ChannelCore], small: dict[bytes, ArchivedChannel], as_of: int) -> None:
        self.channels = {name: ChannelCore(one.policy, incarnation=7) for name, one in large.items()}
        board = TimesBoard()
        self.cut = GroupCut(GroupDefinition(members=frozenset(NAMES)), board)
        self.cut.confirm()
        own = {name: OwnTimes(channel, 0) for name, channel in self.channels.items()}
        changes = [(at, name, one) for name, past in small.items() for at, one in [*past.offers, *past.advances]]
        for at, name, change in sorted((one for one in changes if one[0] <= as_of), key=lambda one: one[0]):
            if isinstance(change, Offer):
                self.channels[name].put(change, at, lambda first_seq, kept, stamped: b"x")
            else:
                self.channels[name].advance(change, at)
            own[name].observe(at)
            board.enter_own(name, own[name].times(1), at)
            self.cut.refresh(at)


def cut_of(small: dict[bytes, ArchivedChannel], as_of: int) -> int | None:
    """The cut as a client computes it: the smallest of the members' newest times and advances of then."""
    cuts = []
    for one in small.values():
        newest, advance = one.read_as_of(NEWEST, as_of).slices, one.past(as_of).advance
        marks = [*(part.last_time for part in newest), *([] if advance is None else [advance])]
        cuts.append(max(marks, default=None))
    return None if None in cuts else min(cut for cut in cuts if cut is not None)


@pytest.mark.parametrize("seed", range(SCENARIOS))
def test_a_group_read_as_of_an_instant_equals_the_read_at_that_instant(seed: int) -> None:
    draw = random.Random(seed)
    told = {name: tell(draw, advances=True) for name in NAMES}
    large, small = {name: one[0] for name, one in told.items()}, {name: one[1] for name, one in told.items()}
    for channel in small.values():
        channel.archive()
    first, last = max(one.first_accepted for one in small.values()), max(one[3] for one in told.values())
    for _ in range(READS):
        as_of, name = draw.randrange(first, max(first, last) + 2), draw.choice(NAMES)
        then = Then(large, small, as_of)
        cut = cut_of(small, as_of)
        assert cut == then.cut.cut
        query, horizon = query_of(draw, last, told[name][2]), Horizon(cut, lambda: "held back by nobody")
        overlap = large[name].policy.overlap_nanos or 0
        try:
            expected = VisibleChannel(then.channels[name]).read(query, horizon, as_of)
        except StampedeError as error:
            with pytest.raises(type(error)):
                small[name].read_in_group_as_of(query, horizon, as_of)
            continue
        found = small[name].read_in_group_as_of(query, horizon, as_of)
        assert shown(found, overlap) == shown(expected, overlap), (query, as_of, cut)
