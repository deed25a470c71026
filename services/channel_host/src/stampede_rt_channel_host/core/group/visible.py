"""The part of a channel that a group shows: the items before the cut (paper, section 3.3). Pure.

A `VisibleChannel` copies nothing; it reads the channel's own index. It answers like a channel that has no hidden
items, and whose clock never passes the cut.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import NamedTuple

from stampede_rt.values.model import Reason
from stampede_rt.values.timeline import Interval, MetaTime, ResolvedInterval, format_instant
from stampede_rt_channel_host.core.channel import (
    ChannelCore,
    ChannelSnapshot,
    HoldingsSnapshot,
    PendingGet,
    Query,
    ReadAnswer,
    Slice,
    WakeAt,
)
from stampede_rt_channel_host.core.channel.holdings import Holdings
from stampede_rt_channel_host.core.channel.index_snapshot import IndexSnapshot
from stampede_rt_channel_host.core.channel.item_keys import FIRST_KEY, LAST_KEY, ItemKey
from stampede_rt_channel_host.core.channel.pieces import Pieces, run_to_end
from stampede_rt_channel_host.core.channel.reading import QueryReader
from stampede_rt_channel_host.core.channel.retention import Retention
from stampede_rt_channel_host.core.channel.selection import ReadableItems, behind, select


class Horizon(NamedTuple):
    """The end of the visible part of a group: the items before `cut` are visible. If `cut` is None, no item is visible.

    `held_by` returns a text that names the members that hold the cut back.
    """

    cut: int | None
    held_by: Callable[[], str]


def end_of(cut: int | None) -> ItemKey:
    """The key below which a group with this cut shows items."""
    return FIRST_KEY if cut is None else (cut, 0)


class VisibleHoldings:
    """The held items before a cut, with the reading methods of `Holdings`. If `cut` is None, there are none."""

    __slots__ = ("_end", "_held", "_last", "frontier", "gone_before", "newest", "oldest", "overlap_nanos")

    def __init__(self, held: Holdings | HoldingsSnapshot, cut: int | None) -> None:
        self._held = held
        self._end = end_of(cut)
        self._last = self._end[0] - 1
        self.frontier = held.frontier
        self.gone_before = held.gone_before
        self.overlap_nanos = held.overlap_nanos
        self.oldest = held.oldest if held.oldest is not None and held.oldest <= self._last else None
        self.newest = None if self.oldest is None else held.last_time_up_to(self._last)

    @property
    def collected_by(self) -> str:
        """See `Holdings`."""
        return self._held.collected_by

    @property
    def end(self) -> ItemKey:
        """A key above the keys of all visible items, and at or below the keys of all hidden items."""
        return self._end

    def snapshot(self) -> IndexSnapshot:
        """All items that the channel holds now, hidden items included."""
        return self._held.snapshot()

    def slices_down(self, low: ItemKey = FIRST_KEY, high: ItemKey = LAST_KEY, /) -> Iterator[Slice]:
        """Visible items at or above `low` and below `high`, the last slice first."""
        return self._held.slices_down(low, min(high, self._end))

    def next_time(self, time: int, /) -> int | None:
        """The time of the next visible bucket after `time`, or None if there is none."""
        following = self._held.next_time(time)
        return following if following is not None and following <= self._last else None

    def last_time_up_to(self, time: int, /) -> int | None:
        """The time of the last visible bucket at or before `time`, or None if there is none."""
        return None if self.oldest is None else self._held.last_time_up_to(min(time, self._last))


class VisibleQueryReader(QueryReader):
    """Answers one query from the part of a channel before a horizon."""

    def __init__(
        self, channel: ChannelCore | ChannelSnapshot, horizon: Horizon, now: int, shown: ReadableItems | None = None
    ) -> None:
        """`now` is the host's clock. The channel first outdates the items that are too old at `now`.

        `shown` are the items before the horizon; None: the items in memory.
        """
        self._all: Holdings | HoldingsSnapshot
        self._all, retention = channel.look(now)
        shown = VisibleHoldings(self._all, horizon.cut) if shown is None else shown
        super().__init__(shown, retention, channel.incarnation, channel.lost_before)
        self.advance, self.consumed_up_to = channel.advanced_to, self._all.newest_consumed
        self.lost_from = channel.lost_from
        self._newest = self._all.newest  # the newest of all items, hidden or not
        self._horizon = horizon
        self._last_read: tuple[Query, ResolvedInterval, int] | None = None

    def now(self, clock: int) -> int:
        """The instant of NOW. If the clock is after the cut, the cut counts instead of the clock."""
        cut = self._horizon.cut
        return super().now(clock if cut is None else min(clock, cut))

    def resolve_interval(self, interval: Interval, clock: int) -> ResolvedInterval | None:
        """The resolved interval, or None. As long as there is no cut, NOW has no instant."""
        if self._horizon.cut is None and MetaTime.NOW in (interval.start.meta, interval.end.meta):
            return None
        return super().resolve_interval(interval, clock)

    def answer(self, query: Query, within: ResolvedInterval | None, clock: int) -> Pieces[ReadAnswer]:
        """The visible items of the query."""
        if within is not None:
            self._last_read = query, within, clock
        return super().answer(query, within, clock)

    def _wake_at(self, first_instant: int, clock: int) -> WakeAt:
        cut = self._horizon.cut
        if cut is None or first_instant > cut:
            return WakeAt(None)  # only a later cut brings an answer; time does not
        return super()._wake_at(first_instant, clock)

    def _is_finished(self, region: ResolvedInterval) -> bool:
        """Whether both the channel and the cut have passed the region."""
        cut = self._horizon.cut
        return cut is not None and cut >= region.end + (not region.end_exclusive) and self._is_passed(region)

    def _is_passed(self, region: ResolvedInterval) -> bool:
        """Whether an item, hidden or not, or an advance has passed the region's end."""
        marks = [mark for mark in (self._newest, self.advance, self.consumed_up_to) if mark is not None]
        return bool(marks) and max(marks) >= region.end + (not region.end_exclusive)

    def _reason(
        self, query: Query, region: ResolvedInterval, complete: bool, truncated: bool, more: bool
    ) -> Reason | None:
        """The reason of a partial answer, or None. Items that the limit cuts off do not make an answer partial, and
        neither do hidden items after them.
        """
        reason = super()._reason(query, region, complete, truncated, more)
        if reason is None and not (more and not query.newest_first) and self._hides():
            return self._hidden()
        return reason

    def _nothing_yet(self, query: Query, region: ResolvedInterval) -> Reason:
        """The reason if no item matches, but one may still come. HIDDEN takes precedence over LOST."""
        if self._is_passed(region) or self._hides():
            return self._hidden()
        return super()._nothing_yet(query, region)

    def _not_yet(self, query: Query, region: ResolvedInterval) -> Reason:
        if self._is_passed(region) or self._hides():
            return self._hidden()
        return super()._not_yet(query, region)

    def _no_anchor(self) -> Reason:
        return super()._no_anchor() if self._newest is None else self._hidden()

    def _hides(self) -> bool:
        """Whether a held item that matches the query lies at or after the cut."""
        assert self._last_read is not None, "set with every answer that gives reasons"
        query, within, clock = self._last_read
        cut, newest = self._horizon.cut, self._newest
        if newest is None or not may_hide(newest, within, cut):
            return False
        full_now = max(clock, newest)
        found = run_to_end(select(self._all, latest_of(query), within, full_now)).slices
        return bool(found) and (cut is None or found[0].last_time >= cut)

    def _hidden(self) -> Reason:
        """The reason HIDDEN, with a text that names the cut and the members that hold it back."""
        cut = self._horizon.cut
        shown = "nothing is visible yet" if cut is None else f"its cut is at {format_instant(cut)}"
        return Reason("HIDDEN", f"the group hides items: {shown}, {self._horizon.held_by()}")


def may_hide(newest: int, within: ResolvedInterval, cut: int | None) -> bool:
    """Whether an item of the interval may lie at or after the cut. `newest`: the time of the newest item."""
    return cut is None or (newest >= cut and within.end >= cut)


def latest_of(query: Query) -> Query:
    """A query for the latest item that `query` selects."""
    if query.newest_first:
        return replace(query, limit=1)
    positions = [one for one in (query.after, query.newer_than) if one is not None]
    newer_than = max(positions, key=behind, default=None)
    return replace(query, limit=1, newest_first=True, after=None, newer_than=newer_than)


class VisibleChannel:
    """The visible part of one channel, with the reading methods of a channel.

    The caller passes the group's horizon to each call. The cut of the horizon may only rise from call to call.
    """

    def __init__(self, channel: ChannelCore) -> None:
        self._channel = channel

    def read(self, query: Query, horizon: Horizon, now: int) -> ReadAnswer:
        """The visible items of the query at `now`. Raises IncarnationLost like `ChannelCore.read`."""
        return run_to_end(self.reading(query, horizon, now))

    def reading(self, query: Query, horizon: Horizon, now: int) -> Pieces[ReadAnswer]:
        """Like `read`, but in pieces. The answer is as of `now`."""
        reading = self._reading(query, horizon, now)
        return reading.answer(query, reading.resolve(query, now), now)

    def begin(self, query: Query, horizon: Horizon, now: int) -> PendingGet:
        """Begin a blocking get; see `ChannelCore.begin`."""
        return PendingGet(query, self._reading(query, horizon, now).resolve(query, now))

    def poll(self, pending: PendingGet, horizon: Horizon, now: int) -> ReadAnswer | WakeAt:
        """The get's answer, or when to poll again. Also poll after each change of the channel and of the cut."""
        return run_to_end(self.polling(pending, horizon, now))

    def polling(self, pending: PendingGet, horizon: Horizon, now: int) -> Pieces[ReadAnswer | WakeAt]:
        """Like `poll`, but in pieces. The result is as of `now`."""
        return polling(self._channel, pending, horizon, now)

    def give_up(self, pending: PendingGet, horizon: Horizon, now: int) -> ReadAnswer:
        """The answer at the end of the get's waiting time, with its reason."""
        return run_to_end(self.giving_up(pending, horizon, now))

    def giving_up(self, pending: PendingGet, horizon: Horizon, now: int) -> Pieces[ReadAnswer]:
        """Like `give_up`, but in pieces. The answer is as of `now`."""
        return VisibleQueryReader(self._channel, horizon, now).answer(pending.query, pending.interval, now)

    def stalled(self, floor: int, horizon: Horizon) -> ReadAnswer:
        """The answer to a reader that has seen the cut `floor`, if this host's cut is still before it.

        The answer has no items.
        """
        cut = horizon.cut
        behind_at = "nothing is visible here yet" if cut is None else f"the cut is at {format_instant(cut)} here"
        detail = f"the reader has seen the group up to {format_instant(floor)}, but {behind_at}, {horizon.held_by()}"
        return ReadAnswer(
            slices=(), next_time=None, interval=None, complete=False, truncated=False, more=False,
            reason=Reason("HIDDEN", detail), incarnation=self._channel.incarnation,
        )  # fmt: skip

    def hidden_items(self, cut: int | None, now: int) -> int:
        """The number of held items that the cut hides."""
        held, _ = self._channel.look(now)
        return held.items - held.items_below(FIRST_KEY if cut is None else (cut, 0))

    def window_too_short(self, cut: int | None, now: int) -> bool:
        """Whether retention has collected items that the group has not shown yet, or will soon do so by max_age."""
        held, retention = self._channel.look(now)
        return _has_lost(held, cut) or _leads_by_more_than_max_age(held, retention, cut)

    def _reading(self, query: Query, horizon: Horizon, now: int) -> VisibleQueryReader:
        reading = VisibleQueryReader(self._channel, horizon, now)
        reading.check_position(query.after)
        reading.check_position(query.newer_than)
        return reading


def polling(
    channel: ChannelCore | ChannelSnapshot, pending: PendingGet, horizon: Horizon, now: int
) -> Pieces[ReadAnswer | WakeAt]:
    """See `VisibleChannel.polling`. The channel may also be a `ChannelSnapshot`."""
    reading = VisibleQueryReader(channel, horizon, now)
    found = yield from reading.poll(pending, now)
    return WakeAt(found.instant, reading.needs(pending)) if isinstance(found, WakeAt) else found


def _has_lost(held: Holdings, cut: int | None) -> bool:
    """Whether age, count or bytes collected an item at or after the cut."""
    gone = held.newest_collected
    return gone is not None and (cut is None or gone >= cut)


def _leads_by_more_than_max_age(held: Holdings, retention: Retention, cut: int | None) -> bool:
    """Whether the newest item is ahead of the cut by more than max_age."""
    age = retention.limits.max_age_nanos
    return age is not None and cut is not None and held.newest is not None and held.newest - cut > age
