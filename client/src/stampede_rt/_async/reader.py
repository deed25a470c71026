"""Reads by time, and subscriptions: to a channel, or to a channel as a group shows it (paper, sections 3.2 and 3.3)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal

from stampede_rt._async.calls_here import at_here, may_be_here, newest_here, read_here
from stampede_rt._async.channel_state import ChannelState
from stampede_rt._async.listener import Listener
from stampede_rt._async.reads import read
from stampede_rt._async.ring_reads import ASK_HOST, HostMustAnswer, read_interval, read_newest
from stampede_rt._async.session import Session
from stampede_rt._async.stream_reconnector import StreamReconnector
from stampede_rt._async.subscription import Subscription
from stampede_rt._async.subscription_kinds import kind_of_subscription
from stampede_rt.cluster.tracing import span
from stampede_rt.handles import Reference, handle_repr
from stampede_rt.transports.concurrency_async import monotonic_s
from stampede_rt.values.answers import Items
from stampede_rt.values.grouping import SeenCut
from stampede_rt.values.model import ChannelInfo, Item
from stampede_rt.values.policy import flag_of
from stampede_rt.values.reading import (
    ReadQuery,
    SubscribeMode,
    Wait,
    after_position,
    parse_as_of,
    parse_least_seq,
    parse_limit,
    parse_staleness,
    parse_within,
)
from stampede_rt.values.timeline import (
    ALL_TIME,
    OLDEST,
    Bound,
    BoundLike,
    Bounds,
    DurationLike,
    InstantLike,
    Interval,
    Match,
    MatchLike,
    parse_bound,
    parse_instant,
    parse_interval,
    parse_match,
)

NEWEST = ReadQuery(ALL_TIME, match=Match.START, limit=1, newest_first=True)  # made once: it takes 5 us


class Reader(Reference):
    """A channel that a program reads by time. `view` is the group through which it reads; None: no group."""

    def __init__(self, session: Session, state: ChannelState, view: SeenCut | None = None) -> None:
        self._session = session
        self._state = state
        self._view = view

    @property
    def name(self) -> str:
        """The channel's name."""
        return self._state.info.name

    @property
    def host(self) -> str:
        """The name of the host that owns the channel, as last known."""
        return self._state.info.host

    @property
    def incarnation(self) -> int:
        """The channel's incarnation, as last known. If it changes, items may have been lost."""
        return self._state.info.incarnation

    @property
    def info(self) -> ChannelInfo:
        """The directory's description of the channel, as last known."""
        return self._state.info

    def __eq__(self, other: object) -> bool:
        return type(other) is type(self) and self._identity() == other._identity()

    def __hash__(self) -> int:
        return hash(self._identity())

    def __repr__(self) -> str:
        return handle_repr(type(self).__name__, self.name, self.info.channel_id, self.host, self._session.state)

    def _identity(self) -> tuple[bytes, bytes]:
        return self._state.info.channel_id, self._view.group_id if self._view else b""

    @property
    def _is_direct(self) -> bool:
        """Whether reads may use shared memory, or the host of this process: these know only the present, and no
        groups."""
        return self._view is None

    async def get(
        self,
        start: BoundLike,
        end: BoundLike,
        *,
        bounds: Bounds = "[]",
        match: MatchLike = "span",
        limit: int | None = None,
        newest_first: bool = False,
        after: Item | InstantLike | None = None,
        payloads: bool = True,
        timeout: float | None = 0,
        complete: bool = False,
        max_staleness: DurationLike | None = None,
        least_seq: int | None = None,
        within: Literal["memory"] | None = None,
        as_of: InstantLike | None = None,
    ) -> Items:
        """Return the items in an interval, by default the items whose span shares an instant with it.

        `bounds`: "[]", "[)", "(]" or "()". `match`: "span", "whole" (the whole span is in the interval) or "start"
        (the item's time is in it). `limit` keeps the earliest items, or with `newest_first` the latest. With `after`,
        an item or an instant, the answer has only later items, or with `newest_first` only earlier ones. `timeout` in
        seconds: 0 does not wait, None waits without a limit. The call waits for the first match, or with `complete`
        until no more items can come into the interval. After the timeout it returns the items that are there.

        With `max_staleness`, such as "500ms", a proxy of the channel may answer if its state is at most this old. With
        `least_seq`, such as the seq of the program's own last item, a proxy may answer if it has this item. If no proxy
        can answer, the owner does. `staleness_nanos` of the answer says how old its state may be. `within="memory"`
        reads only the items that the host has in memory, and never waits for the archive of a recorded channel.

        `as_of` is a past instant. The answer is as the host of a recorded channel would have given it at that instant:
        with the items that it had accepted by then and that its archive still holds. With `as_of` state no timeout.
        Raises InvalidInterval, InvalidArgument, IncarnationLost, Unavailable.
        """
        interval = parse_interval(start, end, bounds)
        position = None if after is None else after_position(after)
        return await self._read(
            ReadQuery(
                interval,
                match=parse_match(match),
                limit=parse_limit(limit),
                newest_first=newest_first,
                after=position,
                payloads=payloads,
                wait=Wait.parse(timeout),
                complete=complete,
                max_staleness_nanos=parse_staleness(max_staleness),
                least_seq=parse_least_seq(least_seq),
                within_memory=parse_within(within),
                as_of=parse_as_of(as_of),
            )
        )

    async def at(
        self, time: BoundLike, *, payloads: bool = True, timeout: float | None = 0, as_of: InstantLike | None = None
    ) -> Items:
        """Return the items whose span holds `time`. `timeout` and `as_of` as in `get`."""
        is_plain = payloads is True and timeout == 0 and timeout is not False and as_of is None
        if is_plain and self._session.here is not None and self._is_direct and not isinstance(time, Bound):
            found = at_here(self._session, self._state, parse_instant(time, "time"))
            if found is not None:
                return found
        bound = parse_bound(time, "time")
        return await self._read(
            ReadQuery(
                parse_interval(bound, bound), payloads=payloads, wait=Wait.parse(timeout), as_of=parse_as_of(as_of)
            )
        )

    async def before(
        self, time: BoundLike, *, payloads: bool = True, timeout: float | None = 0, as_of: InstantLike | None = None
    ) -> Item | None:
        """Return the newest item older than `time`, or None. Of several items with one time, return the last accepted.

        `timeout` and `as_of` as in `get`.
        """
        interval = Interval(ALL_TIME.start, parse_bound(time, "time"), end_exclusive=True)
        return await self._read_one(interval, True, None, payloads, timeout, as_of=as_of)

    async def oldest(
        self, *, payloads: bool = True, timeout: float | None = 0, as_of: InstantLike | None = None
    ) -> Item | None:
        """Return the oldest held item, or None. Of several items with one time, return the first accepted.

        `timeout` and `as_of` as in `get`.
        """
        return await self._read_one(ALL_TIME, False, None, payloads, timeout, as_of=as_of)

    async def newest(
        self,
        after: Item | InstantLike | None = None,
        *,
        payloads: bool = True,
        timeout: float | None = 0,
        max_staleness: DurationLike | None = None,
        least_seq: int | None = None,
        as_of: InstantLike | None = None,
    ) -> Item | None:
        """Return the newest item, or None. With `after`, return the item only if it is later than this instant or item.

        `timeout` in seconds: 0 does not wait, None waits without a limit. `max_staleness`, `least_seq` and
        `as_of` as in `get`.
        """
        demand = parse_staleness(max_staleness), parse_least_seq(least_seq)
        position = None if after is None else after_position(after)
        if self._is_direct and payloads is True and as_of is None:
            deadline_s: float | None = 0.0
            if timeout != 0 or timeout is False:
                wait_s = Wait.parse(timeout).seconds
                deadline_s = None if wait_s is None else monotonic_s() + wait_s
            found: Item | HostMustAnswer | None = ASK_HOST
            if not may_be_here(self._session, self._state):
                found = await read_newest(self._session, self._state, position, deadline_s)
            elif position is None:
                found = newest_here(self._session, self._state) or ASK_HOST
            if not isinstance(found, HostMustAnswer):
                return found
            if position is None and deadline_s == 0 and demand == (None, None):
                items = await self._read(NEWEST)
                return items[0] if items else None
            if timeout and deadline_s is not None:
                timeout = max(0.0, deadline_s - monotonic_s())
        return await self._read_one(ALL_TIME, True, position, payloads, timeout, demand, as_of)

    async def _read_one(
        self,
        interval: Interval,
        newest_first: bool,
        newer_than: Item | InstantLike | None,
        payloads: bool,
        timeout: float | None,
        demand: tuple[int | None, int | None] = (None, None),
        as_of: InstantLike | None = None,
    ) -> Item | None:
        items = await self._read(
            ReadQuery(
                interval,
                match=Match.START,
                limit=1,
                newest_first=newest_first,
                newer_than=None if newer_than is None else after_position(newer_than),
                payloads=payloads,
                wait=Wait.parse(timeout),
                max_staleness_nanos=demand[0],
                least_seq=demand[1],
                as_of=parse_as_of(as_of),
            )
        )
        return items[0] if items else None

    async def _read(self, query: ReadQuery) -> Items:
        if self._is_direct and self._session.here is not None:
            items = await read_here(self._session, self._state, query)
            if items is not None:
                return items
        is_plain = query.payloads and query.after is None and query.newer_than is None and query.as_of is None
        if self._is_direct and is_plain:
            found = await read_interval(self._session, self._state, query)
            if not isinstance(found, HostMustAnswer):
                return found
        with span("get", channel=self.name):
            return await read(self._session, self._state, query, self._view)

    def subscribe(
        self,
        start: BoundLike | None = None,
        mode: SubscribeMode = "all",
        after: Item | None = None,
        *,
        payloads: bool = True,
        reconnect: DurationLike | None = None,
        stale_ok: bool = True,
        via: Literal["multicast"] | None = None,
    ) -> Subscription:
        """Subscribe to items as the host accepts them. Returns an iterator that is also a context manager.

        `mode` "all": first the held items from `start` on (None: no held items), then every item that the host accepts
        later, each once. "newest": always the latest item; an earlier item never follows a later one. `after` is the
        last item that the program has, perhaps from another process; the subscription continues after this item.

        This call opens the subscription, and raises its errors. With asyncio the subscription opens when the program
        enters the context, or with the first step. After a broken connection the client tries to open the subscription
        again for the duration `reconnect` (None: without a limit), and continues after the last item. If it cannot, the
        iterator raises Unavailable. Raises InvalidArgument.

        If the channel has proxies, the subscription may be at a proxy, and may move between the owner and the proxies,
        without a gap or a repetition. With `stale_ok` False the owner serves it.

        With `via="multicast"` the items come from UDP multicast if the host sends it and this machine receives it. All
        other items come over the stream (docs/proxies.md). Needs the extra `stampede-rt[multicast]`.
        """
        reconnecting = StreamReconnector(self._session, f"the subscription to channel {self.name!r}", reconnect)
        return self._subscribe(start, mode, after, payloads, reconnecting, flag_of("stale_ok", stale_ok), via)

    def _subscribe(
        self,
        start: BoundLike | None,
        mode: SubscribeMode,
        after: Item | None,
        payloads: bool,
        reconnecting: StreamReconnector,
        stale_ok: bool = True,
        via: object = None,
    ) -> Subscription:
        position = None if start is None else parse_bound(start, "start")
        group_id = self._view.group_id if self._view else None
        return kind_of_subscription(via).begin(
            self._session,
            self._state,
            start=position,
            mode=mode,
            after=after,
            payloads=payloads,
            reconnecting=reconnecting,
            group_id=group_id,
            stale_ok=stale_ok,
        )

    def on_item(
        self,
        fn: Callable[[Item], Any],
        start: BoundLike | None = None,
        mode: SubscribeMode = "all",
        after: Item | None = None,
        *,
        payloads: bool = True,
        reconnect: DurationLike | None = None,
        via: Literal["multicast"] | None = None,
    ) -> Listener:
        """Call `fn` for each item, one call after the other, until `cancel` of the returned handle.

        The other arguments are as in `subscribe`. `fn` runs in a thread or task of the client. The handle logs and
        counts an exception of `fn`, and calls `fn` with the next item. Items wait at the host while `fn` runs;
        `dropped` counts the items that retention collects meanwhile. If the host is lost with its items, the handle
        logs and counts the loss, and continues with the channel's new incarnation. After an outage the handle continues
        after the last item, unless the outage is longer than `reconnect` (None: without a limit). Raises
        InvalidArgument.
        """

        name = f"channel {self.name!r}"

        def subscribe(anew: bool) -> Subscription:
            reconnecting = StreamReconnector(self._session, f"on_item of {name}", reconnect, held=anew)
            if anew:
                return self._subscribe(OLDEST, mode, None, payloads, reconnecting, via=via)
            return self._subscribe(start, mode, after, payloads, reconnecting, via=via)

        return Listener(self._session, name, subscribe, fn)
