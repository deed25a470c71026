"""A channel under a virtual clock: each read answers as of the clock's instant."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import replace
from typing import NoReturn, TypeVar

from stampede_rt._async.channel import Channel
from stampede_rt._async.reader import Reader
from stampede_rt._async.reads import read_as_of
from stampede_rt._async.replayed_subscription import ReplayedNewest, ReplayedSteps, ReplayedSubscription
from stampede_rt._async.stream_reconnector import StreamReconnector
from stampede_rt._async.virtual_clock import VirtualClock
from stampede_rt.errors import AheadOfClock, DeadlineExceeded
from stampede_rt.values.answers import Items
from stampede_rt.values.grouping import SeenCut
from stampede_rt.values.model import Item, Reason
from stampede_rt.values.policy import flag_of
from stampede_rt.values.reading import NO_WAIT, ReadQuery, SubscribeMode
from stampede_rt.values.replaying import not_replayed
from stampede_rt.values.timeline import MAX_INSTANT, Bound, BoundLike, fixed, parse_bound
from stampede_rt.wire.subscribing import beginning

Result = TypeVar("Result")

_MAY_COME = (Reason.NOT_YET, Reason.LOST, Reason.HIDDEN)
"""If an answer has one of these reasons, items may still come into its interval."""


class ReplayedChannel(Reader):
    """A recorded channel as it was at the instant of a replay's clock. It has the reads of a channel, and no puts.

    A read that waits moves the clock to the instant at which the host would have answered it.
    """

    def __init__(self, channel: Channel, clock: VirtualClock, end: int, view: SeenCut | None = None) -> None:
        super().__init__(channel._session, channel._state, view)
        self._clock = clock
        self.end = end
        """The instant at which the replay ends."""

    def __getattr__(self, name: str) -> NoReturn:
        raise not_replayed("Channel", name, self)

    @property
    def _is_direct(self) -> bool:
        return False  # shared memory and the host of this process know only the present

    async def _read(self, query: ReadQuery) -> Items:
        wait, start = query.wait, self._clock.now
        query = replace(query, max_staleness_nanos=None, least_seq=None, within_memory=False)
        if query.as_of is not None:
            return await self.read_as_of(query, query.as_of)
        query = replace(query, wait=NO_WAIT)
        deadline = MAX_INSTANT if wait.seconds is None else start + wait.nanos
        instant = start
        while True:
            items = await self.read_as_of(query, instant)
            is_over = items.complete or (items and not query.complete) or items.reason not in _MAY_COME
            if is_over or instant >= deadline:
                await self._clock.reach(instant)
                return items
            query = replace(query, interval=fixed(query.interval, items.interval))
            next_instant = self._wake_at(items, instant)
            if next_instant is None and deadline == MAX_INSTANT:
                raise DeadlineExceeded(f"channel {self.name!r}: the replay has ended, and the read would wait for ever")
            if next_instant is None:
                await self._clock.reach(min(deadline, self.end))
                return items
            instant = min(next_instant, deadline)

    def _wake_at(self, items: Items, instant: int) -> int | None:
        """Return the next instant at which the answer may change; None if the answer stays the same up to the end."""
        found = [] if items.past is None or items.past.next_change is None else [items.past.next_change]
        if items.interval is not None and items.interval.start >= instant:
            found.append(items.interval.start + 1)
        return min((one for one in found if instant < one <= self.end), default=None)

    async def read_waiting(self, query: ReadQuery) -> Items:
        """Return the answer. May wait for the clock. Raises DeadlineExceeded if the replay ends before the answer."""
        return await self._read(query)

    async def read_as_of(self, query: ReadQuery, as_of: int) -> Items:
        """Return the answer as of an instant, or as of the host's clock if that is earlier.

        Raises VersionMismatch if the host does not know the past; Unavailable if the replay is closed.
        """
        self._clock.check_open()
        return await as_known(lambda instant: read_as_of(self._session, self._state, query, instant), as_of)

    def _subscribe(  # type: ignore[override]
        self,
        start: BoundLike | None,
        mode: SubscribeMode,
        after: Item | None,
        payloads: bool,
        reconnecting: StreamReconnector,
        stale_ok: bool = True,
        via: object = None,
    ) -> ReplayedSteps:
        """Subscribe from the clock's instant on. The iteration ends with the replay."""
        position = None if start is None else parse_bound(start, "start")
        beginning(position, mode, after)  # checks the arguments
        flag_of("payloads", payloads)
        if mode == "newest":
            return ReplayedNewest(self, self._clock, position, after, payloads=payloads)
        return self._subscribe_all(position, after, payloads=payloads)

    def _subscribe_all(self, start: Bound | None, after: Item | None, *, payloads: bool) -> ReplayedSteps:
        return ReplayedSubscription(self, self._clock, start, after, payloads=payloads)


async def as_known(read: Callable[[int], Awaitable[Result]], as_of: int) -> Result:
    """Return the answer as of an instant, or as of the host's clock if that is earlier."""
    try:
        return await read(as_of)
    except AheadOfClock as error:  # a wait has moved the replay's clock ahead of the host's
        return await read(int(error.metadata["host_time_unix_nano"]))
