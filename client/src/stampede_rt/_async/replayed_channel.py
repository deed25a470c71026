"""A channel under a virtual clock: each read answers as of the clock's instant."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from types import TracebackType
from typing import Any

from stampede_rt._async.channel import Channel
from stampede_rt._async.earlier_pages import EarlierPages
from stampede_rt._async.reader import Reader
from stampede_rt._async.reads import read
from stampede_rt._async.virtual_clock import VirtualClock
from stampede_rt.errors import AheadOfClock, DeadlineExceeded, InvalidArgument, VersionMismatch
from stampede_rt.transports.concurrency_async import StepLock
from stampede_rt.values.model import Item, Items, PastState, Reason
from stampede_rt.values.policy import flag_of
from stampede_rt.values.reading import NO_WAIT, ReadQuery, SubscribeMode
from stampede_rt.values.timeline import (
    ALL_TIME,
    MAX_INSTANT,
    BoundLike,
    Interval,
    Match,
    fixed,
    parse_bound,
    parse_interval,
)

_MAY_COME = (Reason.NOT_YET, Reason.LOST)  # the reasons for which items may still come into the interval
NEWEST_QUERY = ReadQuery(ALL_TIME, match=Match.START, limit=1, newest_first=True)


class ReplayedChannel(Reader):
    """A recorded channel as it was at the instant of a replay's clock. It has the reads of a
    channel, and no puts.

    A read that waits moves the clock to the instant at which the host would have answered it.
    """

    def __init__(self, channel: Channel, clock: VirtualClock, end: int) -> None:
        super().__init__(channel._session, channel._state)
        self._channel = channel
        self._clock = clock
        self.end = end
        """The instant at which the replay ends."""

    async def newest(  # type: ignore[override]
        self, after: Item | int | None = None, *, payloads: bool = True, timeout: float | None = 0, **_: Any
    ) -> Item | None:
        """Return the newest item, or None (see `Channel.newest`)."""
        return await self._read_one(ALL_TIME, True, after, payloads, timeout)

    async def _read(self, query: ReadQuery) -> Items:
        wait, begun = query.wait, self._clock.now
        query = replace(query, wait=NO_WAIT, max_staleness_nanos=None, least_seq=None, within_memory=False)
        if query.as_of is not None:
            return await self.read_as_of(query, query.as_of)
        deadline = MAX_INSTANT if wait.seconds is None else begun + wait.nanos
        instant = begun
        while True:
            items = await self.read_as_of(query, instant)
            is_over = items.complete or (items and not query.complete) or items.reason not in _MAY_COME
            if is_over or instant >= deadline:
                await self._clock.reach(instant)
                return items
            query = replace(query, interval=fixed(query.interval, items.interval))
            following = self._wake_at(items, instant)
            if following is None and deadline == MAX_INSTANT:
                raise DeadlineExceeded(f"channel {self.name!r}: the replay has ended, and the read would wait for ever")
            if following is None:
                await self._clock.reach(min(deadline, self.end))
                return items
            instant = min(following, deadline)

    def _wake_at(self, items: Items, instant: int) -> int | None:
        """Return the next instant at which the answer may change; None if the answer stays the same up to the end."""
        found = [] if items.past is None or items.past.next_change is None else [items.past.next_change]
        if items.interval is not None and items.interval.start >= instant:
            found.append(items.interval.start + 1)
        return min((one for one in found if instant < one <= self.end), default=None)

    async def read_as_of(self, query: ReadQuery, as_of: int) -> Items:
        """Return the answer as of an instant, or as of the host's clock if that is earlier.

        Raises VersionMismatch if the host does not know the past.
        """
        try:
            items = await read(self._session, self._state, replace(query, as_of=as_of))
        except AheadOfClock as error:  # a wait has moved the replay's clock ahead of the host's
            known = int(error.metadata["host_time_unix_nano"])
            items = await read(self._session, self._state, replace(query, as_of=known))
        if items.past is None:
            raise VersionMismatch(f"the host of channel {self.name!r} does not know as_of; upgrade the host")
        return items

    def subscribe(  # type: ignore[override]
        self,
        start: BoundLike | None = None,
        mode: SubscribeMode = "all",
        after: Item | None = None,
        *,
        payloads: bool = True,
        **_: Any,
    ) -> ReplayedSubscription:
        """Subscribe from the clock's instant on (see `Channel.subscribe`). The iteration ends with the replay.

        Raises InvalidArgument for a mode other than "all", and for `after`.
        """
        if mode != "all" or after is not None:
            raise InvalidArgument(
                'a replayed subscription has mode="all" and no `after`; use start=, or newest(after=)'
            )
        bound = None if start is None else parse_bound(start, "start")
        query = replace(NEWEST_QUERY, payloads=False)
        if bound is not None:
            interval = Interval(bound, parse_bound(MAX_INSTANT, "end"))
            query = ReadQuery(interval, match=Match.START, payloads=flag_of("payloads", payloads))
        return ReplayedSubscription(self, self._clock, query, holds=bound is not None, payloads=payloads)


class ChangeFeed:
    """The changes of a channel after an instant, one after the other, in the order of their acceptance."""

    def __init__(self, channel: ReplayedChannel, past: PastState | None, *, payloads: bool) -> None:
        self.channel = channel
        self._past = past
        self._payloads = payloads

    @property
    def next_change(self) -> int | None:
        """The instant of the next change; None if no change follows in the replay."""
        following = None if self._past is None else self._past.next_change
        return following if following is not None and following <= self.channel.end else None

    @property
    def advance(self) -> int | None:
        """The highest advance as of the last change."""
        return None if self._past is None else self._past.advance

    async def take(self) -> list[Item]:
        """Return the items of the next change, in the order of their seqs; none if it is an advance."""
        instant = self.next_change
        assert instant is not None, "the caller has looked at next_change"
        found = None if self._past is None else self._past.next_items
        if found is None:
            items = await self.channel.read_as_of(replace(NEWEST_QUERY, payloads=False), instant)
            self._past = items.past
            return []
        first_seq, start, end = found
        query = ReadQuery(parse_interval(start, end), match=Match.START, payloads=self._payloads)
        items = await self.channel.read_as_of(query, instant)
        self._past = items.past
        return sorted((one for one in items if one.seq >= first_seq), key=lambda one: one.seq)


class ReplayedSubscription:
    """An iterator over the items of a replayed channel, in the order of their acceptance. A context manager.

    Each step moves the clock to the instant at which the host accepted the item. The iteration ends with the replay.
    Raises Overloaded for a `start` with too many earlier items.
    """

    def __init__(
        self, channel: ReplayedChannel, clock: VirtualClock, held: ReadQuery, *, holds: bool, payloads: bool
    ) -> None:
        self._channel, self._clock, self._payloads = channel, clock, payloads
        self._newest = None if holds else held
        self._earlier = EarlierPages(channel.name, channel.read_as_of, held, clock.now) if holds else None
        self._begun_at = clock.now
        self._ready: deque[tuple[int, Item]] = deque()
        self._feed: ChangeFeed | None = None
        self._steps = StepLock()  # callers that step at the same time take turns
        self._closed = False

    async def __aenter__(self) -> ReplayedSubscription:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __aiter__(self) -> ReplayedSubscription:
        return self

    async def __anext__(self) -> Item:
        async with self._steps:
            while not self._closed:
                if self._ready:
                    instant, item = self._ready[0]
                    await self._clock.reach(instant)
                    self._ready.popleft()  # after the wait, which a caller may cancel
                    return item
                if not await self._fetch():
                    break
            raise StopAsyncIteration

    async def _fetch(self) -> bool:
        """Fetch the next items. Return False at the end of the replay."""
        if self._feed is None:
            self._feed = ChangeFeed(self._channel, await self._begin(), payloads=self._payloads)
        if self._earlier is not None:
            held = await self._earlier.take()
            self._earlier = self._earlier if held else None
            self._ready.extend((self._begun_at, one) for one in held)
            return True
        instant = self._feed.next_change
        if instant is None:
            return False
        self._ready.extend([(instant, one) for one in await self._feed.take()])
        return True

    async def _begin(self) -> PastState | None:
        """Return the facts about the channel at the instant at which the subscription begins."""
        if self._earlier is not None:
            return await self._earlier.begin()
        assert self._newest is not None, "without earlier items the query asks for the newest one"
        return (await self._channel.read_as_of(self._newest, self._begun_at)).past

    def close(self) -> None:
        """End the iteration."""
        self._closed = True
