"""Reads, blocking and not, and the reasons of empty and partial answers (paper, section 3.2). Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from stampede_rt.errors import IncarnationLost
from stampede_rt.values.model import Reason
from stampede_rt.values.timeline import Bound, Interval, Match, ResolvedInterval, format_instant
from stampede_rt_channel_host.core.channel.former_incarnations import FormerIncarnation
from stampede_rt_channel_host.core.channel.held_items import ARCHIVE, HeldItems
from stampede_rt_channel_host.core.channel.pieces import Pieces
from stampede_rt_channel_host.core.channel.retention import Retention
from stampede_rt_channel_host.core.channel.run import Slice
from stampede_rt_channel_host.core.channel.selection import ReadableItems, select
from stampede_rt_channel_host.core.channel.single_items import item_at
from stampede_rt_channel_host.core.channel.values import Position, Query, ReadAnswer, WakeAt
from stampede_rt_channel_host.core.channel.waiting import BEFORE_ALL, Needs


class PendingGet:
    """A blocking get that has not ended. `ChannelCore.begin` makes it.

    `interval` is None until the channel can resolve the meta-times of the query's interval.
    """

    __slots__ = ("interval", "query")

    def __init__(self, query: Query, interval: ResolvedInterval | None) -> None:
        self.query = query
        self.interval = interval


class QueryReader:
    """Answers queries from held items. `clock` is the host's time: no held item is too old at this time."""

    __slots__ = (
        "_held", "_incarnation", "_lost_before", "_retention", "advance", "consumed_up_to", "former", "lost_from",
    )  # fmt: skip

    def __init__(
        self, held: ReadableItems, retention: Retention, incarnation: int, lost_before: int | None = None
    ) -> None:
        self._held = held
        self._retention = retention
        self._incarnation = incarnation
        self._lost_before = lost_before  # all items of a lost earlier incarnation lie before this instant
        # No item before this instant was lost, because an archive has all of them. None: any item may be lost.
        self.lost_from: int | None = None
        self.former: tuple[FormerIncarnation, ...] = ()  # incarnations whose positions are valid, too
        self.advance: int | None = None  # the highest instant of an advance
        self.consumed_up_to: int | None = None  # the latest time of a consumed item: the channel has passed this time

    def note_loss(self, lost_before: int | None) -> None:
        """Note that items before this instant may be lost; None: an archive has all items of the earlier
        incarnation.
        """
        self._lost_before = lost_before

    def now(self, clock: int) -> int:
        """The instant of the meta-time NOW: the later of the clock and the newest item's time."""
        return clock if self._held.newest is None else max(clock, self._held.newest)

    def resolve(self, query: Query, clock: int) -> ResolvedInterval | None:
        """The query's interval in instants, or None if it has a meta-time that needs an item and no item is held."""
        return self.resolve_interval(query.interval, clock)

    def resolve_interval(self, interval: Interval, clock: int) -> ResolvedInterval | None:
        """An interval in instants, or None if it has a meta-time that needs an item and no item is held."""
        return interval.resolve(now=self.now(clock), newest=self._held.newest, oldest=self._held.oldest)

    def resolve_bound(self, bound: Bound, clock: int) -> int | None:
        """The instant of one bound, or None if it is a meta-time that needs an item and no item is held."""
        resolved = self.resolve_interval(Interval(bound, bound), clock)
        return None if resolved is None else resolved.start

    def check_position(self, position: Position | None) -> None:
        """Raises IncarnationLost if the position's seq belongs to another incarnation, and its item is not here."""
        if position is None or position.incarnation in (0, self._incarnation):
            return
        former = next((one for one in self.former if one.incarnation == position.incarnation), None)
        if former is None:
            raise IncarnationLost(
                f"the position is of incarnation {position.incarnation:x}, and the channel is incarnation "
                f"{self._incarnation:x} now: the position is another channel's, or its items were lost with the "
                "channel's former host; start again from a time or the newest item"
            )
        if position.seq is not None and position.seq >= former.next_seq:
            raise IncarnationLost(
                f"the item with seq {position.seq} was lost with the channel's former host, and those before seq "
                f"{former.next_seq} are there; start again from one of them, from a time, or from the newest item",
                metadata={"inherited_next_seq": str(former.next_seq)},
            )

    def answer(self, query: Query, within: ResolvedInterval | None, clock: int) -> Pieces[ReadAnswer]:
        """The answer to a query, in pieces. It is as of the first piece."""
        if within is None:
            return self._unresolved()
        region = region_of(query, within)
        truncated = not region.is_empty and self._is_truncated(region)
        complete = self._is_over(region)
        # For an answer in several pieces: the reason if the limit cuts items off, and the reason if it does not.
        reasons: dict[bool, Reason | None] = {}

        def judge() -> None:
            reasons.update({more: self._reason(query, region, complete, truncated, more) for more in (False, True)})

        found = yield from select(self._held, query, within, self.now(clock), judge)
        if not found.slices:
            reason: Reason | None = self._absence(query, region)
        elif not reasons:
            reason = self._reason(query, region, complete, truncated, found.more)
        else:
            reason = reasons[found.more]
        if reason is None and found.more and query.newest_first:
            reason = self._lost_after(found.slices[0].first_time, region)
        return ReadAnswer(
            slices=found.slices,
            next_time=found.next_time,
            interval=within,
            complete=complete,
            truncated=truncated,
            more=found.more,
            reason=reason,
            incarnation=self._incarnation,
            next_times=found.next_times,
        )

    def at(self, time: int, clock: int) -> ReadAnswer | None:
        """The answer to a read at an instant, if it is a single item. None: the caller must use `answer`."""
        held = self._held
        found = item_at(held, time, self.now(clock)) if isinstance(held, HeldItems) else None
        if found is None:
            return None
        within = ResolvedInterval(time, time)
        truncated = self._is_truncated(within)
        reason = self._gone(within) if truncated else None
        complete = self._is_over(within)
        return ReadAnswer((found.part,), found.next_time, within, complete, truncated, False, reason, self._incarnation)

    def reason(self, query: Query, within: ResolvedInterval, slices: Sequence[Slice], *, more: bool) -> Reason | None:
        """The reason of an answer that the caller has put together: why it is empty or partial."""
        region = region_of(query, within)
        if not slices:
            return self._absence(query, region)
        truncated = not region.is_empty and self._is_truncated(region)
        found = self._reason(query, region, self._is_over(region), truncated, more)
        if found is None and more and query.newest_first:
            return self._lost_after(slices[0].first_time, region)
        return found

    def poll(self, pending: PendingGet, clock: int) -> Pieces[ReadAnswer | WakeAt]:
        """The answer if the get is released, or when to poll again."""
        query = pending.query
        if pending.interval is None:
            pending.interval = self.resolve(query, clock)
        within = pending.interval
        if within is None:
            return WakeAt(None)
        over = self._is_over(region_of(query, within))
        if over or not query.complete:
            answer = yield from self.answer(query, within, clock)
            if over or answer.slices:
                return answer
        return self._wake_at(within.start + within.start_exclusive, clock)

    def needs(self, pending: PendingGet) -> Needs:
        """The events that may release the get, apart from the passing of time."""
        if pending.interval is None:
            return Needs(time=BEFORE_ALL)
        region = region_of(pending.query, pending.interval)
        passed = region.end + (not region.end_exclusive)
        if pending.query.complete:
            return Needs(passed)
        if pending.query.match is Match.SPAN:
            return Needs(passed, end=region.start)
        return Needs(passed, time=region.start)

    def _wake_at(self, first_instant: int, clock: int) -> WakeAt:
        """When to poll again: at the interval's first instant, if NOW is before that instant.

        At that instant the span of a newest item without a duration reaches into the interval.
        """
        return WakeAt(first_instant if self.now(clock) < first_instant else None)

    def _unresolved(self) -> ReadAnswer:
        """The answer while a meta-time of the interval cannot be resolved."""
        return ReadAnswer(
            slices=(), next_time=None, interval=None, complete=False, truncated=False, more=False,
            reason=self._no_anchor(), incarnation=self._incarnation,
        )  # fmt: skip

    def _no_anchor(self) -> Reason:
        """The reason why a meta-time cannot be resolved."""
        nothing = "the channel holds no items, so NEWEST and OLDEST have no time yet"
        if self._lost_before is not None:
            return Reason("LOST", f"{nothing}: {self._loss}", self._lost_before)
        return Reason("NOT_YET", nothing)

    def _is_over(self, region: ResolvedInterval) -> bool:
        """Whether no more items can come into the region: an item or an advance has passed the region's end, or the
        region is empty or below the frontier.
        """
        return region.is_empty or self._is_finished(region) or self._is_below_frontier(region)

    def _is_finished(self, region: ResolvedInterval) -> bool:
        """Whether an item or an advance has passed the region's end. The end instant itself passes an exclusive end,
        but not an inclusive one.
        """
        passed = region.end + (not region.end_exclusive)
        newest, advance, consumed = self._held.newest, self.advance, self.consumed_up_to
        return (
            (newest is not None and newest >= passed)
            or (advance is not None and advance >= passed)
            or (consumed is not None and consumed >= passed)
        )

    def _is_below_frontier(self, region: ResolvedInterval) -> bool:
        frontier = self._held.frontier
        return frontier is not None and region.end + (not region.end_exclusive) <= frontier

    def _is_truncated(self, region: ResolvedInterval) -> bool:
        """Whether items at the beginning of the region may be missing, because they were collected or lost."""
        gone_before = self._held.gone_before
        return self._reaches_into_loss(region) or (gone_before is not None and region.start < gone_before)

    def _reaches_into_loss(self, region: ResolvedInterval) -> bool:
        if self._lost_before is None or region.start >= self._lost_before:
            return False
        return self.lost_from is None or region.end >= self.lost_from

    def _lost_after(self, first: int, region: ResolvedInterval) -> Reason | None:
        """The reason if a limit has cut off the items before the time `first`, and later ones were lost."""
        rest = replace(region, start=first, start_exclusive=False)
        return self._lost() if self._reaches_into_loss(rest) else None

    def _reason(
        self, query: Query, region: ResolvedInterval, complete: bool, truncated: bool, more: bool
    ) -> Reason | None:
        """The reason why an answer with items is partial. Items that the limit cut off do not make it partial."""
        if truncated and not (more and query.newest_first):
            return self._gone(region)
        if query.complete and not complete:
            return self._not_yet(query, region)
        return None

    def _absence(self, query: Query, region: ResolvedInterval) -> Reason:
        """The reason why an answer has no items."""
        if region.is_empty:
            if query.after or query.newer_than:
                return Reason("NEVER", "the given position leaves no instant of the interval")
            return Reason("NEVER", "the interval is empty: it contains no instant")
        if self._is_below_frontier(region):
            return self._collected()
        if not self._is_over(region):
            return self._nothing_yet(query, region)
        if self._is_truncated(region):
            return self._gone(region)
        consumed = self.consumed_up_to is not None and self.consumed_up_to >= region.start
        but = ", or all consumers have consumed it" if consumed else ""
        return Reason("NEVER", f"the channel is past the interval, and no matching item was put{but}")

    def _gone(self, region: ResolvedInterval) -> Reason:
        """The reason for a region whose first items may be collected, or lost with an earlier incarnation."""
        gone_before = self._held.gone_before
        return self._collected() if gone_before is not None and region.start < gone_before else self._lost()

    def _lost(self) -> Reason:
        return Reason("LOST", f"{self._loss}; incarnation {self._incarnation:x} began then", self._lost_before)

    @property
    def _loss(self) -> str:
        before = format_instant(self._lost_before or 0)
        return f"the channel's host was lost with the items before {before}"

    def _collected(self) -> Reason:
        held = self._held
        gone_before = held.gone_before or 0
        if held.oldest is not None:  # a part of the oldest bucket may be collected
            gone_before = min(gone_before, held.oldest + held.overlap_nanos + 1)
        before = format_instant(gone_before)
        if held.collected_by == ARCHIVE:
            return Reason(
                "COLLECTED",
                f"the read reaches back only to {before}: the limits of the archive have removed earlier items, "
                "another host has them, or they are not in memory",
            )
        policy = self._retention.limits.describe(held.collected_by)
        return Reason("COLLECTED", f"{policy} has collected the items before {before}")

    def _nothing_yet(self, query: Query, region: ResolvedInterval) -> Reason:
        """The reason if no item matches, but one may still come. If the region begins before a loss, that loss is the
        reason.
        """
        return self._lost() if self._reaches_into_loss(region) else self._not_yet(query, region)

    def _not_yet(self, query: Query, region: ResolvedInterval) -> Reason:
        """The reason while items of the region may still come."""
        passed = region.end + (not region.end_exclusive)
        if self._lost_before is not None and passed <= self._lost_before and self._reaches_into_loss(region):
            return self._lost()
        newest = self._held.newest
        held = "the channel holds no items" if newest is None else f"the newest item is at {format_instant(newest)}"
        return Reason("NOT_YET", f"{held}; items up to {format_instant(region.end)} may still come")


def region_of(query: Query, within: ResolvedInterval) -> ResolvedInterval:
    """The part of the interval that `after` and `newer_than` leave. The answer's reason is about this part."""
    region = within
    if query.newer_than is not None:
        region = _from(region, query.newer_than)
    if query.after is not None and query.newest_first:
        return _up_to(region, query.after.time)
    return region if query.after is None else _from(region, query.after)


def _from(region: ResolvedInterval, position: Position) -> ResolvedInterval:
    """The part of the region from the position on."""
    if position.time < region.start:
        return region
    exclusive = position.seq is None or (region.start_exclusive and position.time == region.start)
    return replace(region, start=position.time, start_exclusive=exclusive)


def _up_to(region: ResolvedInterval, time: int) -> ResolvedInterval:
    """The part of the region before `time`.

    The answer continues newest first after a position in the bucket at `time`. New items of this bucket get higher
    seqs, so they come before that position.
    """
    return replace(region, end=time, end_exclusive=True) if time <= region.end else region
