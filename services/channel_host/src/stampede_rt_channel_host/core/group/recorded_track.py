"""The track of a recorded member: the items below the items in memory come from its archive, page by page. Pure.

A search that needs archived items raises ItemsNotLoaded. The caller performs the reads of the error, and searches
again.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Generator, Iterable, Iterator
from dataclasses import replace
from functools import partial

from stampede_rt.errors import Overloaded
from stampede_rt.matching.key_track import nearer
from stampede_rt.values.seq_starts import given_between
from stampede_rt.values.timeline import MAX_INSTANT, Bound, Interval, Match, clamp, parse_interval
from stampede_rt_channel_host.core.archive import ArchivedRead
from stampede_rt_channel_host.core.channel import ChannelCore, DeliveredSlice, Position, Query, Slice
from stampede_rt_channel_host.core.channel.holdings import Holdings
from stampede_rt_channel_host.core.channel.index import ChannelIndex
from stampede_rt_channel_host.core.channel.item_keys import FIRST_KEY, LAST_KEY, SEQ_END, ItemKey
from stampede_rt_channel_host.core.group.loss_counter import split_at
from stampede_rt_channel_host.core.group.tracks import NearestItem, one_by_one

KEYS_MAX = 2**18
"""The most keys that a track holds, about 25 MB. Only `unique` with a large tolerance needs more than a page or two."""
PAGE_KEYS_MAX = 2**13
"""The most keys that a track takes from one read: about 3 ms of work. A page of 4 MiB may have 300,000 tiny items."""
Reads = Generator[Query, ArchivedRead, None]
"""Reads of an archive: the caller performs each query, and sends the performed read."""

_UPWARDS = Query(interval=parse_interval(0, MAX_INSTANT), match=Match.START)


class ItemsNotLoaded(Exception):
    """A search needs archived items of `channel_id`. `reads` load them."""

    def __init__(self, channel_id: bytes, reads: Callable[[], Reads]) -> None:
        super().__init__("archived items are not loaded")
        self.channel_id = channel_id
        self.reads = reads


class RecordedTrack:
    """The items of a recorded member at this host. Of the archived items, the track holds the keys of one interval.

    Archived items are below the floor of the channel. No item comes below the floor any more, so the loaded keys of the
    interval stay complete.
    """

    def __init__(self, channel: ChannelCore, channel_id: bytes, *, is_ascending: bool = False) -> None:
        """`is_ascending`: no search is for an earlier time than the search before. Then a page or two are enough."""
        self._channel = channel
        self._channel_id = channel_id
        self._is_ascending = is_ascending
        self._keys: list[ItemKey] = []
        self._low, self._end = LAST_KEY, FIRST_KEY  # `_keys` are all keys from `_low` up to `_end`, exclusive

    def nearest(
        self, time: int, tolerance: int, now: int, low: ItemKey = FIRST_KEY, high: ItemKey = LAST_KEY
    ) -> NearestItem | None:
        """See `Track`. Raises ItemsNotLoaded."""
        held, _ = self._channel.look(now)
        middle = time, SEQ_END
        earlier = self._last_below(held, min(high, middle), max(low, (time - tolerance, 0)))
        later = self._first_from(held, max(low, middle), min(high, (time + tolerance + 1, 0)))
        if self._is_ascending and earlier is not None:
            self.forget_before(earlier[0])
        found = nearer(time, earlier and earlier[0], later and later[0], tolerance)
        key = None if found is None else self._first_from(held, max(low, (found, 0)), high)
        if key is None:
            return None
        if key < held.floor:
            return NearestItem(*key, None, is_archived=True)
        return NearestItem(*key, next(one_by_one(held.slices(key), held.next_time)))

    def forget_before(self, time: int) -> None:
        """See `Track`."""
        self._low = max(self._low, (time, 0))
        del self._keys[: bisect_left(self._keys, self._low)]

    def _last_below(self, held: Holdings, high: ItemKey, low: ItemKey) -> ItemKey | None:
        """The last key from `low` up to `high`, exclusive; None if there is none."""
        part = next(held.slices_down(max(low, held.floor), high), None) if high > max(low, held.floor) else None
        if part is not None:
            return part.last_time, part.end_seq - 1
        high = min(high, held.floor)
        if high <= low:
            return None
        at = bisect_left(self._keys, high)
        if not self._low <= high <= self._end or (at == 0 and self._low > low):
            raise ItemsNotLoaded(self._channel_id, lambda: self._load(high, low, held.floor))
        return self._keys[at - 1] if at and self._keys[at - 1] >= low else None

    def _first_from(self, held: Holdings, low: ItemKey, high: ItemKey) -> ItemKey | None:
        """The first key from `low` up to `high`, exclusive; None if there is none."""
        end = min(high, held.floor)
        if low < end:
            if not self._low <= low <= self._end:
                raise ItemsNotLoaded(self._channel_id, lambda: self._load(low, low, held.floor))
            at = bisect_left(self._keys, low)
            if at < len(self._keys):
                return self._keys[at] if self._keys[at] < high else None
            if self._end < end:
                raise ItemsNotLoaded(self._channel_id, lambda: self._extend(held.floor))
        part = next(held.slices(max(low, held.floor), high), None) if max(low, held.floor) < high else None
        return None if part is None else (part.first_time, part.first_seq)

    def _load(self, high: ItemKey, low: ItemKey, floor: ItemKey) -> Reads:
        """Load the last bucket from `low` on before the time of `high`, and all keys from there up to `high`.

        If the track has an interval, the interval grows, unless the searches are ascending. The search for one item may
        load earlier and later keys in turn. It ends, because each load makes the interval larger.
        """
        if self._is_ascending:
            self._keys, self._low, self._end = [], LAST_KEY, FIRST_KEY
        if self._low <= self._end < high:
            while self._end < min(high, floor):
                yield from self._extend(floor)
            return
        begin = low[0]
        if begin < high[0]:
            down = replace(_between(begin, high[0]), limit=1, newest_first=True)
            begin = max([begin, *(one.last_time for one in (yield down).answer().slices)])
        rest, rest_low, rest_end = self._keys, self._low, self._end
        self._keys, self._low, self._end = [], (begin, 0), (begin, 0)
        load_end = rest_low if rest_low <= rest_end else min(high, floor)
        while self._end < load_end:
            yield from self._extend(floor)
        if rest_low <= self._end < rest_end:
            self._keys += rest[bisect_left(rest, self._end) :]
            self._end = rest_end

    def _extend(self, floor: ItemKey) -> Reads:
        """Load the next keys after the interval, up to `floor`. Raises Overloaded if there are too many."""
        after = Position(self._keys[-1][0], self._keys[-1][1]) if self._keys and self._end > self._keys[-1] else None
        answer = (yield replace(_up_to(self._end[0], floor), after=after, limit=PAGE_KEYS_MAX)).answer()
        slices = [split_at(part, floor)[0] for part in answer.slices]
        found = ((part.run.times[at], part.run.first_seq + at) for part in slices for at in range(part.lo, part.hi))
        self._keys += [key for key in found if key >= self._end]
        self._end = (self._keys[-1][0], self._keys[-1][1] + 1) if answer.more and self._keys else floor
        if len(self._keys) > KEYS_MAX:
            self._keys, self._low, self._end = [], LAST_KEY, FIRST_KEY
            raise Overloaded(
                f"a match needs more than {KEYS_MAX} archived items of one member at a time; use a smaller tolerance, "
                "or leave unique=True out"
            )


class RecordedOwnTrack(RecordedTrack):
    """The items of the matched channel, if it is recorded. Holds one page of archived items.

    `lacked` counts two kinds of items: items that the archive lacks between the read items, and items that the limits
    of the archive have removed. It finds the removed items by their seqs after the last decided item. If items came
    out of order, the number may therefore be a little wrong.
    """

    def __init__(self, channel: ChannelCore, channel_id: bytes, kept_from: Callable[[], int]) -> None:
        """`kept_from` returns a seq: neither the archive nor memory has an item with a lower seq."""
        super().__init__(channel, channel_id)
        self._kept_from = kept_from
        self._counted_to = 0  # the removed items with a lower seq are counted
        self.missing_items = 0
        self._page = ChannelIndex()
        self._begin, self._page_end = LAST_KEY, FIRST_KEY  # the page has all items between these keys
        self._last_time = FIRST_KEY[0]  # the time of the last bucket of the page
        self._following: int | None = None  # the time of the archived bucket after the page; None: memory follows

    def one_by_one(self, low: ItemKey, now: int) -> Iterator[DeliveredSlice]:
        """The items from `low` on, one by one, up to the end of the page. Raises ItemsNotLoaded if no page has them."""
        held, _ = self._channel.look(now)
        if low >= held.floor:
            return one_by_one(held.slices(low), held.next_time)
        # memory may have collected items since: then the page does not show when the spans of its last bucket end
        is_behind = self._following is None and self._page_end < held.floor
        end = (self._last_time, 0) if is_behind else self._page_end
        covers = self._begin <= low < end and (not is_behind or next(self._page.slices(low, end), None) is not None)
        if not covers:
            raise ItemsNotLoaded(self._channel_id, lambda: self._load_page(low, held.floor))
        return self._ones_of_page(low, end, held)

    def _ones_of_page(self, low: ItemKey, end: ItemKey, held: Holdings) -> Iterator[DeliveredSlice]:
        yield from one_by_one(self._page.slices(low, end), partial(self._next_time, held))
        if end >= held.floor:
            yield from one_by_one(held.slices(self._page_end), held.next_time)

    def _next_time(self, held: Holdings, time: int) -> int | None:
        found = self._page.next_time(time)
        if found is not None and (found, 0) < self._page_end:
            return found
        return held.next_time(time) if self._following is None else self._following

    def _load_page(self, low: ItemKey, floor: ItemKey) -> Reads:
        after = Position(low[0], low[1] - 1) if low[1] else None
        read = yield replace(_up_to(low[0], floor), after=after)
        answer, self._page = read.answer(), ChannelIndex()
        self.missing_items += read.missing_items
        if low[1]:  # otherwise no item is decided yet
            self._count_removed(max(low[1], self._counted_to), self._kept_from(), answer.slices)
        runs = {part.run.first_seq: part.run for part in answer.slices if split_at(part, floor)[0].items}
        for first_seq in sorted(runs):
            self._page.insert(runs[first_seq])
        self._begin, self._page_end, self._following = low, floor, None
        kept = (split_at(part, floor)[0] for part in answer.slices)
        self._last_time = max((part.last_time for part in kept if part.items), default=low[0])
        if read.continues and answer.slices:
            last = answer.slices[-1]
            if (last.last_time, last.end_seq) < floor:
                self._page_end, self._following = (last.last_time, last.end_seq), answer.next_time

    def _count_removed(self, first: int, end: int, slices: Iterable[Slice]) -> None:
        """Count the seqs from `first` up to `end`, exclusive, that are not among the slices."""
        given = sum(max(0, min(one.end_seq, end) - max(one.first_seq, first)) for one in slices)
        self.missing_items += max(0, given_between(first, end) - given)
        self._counted_to = max(self._counted_to, end)


def _between(start: int, end: int) -> Query:
    """A query for the items from `start` up to `end`, exclusive."""
    return replace(_UPWARDS, interval=Interval(Bound(None, clamp(start)), Bound(None, clamp(end)), end_exclusive=True))


def _up_to(start: int, floor: ItemKey) -> Query:
    """A query for the items from `start` on, up to the bucket of `floor`."""
    return replace(_UPWARDS, interval=Interval(Bound(None, clamp(start)), Bound(None, clamp(floor[0]))))


def archived_item(time: int, seq: int) -> Query:
    """A query for the one item with this time and seq."""
    return replace(_between(time, time), interval=parse_interval(time, time), after=Position(time, seq - 1), limit=1)


def found_item(read: ArchivedRead) -> DeliveredSlice | None:
    """The item that the read found; None if the archive has lost it."""
    answer = read.answer()
    part = next(iter(answer.slices), None)
    return None if part is None else DeliveredSlice(Slice(part.run, part.lo, part.lo + 1), answer.next_time)


class LateCounter:
    """Counts the items of a recorded channel that a reader in time order never gets: late items, and items that the
    archive lacks. It has the methods of `LossCounter`.

    A reader that continues a stream gets no count of late items that memory has lost meanwhile.
    """

    def __init__(self, own: RecordedOwnTrack, low: ItemKey, next_seq: int) -> None:
        self.next_seq = next_seq
        self._own, self._low = own, low

    def mark_read(self, held: Holdings, low: ItemKey, next_seq: int, *, given_above: int, given_below: int) -> int:
        """Note that the reader is done with all items below `low` with a seq below `next_seq`.

        Returns the number of items that it will never get.
        """
        new_parts = held.slices_by_seq(self.next_seq, next_seq)
        late = sum(split_at(part, self._low)[0].items for part in new_parts)
        missing_items, self._own.missing_items = self._own.missing_items, 0
        self._low, self.next_seq = low, next_seq
        return late + missing_items
