"""The part of a recorded channel that a group shows: items of the archive and of memory before the cut. Pure.

`VisibleChannel` does the same for a channel that has all its items in memory.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from stampede_rt.values.timeline import MAX_INSTANT, MIN_INSTANT, Match, ResolvedInterval, parse_interval
from stampede_rt_channel_host.core.archive import ArchivedRead, ArchiveSpan, ArchiveWindow, needs_archive, reaches
from stampede_rt_channel_host.core.archive.recorded_items import RecordedItems, earliest, latest
from stampede_rt_channel_host.core.channel import ChannelSnapshot, Position, Query, ReadAnswer
from stampede_rt_channel_host.core.channel.holdings import Holdings
from stampede_rt_channel_host.core.channel.index import ChannelIndex
from stampede_rt_channel_host.core.channel.index_snapshot import IndexSnapshot
from stampede_rt_channel_host.core.channel.item_keys import ItemKey
from stampede_rt_channel_host.core.channel.pieces import Pieces, run_to_end
from stampede_rt_channel_host.core.channel.reading import region_of
from stampede_rt_channel_host.core.channel.selection import behind
from stampede_rt_channel_host.core.group.visible import Horizon, VisibleQueryReader, end_of, latest_of, may_hide

_EVERYTHING = parse_interval(MIN_INSTANT, MAX_INSTANT)
_NO_WINDOW = ArchiveWindow(ChannelIndex(), None, None, None)


class _ShownItems:
    """Items of a window and of memory before a cut, with the reading methods of `Holdings` (`ReadableItems`).

    `newest` is the time of the last item before the cut, whether it is in the archive or in memory.
    """

    def __init__(self, items: RecordedItems, cut: int | None, newest: int | None) -> None:
        self._items = items
        self._last = end_of(cut)[0] - 1
        self.newest = newest
        self.oldest = None if newest is None else items.oldest
        self.end: ItemKey = min(items.end, end_of(cut))
        self.frontier = items.frontier
        self.gone_before = items.gone_before
        self.overlap_nanos = items.overlap_nanos
        self.collected_by = items.collected_by

    def snapshot(self) -> IndexSnapshot:
        """See `ReadableItems`: hidden items included."""
        return self._items.snapshot()

    def next_time(self, time: int) -> int | None:
        """The time of the next bucket after `time` and before the cut, or None if there is none."""
        following = self._items.next_time(time)
        return following if following is not None and following <= self._last else None

    def last_time_up_to(self, time: int) -> int | None:
        """The time of the last bucket at or before `time` and before the cut, or None if there is none."""
        return self._items.last_time_up_to(min(time, self._last))


class _WindowQueryReader(VisibleQueryReader):
    """Answers from one window, with the facts about the hidden items of all windows."""

    def __init__(self, moment: ChannelSnapshot, shown: _ShownItems, view: RecordedView) -> None:
        super().__init__(moment, view.horizon, moment.clock, shown)
        self._newest = view.newest_of_all
        self._view = view

    def _hides(self) -> bool:
        return self._view.hides


class _VisibleRead(ArchivedRead):
    """A read of the archive and of memory before the cut."""

    def __init__(
        self, moment: ChannelSnapshot, span: ArchiveSpan, query: Query, within: ResolvedInterval, view: RecordedView
    ) -> None:
        super().__init__(moment, span, query, within)
        end = end_of(view.horizon.cut)
        self._border, self._last_instant = min(self._border, end), min(self._last_instant, end[0] - 1)
        self._start = min(self._start, end[0] - 1)  # the span of the last visible item may reach into the interval
        self._view = view

    def _reading_of(self, items: RecordedItems) -> VisibleQueryReader:
        return self._view.reading_of(items)

    def take(self, window: ArchiveWindow) -> Pieces[None]:
        """See `ArchivedRead`. A hidden bucket ends no span."""
        return super().take(self._shown(window))

    def _bounded(self, window: ArchiveWindow, edge: int) -> ArchiveWindow:
        return self._shown(super()._bounded(window, edge))

    def _shown(self, window: ArchiveWindow) -> ArchiveWindow:
        following = window.following
        hidden = following is not None and (following, 0) >= end_of(self._view.horizon.cut)
        return window._replace(following=None) if hidden else window


class RecordedView:
    """One read of a recorded channel through a group, as of `moment`.

    Order of use: the caller performs each read of `reads`, one after the other. Then `answer` is the answer, and
    `released_by` says at which cut a waiting read may get another answer. `within` is the resolved interval; None: a
    meta-time has no instant yet. `continues` says whether the answer was cut off for its length. `missing_items` is the
    number of items that the archive lacks. The caller closes the moment.
    """

    answer: ReadAnswer

    def __init__(self, moment: ChannelSnapshot, span: ArchiveSpan, query: Query, horizon: Horizon) -> None:
        self.horizon = horizon
        self.continues = self.hides = False
        self.missing_items = 0
        self.within: ResolvedInterval | None = None
        self.released_by: int | None = None
        """The cut at which the answer changes because of archived items; None: only items in memory can change the
        answer.
        """
        self._moment, self._span, self._query = moment, span, query
        self._held, _ = moment.look(0)
        self._newest: int | None = None  # the time of the last item before the cut
        self.newest_of_all = latest(self._held.newest, span.newest)

    def reads(self, within: ResolvedInterval | None, *, waits: bool = False) -> Iterator[ArchivedRead]:
        """The reads to perform. `within`: the interval if it is resolved already. `waits`: also set `released_by`."""
        yield from self._look_for_newest()
        has_dropped = self._span.has_dropped(self._moment.lost_before, self._moment.lost_from)
        items = RecordedItems(self._held, self._span, _NO_WINDOW, has_dropped=has_dropped)
        reading, clock = self.reading_of(items), self._moment.clock
        self.within = within = within or reading.resolve(self._query, clock)
        if within is None:
            self.answer = run_to_end(reading.answer(self._query, None, clock))
            self.released_by = None if self._span.oldest is None else self._span.oldest + 1
            return
        yield from self._look_for_hidden(within)
        read = _VisibleRead(self._moment, self._span, self._query, within, self)
        yield read
        self.answer, self.continues, self.missing_items = read.answer(), read.continues, read.missing_items
        if waits and not self.answer.complete:
            yield from self._look_for_release(within)

    def reading_of(self, items: RecordedItems) -> VisibleQueryReader:
        """A reading of some items."""
        return _WindowQueryReader(self._moment, _ShownItems(items, self.horizon.cut, self._newest), self)

    def _look_for_newest(self) -> Iterator[ArchivedRead]:
        """Find the last item before the cut. If memory has none, it is in the archive."""
        cut, oldest = self.horizon.cut, self._span.oldest
        self._newest = None if cut is None else self._held.last_time_up_to(cut - 1)
        if cut is None or oldest is None or oldest >= cut or self._newest is not None:
            return
        within = ResolvedInterval(MIN_INSTANT, cut, end_exclusive=True)
        query = Query(interval=_EVERYTHING, match=Match.START, limit=1, newest_first=True)
        read = ArchivedRead(self._moment, self._span, query, within)
        yield read
        self._newest = max((one.last_time for one in read.answer().slices), default=None)

    def _look_for_hidden(self, within: ResolvedInterval) -> Iterator[ArchivedRead]:
        """Find out whether an item that matches lies at or after the cut."""
        cut, newest = self.horizon.cut, self.newest_of_all
        if newest is None or not may_hide(newest, within, cut):
            return
        read = ArchivedRead(self._moment, self._span, latest_of(self._query), within)
        yield read
        self.hides = any(cut is None or one.last_time >= cut for one in read.answer().slices)

    def _look_for_release(self, within: ResolvedInterval) -> Iterator[ArchivedRead]:
        """Find the cut that shows the next item, or that ends an interval whose items have left memory."""
        query, cut, frontier = self._query, self.horizon.cut, self._held.frontier
        if frontier is None:
            return
        found = []
        if not query.complete:
            read = self._next_hidden(within)
            yield read
            found = [one.first_time + 1 for one in read.answer().slices if one.first_time < frontier]
            first = within.start + within.start_exclusive
            if query.match is Match.SPAN and (cut is None or cut < first <= frontier):
                found.append(first)  # the span of the last visible item may reach into the interval
        region = region_of(query, within)
        passed = region.end + (not region.end_exclusive)
        found += [passed] if passed <= frontier else []
        self.released_by = min(found, default=None)

    def _next_hidden(self, within: ResolvedInterval) -> ArchivedRead:
        """A read of the next item at or after the cut.

        If spans decide, any item counts; otherwise only a matching one.
        """
        cut = self.horizon.cut
        shown = None if cut is None else Position(cut - 1)
        if self._query.match is not Match.START:
            query = Query(interval=_EVERYTHING, match=Match.START, limit=1, newer_than=shown)
            return ArchivedRead(self._moment, self._span, query, ResolvedInterval(MIN_INSTANT, MAX_INSTANT))
        positions = [self._query.newer_than, None if self._query.newest_first else self._query.after, shown]
        newer_than = max((one for one in positions if one is not None), key=behind, default=None)
        query = replace(self._query, limit=1, newest_first=False, after=None, newer_than=newer_than)
        return ArchivedRead(self._moment, self._span, query, within)


def reaches_archive(held: Holdings, span: ArchiveSpan, query: Query, horizon: Horizon, now: int) -> bool:
    """Whether a read through a group may need items that only the archive has or lacks. `held`: the items in memory."""
    cut = horizon.cut
    newest = None if cut is None else held.last_time_up_to(cut - 1)
    if cut is None or newest is None:
        return span.oldest is not None or held.newest is None or held.newest_collected is not None
    clock = max(min(now, cut), newest)
    within = query.interval.resolve(now=clock, newest=newest, oldest=earliest(held.oldest, span.oldest))
    return within is not None and (reaches(held, cut - 1) or needs_archive(held, span, query, within))
