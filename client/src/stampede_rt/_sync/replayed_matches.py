# Generated from ../_async by tools/generate.py; do not edit.
"""Matches under a virtual clock: the rule of `Group.match`, over the recorded changes of all members."""

from __future__ import annotations

from bisect import insort
from collections.abc import Sequence
from dataclasses import replace
from types import TracebackType

from stampede_rt._sync.replayed_channel import NEWEST_QUERY, ChangeFeed, ReplayedChannel
from stampede_rt._sync.virtual_clock import VirtualClock
from stampede_rt.errors import Overloaded
from stampede_rt.transports.concurrency_sync import StepLock
from stampede_rt.values.grouping import Matched
from stampede_rt.values.model import Item
from stampede_rt.values.reading import ReadQuery
from stampede_rt.values.timeline import Match, clamp, parse_interval

WAITING_BYTES_MAX = 64 * 2**20
"""The most bytes of items that wait for their match, each with ITEM_BYTES besides its payload."""
ITEM_BYTES = 512


class _Member:
    """One member: its changes, and the times that it has passed as of the last one."""

    def __init__(self, channel: ReplayedChannel, feed: ChangeFeed, newest: int | None) -> None:
        self.channel, self.feed, self.newest = channel, feed, newest

    def has_passed(self, instant: int, lateness_nanos: int) -> bool:
        """Return whether no item can come at or before `instant` (the rule of the host)."""
        by_item = self.newest is not None and self.newest - lateness_nanos >= instant + bool(lateness_nanos)
        return by_item or (self.feed.advance is not None and self.feed.advance > instant)

    def take(self) -> list[Item]:
        """Take the next change."""
        items = self.feed.take()
        self.newest = (
            max((one.time for one in items), default=self.newest)
            if self.newest is None
            else max([self.newest, *(one.time for one in items)])
        )
        return items


class ReplayedMatches:
    """An iterator over `Matched` items (see `Group.match`), and a context manager. The iteration ends with the replay.

    Each step moves the clock to the instant at which the host could have decided the match. `unmatched` and `dropped`
    count as those of a live subscription do. A step raises Overloaded if the items that wait for a match have more than
    WAITING_BYTES_MAX.
    """

    def __init__(
        self,
        clock: VirtualClock,
        channels: Sequence[ReplayedChannel],
        per: ReplayedChannel,
        tolerance_nanos: int,
        lateness_nanos: int,
        *,
        partial: bool,
        payloads: bool,
    ) -> None:
        self._clock, self._channels, self._per = clock, channels, per
        self._tolerance, self._lateness = tolerance_nanos, lateness_nanos
        self._partial, self._payloads = partial, payloads
        self._at = clock.now  # the instant of the last change that was looked at
        self._members: list[_Member] = []
        self._waiting: list[tuple[int, int, Item]] = []  # items of `per` without a match, by time and seq
        self._waiting_bytes = 0
        self._low = (0, 0)  # the key of the last item that was matched
        self._steps = StepLock()  # callers that step at the same time take turns
        self._closed = False
        self.unmatched = 0
        self.dropped = 0

    def __enter__(self) -> ReplayedMatches:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __iter__(self) -> ReplayedMatches:
        return self

    def __next__(self) -> Matched[ReplayedChannel]:
        with self._steps:
            if not self._members:
                self._begin()
            while not self._closed:
                if self._waiting and self._is_decided(self._waiting[0][0]):
                    matched = self._match(self._next_waiting())
                    self.unmatched += bool(matched.missing)
                    if self._partial or not matched.missing:
                        self._clock.reach(self._at)
                        return matched
                elif not self._go_on():
                    break
            raise StopIteration

    def close(self) -> None:
        """End the iteration."""
        self._closed = True

    def _begin(self) -> None:
        for channel in self._channels:
            newest = channel.read_as_of(replace(NEWEST_QUERY, payloads=False), self._at)
            feed = ChangeFeed(channel, newest.past, payloads=self._payloads and channel == self._per)
            self._members.append(_Member(channel, feed, newest[0].time if newest else None))
            if channel == self._per and newest:
                self._low = newest[0].time, newest[0].seq

    def _go_on(self) -> bool:
        """Take the next change of any member. Return False at the end of the replay."""
        due = [(one.feed.next_change, at) for at, one in enumerate(self._members) if one.feed.next_change is not None]
        if not due:
            return False
        instant, at = min(due)
        assert instant is not None, "only members with a change are due"
        member = self._members[at]
        self._at = instant
        items = member.take()
        for item in items if member.channel == self._per else ():
            if (item.time, item.seq) > self._low:
                self._wait_for_match(item)
            else:
                self.dropped += 1
        return True

    def _wait_for_match(self, item: Item) -> None:
        """Keep an item of `per` until its match is decided. Raises Overloaded beyond WAITING_BYTES_MAX."""
        self._waiting_bytes += _bytes_of(item)
        if self._waiting_bytes > WAITING_BYTES_MAX:
            behind = min(self._members, key=lambda one: (one.newest is not None, one.newest or 0)).channel
            raise Overloaded(
                f"the replay would hold more than {WAITING_BYTES_MAX} bytes of items of {self._per.name!r} until "
                f"channel {behind.name!r} has passed their times; match with payloads=False, or without that channel"
            )
        insort(self._waiting, (item.time, item.seq, item), key=lambda one: one[:2])

    def _next_waiting(self) -> Item:
        item = self._waiting.pop(0)[2]
        self._waiting_bytes -= _bytes_of(item)
        return item

    def _is_decided(self, time: int) -> bool:
        """Return whether no item that comes later can change the match of an item at `time`."""
        return all(
            one.has_passed(time if one.channel == self._per else clamp(time + self._tolerance), self._lateness)
            for one in self._members
        )

    def _match(self, item: Item) -> Matched[ReplayedChannel]:
        self._low = item.time, item.seq
        found = {self._per.info.channel_id: item}
        missing: list[ReplayedChannel] = []
        window = parse_interval(clamp(item.time - self._tolerance), clamp(item.time + self._tolerance))
        for channel in (one for one in self._channels if one != self._per):
            query = ReadQuery(window, match=Match.START, payloads=self._payloads)
            items = channel.read_as_of(query, self._at)
            nearest = min(items, key=lambda one: (abs(one.time - item.time), one.time, one.seq), default=None)
            if nearest is None:
                missing.append(channel)
            else:
                found[channel.info.channel_id] = nearest
        return Matched(self._channels, found, missing=missing, time=item.time)


def _bytes_of(item: Item) -> int:
    return ITEM_BYTES + len(item.payload or b"")
