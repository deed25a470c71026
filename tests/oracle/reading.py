"""The oracle's reads: the items that match, their order, and the reason of an empty or partial answer."""

from __future__ import annotations

from dataclasses import dataclass

from stampede_rt.values.timeline import Bound, Interval, Match, MetaTime, ResolvedInterval
from stampede_rt_channel_host.core.channel import Position, Query
from tests.oracle.channel import Item, OracleChannel
from tests.oracle.instants import Instants


@dataclass(frozen=True)
class OracleAnswer:
    """The answer to a read. Items ascend. `ends` are the ends of their spans; None for an open span."""

    items: list[Item]
    ends: list[int | None]
    interval: ResolvedInterval | None
    complete: bool
    truncated: bool
    more: bool
    reason: str | None


class OracleReader:
    """Reads of one channel at one reading of the host's clock."""

    def __init__(self, channel: OracleChannel, clock: int) -> None:
        channel.age(clock)
        self.channel, self.clock = channel, clock

    def resolve(self, query: Query) -> ResolvedInterval | None:
        """The interval in instants; None if a bound has no instant yet."""
        channel, interval = self.channel, query.interval
        anchors = {None: 0, MetaTime.NOW: channel.now(self.clock)}
        anchors |= {MetaTime.NEWEST: channel.newest, MetaTime.OLDEST: channel.oldest}
        start, end = anchors[interval.start.meta], anchors[interval.end.meta]
        if start is None or end is None:
            return None
        start, end = _int64(start + interval.start.offset), _int64(end + interval.end.offset)
        return ResolvedInterval(start, end, interval.start_exclusive, interval.end_exclusive)

    def instant_of(self, bound: Bound) -> int | None:
        """The instant of one bound; None if it has none yet."""
        resolved = self.resolve(Query(interval=Interval(bound, bound)))
        return None if resolved is None else resolved.start

    def matches(self, item: Item, within: Instants, match: Match) -> bool:
        """Whether the item matches by its span, by its start, or with its whole span."""
        if match is Match.START:
            return within.holds(item.time)
        if match is Match.SPAN:
            return self.channel.span(item, self.clock).shares_an_instant_with(within)
        end = self.channel.known_end(item, self.clock)  # an open newest item counts as [time, now)
        at_an_instant = end == item.time
        return Instants(item.time, end, high_closed=at_an_instant).lies_in(within)

    def read(self, query: Query, interval: ResolvedInterval | None) -> OracleAnswer:
        if interval is None:
            unresolved = "NOT_YET" if self.channel.lost_before is None else "LOST"
            return OracleAnswer([], [], None, False, False, False, unresolved)
        found = [item for item in self.channel.held if self.matches(item, Instants.of(interval), query.match)]
        found = [item for item in found if self._is_asked_for(item, query)]
        chosen = found
        if query.limit is not None:
            chosen = found[-query.limit :] if query.newest_first else found[: query.limit]
        more = len(chosen) < len(found)
        region = _remaining(query, interval)
        reaches_back = self._starts_below_frontier(region) or self._reaches_into_loss(region)
        truncated = not Instants.of(region).is_empty and reaches_back
        return OracleAnswer(
            items=chosen,
            ends=[self.channel.end(item) for item in chosen],
            interval=interval,
            complete=self.is_over(query, interval),
            truncated=truncated,
            more=more,
            reason=self._reason(query, region, bool(chosen), more, truncated),
        )

    def _is_asked_for(self, item: Item, query: Query) -> bool:
        if query.newer_than is not None and not _is_later(item, query.newer_than):
            return False
        if query.after is None:
            return True
        return _is_earlier(item, query.after) if query.newest_first else _is_later(item, query.after)

    def is_over(self, query: Query, interval: ResolvedInterval) -> bool:
        """Whether no further item can come into the answer."""
        region = _remaining(query, interval)
        return Instants.of(region).is_empty or self._is_below_frontier(region) or self._is_finished(region)

    def _is_finished(self, region: ResolvedInterval) -> bool:
        """Whether no item can come into the interval any more.

        That is so if an item or an advance is at or past an exclusive end, or past an inclusive end. Consumed items
        count, too.
        """
        bounds = (self.channel.newest, self.channel.advanced_to)
        marks = [*(mark for mark in bounds if mark is not None), *self.channel.consumed_times]
        return any(mark >= region.end if region.end_exclusive else mark > region.end for mark in marks)

    def _is_below_frontier(self, region: ResolvedInterval) -> bool:
        """Whether all instants of the interval are earlier than the frontier."""
        frontier = self.channel.frontier
        if frontier is None:
            return False
        return region.end <= frontier if region.end_exclusive else region.end < frontier

    def _starts_below_frontier(self, region: ResolvedInterval) -> bool:
        gone_before = self.channel.gone_before
        return gone_before is not None and region.start < gone_before

    def _reaches_into_loss(self, region: ResolvedInterval) -> bool:
        """Whether the interval begins before the present incarnation did."""
        return self.channel.lost_before is not None and region.start < self.channel.lost_before

    def _is_before_loss(self, region: ResolvedInterval) -> bool:
        lost = self.channel.lost_before
        return lost is not None and (region.end <= lost if region.end_exclusive else region.end < lost)

    def _reason(self, query: Query, region: ResolvedInterval, found: bool, more: bool, truncated: bool) -> str | None:
        finished = self._is_finished(region)
        gone = "COLLECTED" if self._starts_below_frontier(region) else "LOST"
        unfinished = "LOST" if self._is_before_loss(region) else "NOT_YET"
        if found and truncated and not (more and query.newest_first):
            return gone
        if found:
            return unfinished if query.complete and not finished and not Instants.of(region).is_empty else None
        if Instants.of(region).is_empty:
            return "NEVER"
        if self._is_below_frontier(region) or (finished and truncated):
            return gone
        if finished:
            return "NEVER"
        return "LOST" if self._reaches_into_loss(region) else "NOT_YET"


class OracleGet:
    """A blocking get. The host resolves its meta-times at the first moment at which all of them have instants."""

    def __init__(self, query: Query) -> None:
        self.query = query
        self.interval: ResolvedInterval | None = None

    def poll(self, reader: OracleReader) -> OracleAnswer | None:
        """The answer, if the get is released now; else None.

        A matching item releases the get; with `complete`, the end of the interval does. If no further item can match,
        the get is always released.
        """
        if self.interval is None:
            self.interval = reader.resolve(self.query)
        if self.interval is None:
            return None
        answer = reader.read(self.query, self.interval)
        released = answer.complete or (bool(answer.items) and not self.query.complete)
        return answer if released else None

    def give_up(self, reader: OracleReader) -> OracleAnswer:
        return reader.read(self.query, self.interval)

    def wake_at(self, reader: OracleReader) -> int | None:
        """The first whole nanosecond of the interval, if it is in the future."""
        if self.interval is None:
            return None
        first = self.interval.start + 1 if self.interval.start_exclusive else self.interval.start
        return first if first > reader.channel.now(reader.clock) else None


def _is_later(item: Item, position: Position) -> bool:
    if position.seq is None:
        return item.time > position.time
    return (item.time, item.seq) > (position.time, position.seq)


def _is_earlier(item: Item, position: Position) -> bool:
    if position.seq is None:
        return item.time < position.time
    return (item.time, item.seq) < (position.time, position.seq)


def _remaining(query: Query, interval: ResolvedInterval) -> ResolvedInterval:
    """The part of the interval into which the answer can still get items: the interval cut at the query's positions.

    An ascending answer continues in the bucket of the position, because later items of this bucket get higher seqs. A
    descending answer continues before that bucket.
    """
    start, start_open = interval.start, interval.start_exclusive
    end, end_open = interval.end, interval.end_exclusive
    lower = [query.newer_than] if query.newest_first else [query.newer_than, query.after]
    for position in lower:
        if position is not None and (position.time, position.seq is None) > (start, start_open):
            start, start_open = position.time, position.seq is None
    if query.newest_first and query.after is not None and query.after.time <= end:
        end, end_open = query.after.time, True
    return ResolvedInterval(start, end, start_open, end_open)


def _int64(instant: int) -> int:
    return max(-(2**63), min(2**63 - 1, instant))
