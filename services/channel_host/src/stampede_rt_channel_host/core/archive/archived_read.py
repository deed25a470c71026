"""A read of a recorded channel: window by window from the archive, and then from memory. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

from stampede_rt.values.model import Reason
from stampede_rt.values.timeline import MAX_INSTANT, MIN_INSTANT, Match, MetaTime, ResolvedInterval, format_instant
from stampede_rt_channel_host.core.archive.doubts import Doubt
from stampede_rt_channel_host.core.archive.holes import Hole, WindowReach
from stampede_rt_channel_host.core.archive.recorded_items import ArchiveSpan, RecordedItems, earliest, latest
from stampede_rt_channel_host.core.archive.window import ArchiveWindow, ChosenBlocks, WantedItems
from stampede_rt_channel_host.core.channel.channel_snapshot import ChannelSnapshot, HoldingsSnapshot
from stampede_rt_channel_host.core.channel.holdings import Holdings
from stampede_rt_channel_host.core.channel.index import ChannelIndex
from stampede_rt_channel_host.core.channel.item_keys import FIRST_KEY, LAST_KEY, SEQ_END, ItemKey
from stampede_rt_channel_host.core.channel.limits import ChannelLimits
from stampede_rt_channel_host.core.channel.pieces import Pieces
from stampede_rt_channel_host.core.channel.reading import QueryReader
from stampede_rt_channel_host.core.channel.run import Slice
from stampede_rt_channel_host.core.channel.values import Query, ReadAnswer

FIRST_WINDOW_BYTES = 2**18
WINDOW_BYTES = 2**20
ANSWER_BYTES = 4 * 2**20
"""One answer usually has at most this many bytes of the archive. The reader asks for the rest of a longer answer."""


def resolved(moment: ChannelSnapshot, span: ArchiveSpan, query: Query) -> ResolvedInterval | None:
    """The interval of a query over archive and memory, or None if it has a meta-time that needs an item."""
    held, _ = moment.look(0)
    return resolved_now(held, span, query, moment.clock)


def resolved_now(
    held: Holdings | HoldingsSnapshot, span: ArchiveSpan, query: Query, clock: int
) -> ResolvedInterval | None:
    """The interval of a query over an archive and the items `held`. `clock` is the host's clock."""
    newest = latest(held.newest, span.newest)
    now = clock if newest is None else max(clock, newest)
    return query.interval.resolve(now=now, newest=newest, oldest=earliest(held.oldest, span.oldest))


def reaches(held: Holdings | HoldingsSnapshot, start: int) -> bool:
    """Whether an interval that begins at `start` may select items that have left memory.

    The span of an item without a duration lasts until the next bucket, even if this bucket came after the item had left
    memory. So the span of the newest collected item may last until the first later bucket in memory.
    """
    split = held.newest_collected  # memory may have a part of the bucket of the newest collected item
    if held.newest is None or split is None:
        return held.newest is None
    following = held.next_time(split)
    return following is None or start < max(following, split + held.overlap_nanos)


def needs_archive(held: Holdings | HoldingsSnapshot, span: ArchiveSpan, query: Query, within: ResolvedInterval) -> bool:
    """Whether memory alone may give another answer than archive and memory together. `within`: the interval, resolved
    over both.

    Memory gives another answer if the interval may select items that have left memory, or if a bound is OLDEST and the
    oldest item has left memory: memory then resolves this bound to another instant.
    """
    if reaches(held, within.start):
        return True
    is_from_oldest = MetaTime.OLDEST in (query.interval.start.meta, query.interval.end.meta)
    return is_from_oldest and earliest(held.oldest, span.oldest) != held.oldest


class WantedWindow(NamedTuple):
    """The next window to load: the argument of `choose`, and the keys of the window's items (`window_of`).

    `limits` are the channel's; None: the reader does not ask where the archive may lack items. `with_instants`: the
    reader asks when the host accepted the items.
    """

    wanted: WantedItems
    low: ItemKey
    high: ItemKey
    limits: ChannelLimits | None = None
    with_instants: bool = False


def reach_of(window: WantedWindow, chosen: ChosenBlocks) -> WindowReach:
    """The times at which a window looks, once its blocks are chosen."""
    wanted, edge = window.wanted, chosen.edge
    low = wanted.start if wanted.from_time is None else wanted.from_time
    if wanted.down:
        return WindowReach(low if edge is None else edge, wanted.high[0], window.high[0])
    return WindowReach(low, wanted.high[0] if edge is None else edge, window.high[0])


class ArchivedRead:
    """One read of an archive and of memory, as of `moment`.

    Order of use: `begin`. While `next_window` returns a window to load, load it and call `take`. Then `answer`, and the
    caller closes the moment. `continues` says whether the answer was cut off for its length: the reader asks again for
    the items after its last one.
    """

    def __init__(self, moment: ChannelSnapshot, span: ArchiveSpan, query: Query, within: ResolvedInterval) -> None:
        self.continues = False
        self.within = within
        self.missing_items = 0  # the items that are missing from the answer because the archive lacks them
        self._moment, self._span, self._query, self._within = moment, span, query, within
        self._held, self._retention = moment.look(0)
        self._has_dropped = span.has_dropped(moment.lost_before, moment.lost_from)
        # the read needs no archived items from `_border` on, and ignores holes after `_last_instant`
        self._border, self._last_instant = self._held.floor, within.end
        self._start = within.start  # the read needs the items from here on, and the bucket before
        self._items_left = query.limit
        self._pages: list[Sequence[Slice]] = []
        self._last: ReadAnswer | None = None
        self._reading: QueryReader | None = None
        self._next_time: int | None = None
        self._next_times: dict[ItemKey, int] = {}
        self._bytes = 0
        self._holes: set[Hole] = set()  # the holes in the interval
        self._doubts: set[Doubt] = set()  # the doubts in the interval
        self._more = self._is_done = False
        self._earlier_to: int | None = None  # the greatest time of the items that came before the archive's first one
        self._edge: int | None = None  # where the next window begins
        self._lowest: int | None = self._held.oldest  # downwards: the earliest time of the windows so far
        self._windows = 0  # the number of windows read so far
        self._memory_windows = 0  # the number of these windows that had no archived items

    def begin(self) -> Pieces[None]:
        """Read memory first if it may have all wanted items: if the interval begins within memory, or if the read goes
        downwards and so takes the latest items first.
        """
        archived, in_memory = self._held.newest_collected, self._held.newest is not None
        if self._within.is_empty or not reaches(self._held, self._start):
            yield from self.take(ArchiveWindow(ChannelIndex(), None, None, None))
        elif self._query.newest_first and in_memory and archived is not None and archived >= self._start:
            yield from self.take(ArchiveWindow(ChannelIndex(), archived, None, None))
            self._memory_windows = 1

    def next_window(self) -> WantedWindow | None:
        """The next window to load, or None if the read has all its items."""
        if self._is_done:
            return None
        size = WINDOW_BYTES if self._windows > self._memory_windows else FIRST_WINDOW_BYTES
        if self._query.newest_first:
            return self._window_down(size)
        within, query, border = self._within, self._query, self._border
        starts = [one.time for one in (query.after, query.newer_than) if one is not None]
        from_time, low = max(starts, default=None), FIRST_KEY
        if self._edge is not None:
            from_time, low = self._edge, (self._edge, 0)
        high = min(border, (within.end, SEQ_END))
        wanted = WantedItems(self._start, high, self._held.overlap_nanos, size, from_time)
        return WantedWindow(wanted, low, border, self._retention.limits)

    def _window_down(self, size: int) -> WantedWindow:
        within, query, border = self._within, self._query, self._border
        high = min(border, (within.end, SEQ_END))
        if self._windows > self._memory_windows:
            high = border = min(border, (self._edge or 0, SEQ_END))
        if query.after is not None:
            high = min(high, (max(query.after.time, within.start), SEQ_END))
        wanted = WantedItems(self._start, high, self._held.overlap_nanos, size, down=True)
        return WantedWindow(wanted, FIRST_KEY, border, self._retention.limits)

    def take(self, window: ArchiveWindow) -> Pieces[None]:
        """Read the items of a window, which lies after the windows so far."""
        if self._query.newest_first and self._edge is not None:
            window = self._bounded(window, self._edge)
        searching_more = self._items_left == 0
        query = replace(self._query, limit=1) if searching_more else replace(self._query, limit=self._items_left)
        reading = self._reading_of(RecordedItems(self._held, self._span, window, has_dropped=self._has_dropped))
        clock = self._moment.clock
        clock = clock if query.now is None else min(clock, query.now)
        answer = yield from reading.answer(query, self._within, clock)
        self._windows += 1
        first, last = self._within.start, self._last_instant
        self._earlier_to = self._earlier_to if window.earlier_to is None else window.earlier_to
        self._holes.update(one for one in window.holes if one.start <= last and one.end >= first)
        self._doubts.update(one for one in window.doubts if one.start <= last and one.end >= first)
        self._last, self._reading = answer, reading
        if searching_more:
            self._more = bool(answer.slices)
        else:
            self._add_page(answer)
            self._more = answer.more
        self._decide_next_window(window)

    def _reading_of(self, items: RecordedItems) -> QueryReader:
        reading = QueryReader(items, self._retention, self._moment.incarnation, self._moment.lost_before)
        reading.lost_from = self._moment.lost_from
        reading.advance = self._moment.advanced_to
        return reading

    def _bounded(self, window: ArchiveWindow, edge: int) -> ArchiveWindow:
        """Bound a window: it ends with the bucket at `edge`, because the read has all later items already."""
        lowest = self._lowest if self._lowest != edge else None  # equal: memory has a part of the bucket
        later = (lowest, window.following, self._held.next_time(edge))
        following = min((one for one in later if one is not None), default=None)
        return window._replace(following=following, end=min(self._held.floor, (edge, SEQ_END)))

    def _add_page(self, answer: ReadAnswer) -> None:
        if not answer.slices:
            return
        if not self._query.newest_first or not self._pages:
            self._next_time = answer.next_time
        self._pages.append(answer.slices)
        self._next_times.update(answer.next_times)
        if self._held.overlap_nanos and answer.next_time is not None:
            self._next_times[answer.slices[-1].last_time, answer.slices[-1].end_seq] = answer.next_time
        self._bytes += sum(len(one.run.body) for one in answer.slices)
        if self._items_left is not None:
            self._items_left -= sum(one.items for one in answer.slices)

    def _decide_next_window(self, window: ArchiveWindow) -> None:
        """Decide whether the read needs another window."""
        if window.edge is not None and self._items_left == 0 and self._selects(window.edge):
            self._more = True
        self._is_done = window.edge is None or self._more
        if self._is_done:
            return
        first = next(window.items.slices(FIRST_KEY, LAST_KEY), None)
        if first is not None:
            self._lowest = first.first_time
        self._edge = window.edge
        if self._bytes >= ANSWER_BYTES and self._items_left != 0:
            self._is_done = self.continues = self._more = True

    def _selects(self, time: int) -> bool:
        """Whether the read surely selects an item at `time`, the edge of a window. The archive has an item there."""
        query = self._query
        if query.match is Match.WHOLE or time not in self._within:
            return False
        above = query.newer_than is None or time > query.newer_than.time
        return above and (query.after is None or not query.newest_first or time < query.after.time)

    def answer(self) -> ReadAnswer:
        """The whole answer, after the last window."""
        last, reading = self._last, self._reading
        assert last is not None, "at least one window was read"
        assert reading is not None, "each window was read by a `QueryReader`"
        pages = reversed(self._pages) if self._query.newest_first else self._pages
        slices = [one for page in pages for one in page]
        reason = self._lack_reason(slices)
        if reason is None:
            reason = reading.reason(self._query, self._within, slices, more=self._more)
        following = self._next_time
        return last._replace(
            slices=slices, next_time=following, more=self._more, reason=reason, next_times=self._next_times,
            truncated=last.truncated or reason == "COLLECTED",
        )  # fmt: skip

    def _lack_reason(self, slices: Sequence[Slice]) -> Reason | None:
        """The reason of an answer that lacks items because the archive lacks them, or None. `slices`: the items of the
        answer.

        If the limit has cut the answer off, holes beyond its last item do not count.
        """
        first, last = self._within.start, self._last_instant
        if self._more and slices and self._query.newest_first:
            first = slices[0].first_time
        elif self._more and slices:
            last = slices[-1].last_time
        lacking = {one for one in self._holes if one.start <= last and one.end >= first}
        if not lacking:
            doubts = {one for one in self._doubts if one.start <= last and one.end >= first}
            return _doubted(doubts) or self._dropped_reason(first)
        self.missing_items = count = sum(one.items for one in lacking)
        start, end = min(one.start for one in lacking), max(one.end for one in lacking)
        if not count:
            return Reason(
                "LOST",
                f"the archive may lack items {_when(start, end)}: the channel's "
                "host was lost before it had archived them",
                _after(end),
            )
        return Reason(
            "LOST",
            f"the archive lacks {count} items {_when(start, end)}: max_bytes "
            "collected them before they were archived, or their block or file is damaged or removed",
            _after(end),
        )

    def _dropped_reason(self, first: int) -> Reason | None:
        """The reason of an answer from `first` on that may lack dropped items, or None.

        The archive drops the items that were accepted first. Some of them may have later times than items that it has.
        """
        starts = [one.time for one in (self._query.after, self._query.newer_than) if one is not None]
        first = first if self._query.newest_first else max([first, *starts])
        if self._earlier_to is None or not self._has_dropped or first > self._earlier_to or self._within.is_empty:
            return None
        until = format_instant(self._earlier_to)
        return Reason("COLLECTED", f"the archive lacks items at or before {until}: they came before its first item")


def _doubted(doubts: set[Doubt]) -> Reason | None:
    """The reason of an answer that may lack items whose times are not known, or None."""
    if not doubts:
        return None
    start, end = min(one.start for one in doubts), max(one.end for one in doubts)
    return Reason(
        "LOST",
        f"the archive lacks {sum(one.items for one in doubts)} items whose times are not known. They were "
        f"{_when(start, end)} if they came as late, or as early, as the limits allow",
        _after(end),
    )


def _when(start: int, end: int) -> str:
    """The times from `start` up to `end` as words."""
    if start == MIN_INSTANT:
        return f"at or before {format_instant(end)}"
    return f"between {format_instant(start)} and {format_instant(end)}"


def _after(last: int) -> int | None:
    """The instant after `last`; None after the last one of all."""
    return last + 1 if last < MAX_INSTANT else None
