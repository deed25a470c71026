# Generated from ../_async by tools/generate.py; do not edit.
"""Subscriptions under a virtual clock, in the order in which a host accepted the items."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from types import TracebackType
from typing import Protocol, Self

from stampede_rt._sync.batches import Batches
from stampede_rt._sync.change_feed import NEWEST_QUERY, ChangeFeed, PastSource
from stampede_rt._sync.earlier_pages import EarlierPages
from stampede_rt._sync.virtual_clock import VirtualClock
from stampede_rt.errors import DeadlineExceeded
from stampede_rt.handles import BoundToProcess
from stampede_rt.transports.concurrency_sync import StepLock
from stampede_rt.values.answers import ItemBatch, Items, PastState
from stampede_rt.values.model import Item
from stampede_rt.values.reading import ReadQuery, Wait
from stampede_rt.values.seq_starts import given_between
from stampede_rt.values.timeline import ALL_TIME, MAX_INSTANT, Bound, Interval, Match


class ReplayedSteps(BoundToProcess):
    """An iterator over the items of a replayed channel, and a context manager. The iteration ends with the replay.

    Nothing breaks in a replay: `dropped`, `losses` and `reconnects` are 0, and `multicast` is None. `skipped` counts
    the items that mode "newest" left out.
    """

    multicast = None

    def __init__(self) -> None:
        self._steps = StepLock()  # callers that step at the same time take turns
        self._closed = False
        self.skipped = self.dropped = self.losses = self.reconnects = 0

    @property
    def connected(self) -> bool:
        """Whether the iteration may continue."""
        return not self._closed

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> Item:
        with self._steps:
            item = None if self._closed else self._next()
            if item is None:
                raise StopIteration
            return item

    def batches(self) -> Batches:
        """Return an iterator over batches with one item each, because the program sees the items at their instants."""
        return Batches(self._next_batch)

    def _next_batch(self) -> ItemBatch | None:
        try:
            return ItemBatch([[self.__next__()]])
        except StopIteration:
            return None

    def close(self) -> None:
        """End the iteration."""
        self._closed = True

    def _next(self) -> Item | None:
        """Return the next item; None at the end of the replay."""
        raise NotImplementedError


class ReplayedSubscription(ReplayedSteps):
    """All items of a channel, in the order of their acceptance (see `Channel.subscribe`).

    Each step moves the clock to the instant at which the host accepted the item. Raises Overloaded for a `start` or an
    `after` with too many earlier items.
    """

    def __init__(
        self, channel: PastSource, clock: VirtualClock, start: Bound | None, after: Item | None, *, payloads: bool
    ) -> None:
        super().__init__()
        self._channel, self._clock, self._payloads = channel, clock, payloads
        self._begun_at = clock.now
        self._earlier: EarlierPages | None = None
        if start is not None or after is not None:
            interval = ALL_TIME if start is None else Interval(start, Bound(None, MAX_INSTANT))
            query = ReadQuery(interval, match=Match.START, payloads=payloads)
            self._earlier = EarlierPages(channel.name, channel.read_as_of, query, clock.now, after)
        self._ready: deque[tuple[int, Item]] = deque()
        self._feed: ChangeFeed | None = None

    def _next(self) -> Item | None:
        while not self._closed:
            if self._ready:
                instant, item = self._ready[0]
                self._clock.reach(instant)
                self._ready.popleft()  # only after the wait, because a caller may cancel it
                return item
            if not self._fetch():
                break
        return None

    def _fetch(self) -> bool:
        """Fetch the next items. Return False at the end of the replay."""
        if self._feed is None:
            self._feed = ChangeFeed(self._channel, self._begin(), payloads=self._payloads)
        if self._earlier is not None:
            held = self._earlier.take()
            self._earlier = self._earlier if held else None
            self._ready.extend((self._begun_at, one) for one in held)
            return True
        instant = self._feed.next_change
        if instant is None:
            return False
        self._ready.extend([(instant, one) for one in self._feed.take()])
        return True

    def _begin(self) -> PastState | None:
        """Return the facts about the channel at the instant at which the subscription begins."""
        if self._earlier is not None:
            return self._earlier.begin()
        return (self._channel.read_as_of(replace(NEWEST_QUERY, payloads=False), self._begun_at)).past


class WaitingSource(PastSource, Protocol):
    """A channel whose reads may wait for the virtual clock."""

    def read_waiting(self, query: ReadQuery) -> Items:
        """Return the answer. May wait for the clock. Raises DeadlineExceeded if the replay ends before the answer."""


class ReplayedNewest(ReplayedSteps):
    """Always the newest item of a channel (mode "newest" of `Channel.subscribe`)."""

    def __init__(
        self, channel: WaitingSource, clock: VirtualClock, start: Bound | None, after: Item | None, *, payloads: bool
    ) -> None:
        super().__init__()
        self._channel, self._begun_at, self._start = channel, clock.now, start
        self._query = replace(NEWEST_QUERY, payloads=payloads, newer_than=after, wait=Wait(None))
        self._has_begun = after is not None
        self._last_seq = None if after is None else after.seq

    def _next(self) -> Item | None:
        if not self._has_begun:
            self._begin()
        try:
            items = self._channel.read_waiting(self._query)
        except DeadlineExceeded:  # the replay has ended
            return None
        if not items:
            return None
        item = items[0]
        if self._last_seq is not None:
            self.skipped += given_between(self._last_seq + 1, item.seq)
        self._last_seq = max(item.seq, self._last_seq or 0)
        self._query = replace(self._query, newer_than=item)
        return item

    def _begin(self) -> None:
        """Find the item or the instant after which the subscription begins."""
        start = self._start
        query = replace(NEWEST_QUERY, payloads=False)
        if start is not None:
            query = replace(query, interval=Interval(start, start))
        found = self._channel.read_as_of(query, self._begun_at)
        if start is None:
            self._last_seq = found[0].seq if found else None
            self._query = replace(self._query, newer_than=found[0] if found else None)
        elif found.interval is not None:
            self._query = replace(self._query, newer_than=found.interval.start - 1)
        self._has_begun = True
