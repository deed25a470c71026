# Generated from ../_async by tools/generate.py; do not edit.
"""A subscription through a group under a virtual clock: the items come as the cut shows them."""

from __future__ import annotations

from collections import deque
from dataclasses import replace

from stampede_rt._sync.change_feed import NEWEST_QUERY, ChangeFeed
from stampede_rt._sync.earlier_pages import EarlierPages
from stampede_rt._sync.group_members import GroupMembers
from stampede_rt._sync.past_cuts import counting_members, cut_as_of
from stampede_rt._sync.replayed_channel import ReplayedChannel, as_known
from stampede_rt._sync.replayed_subscription import ReplayedSteps
from stampede_rt._sync.virtual_clock import VirtualClock
from stampede_rt.values.model import Item
from stampede_rt.values.past import PastMark, past_cut_of
from stampede_rt.values.reading import ReadQuery
from stampede_rt.values.timeline import MIN_INSTANT, Bound, Interval, Match, clamp, parse_interval

PAGE_ITEMS = 16


class _Follower:
    """One channel: its changes, and how far it has come."""

    def __init__(self, channel: ReplayedChannel, counts: bool) -> None:
        self.channel, self.counts = channel, counts
        self.feed = ChangeFeed(channel, None, payloads=False)
        self._newest: int | None = None

    def begin(self, as_of: int) -> None:
        found = self.channel.read_as_of(replace(NEWEST_QUERY, payloads=False), as_of)
        self.feed = ChangeFeed(self.channel, found.past, payloads=False)
        self._newest = found[0].time if found else None

    def take(self) -> list[Item]:
        items = self.feed.take()
        known = [] if self._newest is None else [self._newest]
        self._newest = max([*known, *(one.time for one in items)], default=None)
        return items

    @property
    def mark(self) -> PastMark:
        return PastMark(self.channel.name, self._newest, self.feed.advance, None, None)


class ReplayedVisible(ReplayedSteps):
    """All items of a channel, in the order in which the group shows them.

    Each step moves the clock to the instant at which the cut showed the item. Late items come with the change at which
    the host accepted them.
    """

    def __init__(
        self, shown: ReplayedChannel, own: ReplayedChannel, group: GroupMembers, clock: VirtualClock,
        start: Bound | None, after: Item | None, *, payloads: bool,
    ) -> None:  # fmt: skip
        super().__init__()
        self._shown, self._own, self._group, self._clock = shown, own, group, clock
        self._start, self._after, self._payloads = start, after, payloads
        self._at = clock.now  # the instant of the last change that was looked at
        self._cut = MIN_INSTANT  # the client has fetched the items before this instant
        self._seen: int = MIN_INSTANT  # the group's cut as of `_at`
        self._page_after: Item | None = None  # the last item of the previous page, while the cut shows many items
        self._late: EarlierPages | None = None
        self._followers: list[_Follower] = []
        self._ready: deque[Item] = deque()

    def _next(self) -> Item | None:
        if not self._followers:
            self._begin()
        while not self._closed:
            if self._ready:
                self._clock.reach(self._at)
                return self._ready.popleft()
            if self._late is not None:
                self._ready.extend(self._late.take())
                self._late = self._late if self._ready else None
            elif self._cut < self._seen:
                self._show()
            elif not self._take_next_change():
                break
        return None

    def _begin(self) -> None:
        """Find the cut at the beginning of the subscription, and how far the members had come by then."""
        group, at = self._group, self._at
        self._seen = self._cut = (as_known(lambda instant: cut_as_of(group, instant), at)).cut
        start, after = self._start, self._after
        if start is not None:
            query = ReadQuery(Interval(start, start), match=Match.START, limit=1, payloads=False)
            found = (self._shown.read_as_of(query, at)).interval
            self._cut = self._cut if found is None else min(self._cut, found.start)
        elif after is not None:
            self._cut = min(self._cut, clamp(after.time + 1))
            query = ReadQuery(parse_interval(MIN_INSTANT, self._cut, "[)"), match=Match.START, payloads=self._payloads)
            self._late = EarlierPages(self._own.name, self._own.read_as_of, query, at, after)
            self._late.begin()
        counting = counting_members(group)
        others = [one for one in counting if one.info.channel_id != self._own.info.channel_id]
        followers = [_Follower(ReplayedChannel(one, self._clock, self._own.end), True) for one in others]
        followers.append(_Follower(self._own, len(others) < len(counting)))
        for one in followers:
            one.begin(at)
        self._followers = followers

    def _show(self) -> None:
        """Fetch the next items that the cut shows."""
        span = parse_interval(self._cut, self._seen, "[)")
        query = ReadQuery(span, match=Match.START, limit=PAGE_ITEMS, after=self._page_after, payloads=self._payloads)
        items = self._own.read_as_of(query, self._at)
        self._ready.extend(items)
        self._page_after = items[-1] if items.more else None
        if not items.more:
            self._cut = self._seen

    def _take_next_change(self) -> bool:
        """Take the earliest of the next changes of all members. Returns False at the end of the replay."""
        due = [(one.feed.next_change, at) for at, one in enumerate(self._followers) if one.feed.next_change is not None]
        if not due:
            return False
        instant, at = min(due)
        assert instant is not None, "only members with a change are due"
        follower = self._followers[at]
        items = follower.take()
        self._at = instant
        if follower.channel is self._own:
            self._take_late([one for one in items if one.time < self._cut])
        self._seen = max(self._seen, past_cut_of([one.mark for one in self._followers if one.counts]).cut)
        return True

    def _take_late(self, items: list[Item]) -> None:
        """Fetch late items, with times before the cut."""
        for one in items:
            query = ReadQuery(parse_interval(one.time, one.time), match=Match.START, payloads=self._payloads)
            found = self._own.read_as_of(query, self._at)
            self._ready.extend(item for item in found if item.seq == one.seq)
