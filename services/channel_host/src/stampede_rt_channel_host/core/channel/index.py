"""The two indexes of a channel's runs: by (time, seq) and by seq. Pure.

An entry is a part of one run whose items ascend in time, with no other item between them. If items come in order, each
run has one entry. A late item splits the entry into which it falls. Both indexes hold the same entries.

Invariant: if an entry begins at a time, no entry before it holds an item of that time, except entries that begin at the
same time. So the key is only the first time. Entries of equal keys stand in seq order. The key is an attribute of the
entry, so it needs no memory of its own.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Iterator
from itertools import chain, islice
from operator import attrgetter

from stampede_rt_channel_host.core.channel.entry_list import EntryList
from stampede_rt_channel_host.core.channel.index_entries import (
    Entry,
    IndexPart,
    clipped,
    clipped_by_seq,
    index_of,
    is_below,
)
from stampede_rt_channel_host.core.channel.item_keys import LAST_KEY, SEQ_END, ItemKey
from stampede_rt_channel_host.core.channel.oldest_items import OldestItems
from stampede_rt_channel_host.core.channel.run import Run, SingleItemRun, Slice

_time_of, _seq_of = attrgetter("first_time"), attrgetter("first_seq")


class ChannelIndex:
    """Entries by time and by seq. The index may hold items below the channel's floor; the caller leaves these out."""

    __slots__ = ("_by_seq", "_by_time")

    def __init__(self) -> None:
        self._by_time = EntryList(_time_of)
        self._by_seq = EntryList(_seq_of)

    def __len__(self) -> int:
        """The number of entries."""
        return len(self._by_time)

    def insert(self, run: Run) -> None:
        """Add all items of a run. Its seqs must be above all seqs in the index."""
        if isinstance(run, SingleItemRun):
            self._open(run.first_time)
            self._add(run)
            return
        lo, items = 0, len(run)
        if run.span.ascends:
            self._insert_ascending(run, 0, items)
            return
        times = run.times
        while lo < items:
            hi = lo + 1
            while hi < items and times[hi - 1] <= times[hi]:
                hi += 1
            self._insert_ascending(run, lo, hi)
            lo = hi

    def insert_item(self, run: Run, at: int) -> None:
        """Add the item at position `at` of a run.

        The caller adds the items of a run in their order. The item's seq must be above all seqs in the index.
        """
        time = run.times[at]
        before = self._last_up_to(time)
        if before is not None and before.run is run and before.hi == at and before.last_time <= time:
            before.hi = at + 1
        else:
            self._insert_ascending(run, at, at + 1)

    def _insert_ascending(self, run: Run, lo: int, hi: int) -> None:
        """Add the items from position `lo` up to `hi`, whose times ascend. Split them where other entries begin."""
        while lo < hi:
            self._open(run.times[lo])
            next_entry = self._first_later(run.times[lo])
            end = hi if next_entry is None else bisect_left(run.times, next_entry.first_time, lo, hi)
            self._add(IndexPart(run, lo, end))
            lo = end

    def _add(self, entry: Entry) -> None:
        self._by_time.add(entry)
        self._by_seq.add(entry)

    def _open(self, time: int) -> None:
        """Split entries so that an item can be added after the last item of `time`.

        Afterwards every entry that begins at or before `time` also ends at or before `time`, and all entries with items
        of `time` begin at `time`.
        """
        entry = self._last_up_to(time)
        if entry is None or isinstance(entry, SingleItemRun):
            return
        if entry.last_time > time:
            self._split(entry, bisect_right(entry.run.times, time, entry.lo, entry.hi))
        if entry.first_time < time == entry.last_time:
            self._split(entry, bisect_left(entry.run.times, time, entry.lo, entry.hi))

    def _split(self, entry: IndexPart, at: int) -> None:
        """Split an entry into two. The second one begins at position `at` of the run."""
        rest = IndexPart(entry.run, at, entry.hi)
        entry.hi = at
        self._add(rest)

    def _last_up_to(self, time: int) -> Entry | None:
        """The last entry that begins at or before `time`, or None if there is none."""
        return self._by_time.last_up_to(time)

    def _first_later(self, time: int) -> Entry | None:
        """The first entry that begins after `time`, or None if there is none."""
        return self._by_time.first_above(time)

    def slices(self, low: ItemKey, high: ItemKey) -> Iterator[Slice]:
        """The items at or above `low` and below `high`, in ascending order.

        The index must not change during the iteration.
        """
        if low >= high:
            return
        before = self._by_time.last_below(low[0])
        if before is not None and before.last_time >= low[0]:
            yield from clipped(before, low, high)
        for entry in self._by_time.between(low[0], high[0], low[1]):
            if entry.first_time == high[0] and entry.first_seq >= high[1]:
                return
            yield from clipped(entry, low, high)

    def slices_from(self, floor: ItemKey) -> Iterator[Slice]:
        """The items at or above `floor`, in ascending order. Faster than `slices` if few entries lie below `floor`."""
        first = self._by_time.first
        if first is not None and first.last_time < floor[0]:
            yield from self.slices(floor, LAST_KEY)
            return
        for entry in self._by_time:
            lo = entry.lo if entry.first_time > floor[0] else index_of(entry, floor)
            if lo < entry.hi:
                yield Slice(entry.run, lo, entry.hi)

    def slices_down(self, low: ItemKey, high: ItemKey) -> Iterator[Slice]:
        """The items at or above `low` and below `high`, the last slice first."""
        if low >= high:
            return
        for entry in self._by_time.between_down(low[0], high[0], high[1] if high[1] < SEQ_END else None):
            if (entry.last_time, entry.run.first_seq + entry.hi - 1) < low:
                return
            yield from clipped(entry, low, high)
        before = self._by_time.last_below(low[0])
        if before is not None and before.last_time >= low[0]:
            yield from clipped(before, low, high)

    def copy_of(self, low: ItemKey, high: ItemKey) -> ChannelIndex:
        """A new index of the items at or above `low` and below `high`, by time only.

        Changes of this index do not affect the copy.
        """
        copy = ChannelIndex()
        for part in self.slices(low, high):
            copy._by_time.add(IndexPart(part.run, part.lo, part.hi))
        return copy

    def slices_by_seq(self, low: int, high: int, floor: ItemKey) -> Iterator[Slice]:
        """The items with seqs from `low` up to `high`, exclusive, and keys at or above `floor`, in seq order."""
        before = self._by_seq.last_below(low)
        if before is not None:
            yield from clipped_by_seq(before, low, high, floor)
        for entry in self._by_seq.between(low, high - 1):
            yield from clipped_by_seq(entry, low, high, floor)

    def seq_from(self, low: int, high: int, floor: ItemKey, entries_max: int) -> int:
        """The first seq from `low` on whose item is at or above the key `floor`. If no such seq is below `high`,
        returns `high`.

        Looks at `entries_max` entries at most. If these hold no such item, returns the first seq of the next entry: no
        item with a seq from `low` up to that seq is left.
        """
        before = self._by_seq.last_below(low)
        entries = chain(() if before is None else (before,), self._by_seq.between(low, high - 1))
        for entry in islice(entries, entries_max):
            for part in clipped_by_seq(entry, low, high, floor):
                return part.first_seq
        beyond: Entry | None = next(entries, None)
        return high if beyond is None else beyond.first_seq

    def held_up_to(self, low: int, high: int, floor: ItemKey, entries_max: int) -> int:
        """The first seq from `low` on whose item is missing from the index or below the key `floor`; `high` at most.

        Looks at `entries_max` entries at most. If all of these hold such items, returns the seq after their last item.
        """
        before = self._by_seq.last_below(low)
        entries = chain(() if before is None else (before,), self._by_seq.between(low, high - 1))
        for entry in islice(entries, entries_max):
            for part in clipped_by_seq(entry, low, high, floor):
                if part.first_seq > low:
                    return low
                low = part.end_seq
        return low

    def next_time(self, time: int) -> int | None:
        """The earliest item time after `time`, or None if there is none."""
        entry = self._last_up_to(time)
        if entry is not None and entry.last_time > time:
            times = entry.run.times
            return times[bisect_right(times, time, entry.lo, entry.hi)]
        later = self._first_later(time)
        return None if later is None else later.first_time

    def last_time_up_to(self, time: int) -> int | None:
        """The latest item time at or before `time`, or None if there is none."""
        entry = self._last_up_to(time)
        if entry is None or entry.last_time <= time:
            return None if entry is None else entry.last_time
        times = entry.run.times
        return times[bisect_right(times, time, entry.lo, entry.hi) - 1]

    def single_up_to(self, time: int) -> tuple[Slice, int | None] | None:
        """The last item at or before `time`, if no other item has its time, and the earliest later item time.

        None: no such item. The time is None if there is no later item.
        """
        found = self._by_time.only_up_to(time)
        if found is None:
            return None
        entry, following = found
        if not isinstance(entry, IndexPart):  # a SingleItemRun; `isinstance` is slow for subclasses of ABC
            return Slice(entry, 0, 1), following
        times = entry.run.times
        end = bisect_right(times, time, entry.lo, entry.hi)
        if end - 1 > entry.lo and times[end - 2] == times[end - 1]:
            return None
        return Slice(entry.run, end - 1, end), times[end] if end < entry.hi else following

    def oldest_item(self, floor: ItemKey) -> OldestItems | None:
        """The first item, if it is a run of its own at or above `floor`; otherwise None."""
        first, following = self._by_time.first, self._by_time.nth(1)
        if not isinstance(first, SingleItemRun) or (first.first_time, first.first_seq) < floor:
            return None
        rest = None if following is None else Slice(following.run, following.lo, following.hi)
        return OldestItems(1, first.length, Slice(first, 0, 1), rest)

    @property
    def last_item(self) -> Slice | None:
        """The last item in the order (time, seq), or None."""
        entry = self._by_time.last
        return None if entry is None else Slice(entry.run, entry.hi - 1, entry.hi)

    def newest_from(self, seq: int, floor: ItemKey) -> Slice | None:
        """The items from `seq` on, if they are all items of the last entry by seq, none of them below `floor`.

        None: `slices_by_seq` finds the items.
        """
        entry = self._by_seq.last
        if entry is None or entry.run.first_seq + entry.lo != seq or (entry.first_time, seq) < floor:
            return None
        return Slice(entry.run, entry.lo, entry.hi)

    def has_below(self, floor: ItemKey, entries: int = 1) -> bool:
        """Whether all items of the first `entries` entries are below `floor`. False if the index has fewer entries."""
        last = self._by_time.first if entries == 1 else self._by_time.nth(entries - 1)
        return last is not None and is_below(last, floor)

    def pop_below(self, floor: ItemKey) -> Entry | None:
        """Remove and return the first entry if all its items are below `floor`; else return None."""
        entry = self._by_time.first
        if entry is None or not is_below(entry, floor):
            return None
        self._by_time.remove_first()
        if self._by_seq.first is entry:
            self._by_seq.remove_first()
        else:
            self._by_seq.remove(entry)
        return entry

    def share_below(self, floor: ItemKey) -> Slice | None:
        """The items below `floor` of the first entry; perhaps an empty slice.

        None if the first entry begins after the floor's time, has a run of one item, or does not exist.
        """
        entry = self._by_time.first
        if not isinstance(entry, IndexPart) or entry.first_time > floor[0]:
            return None
        return Slice(entry.run, entry.lo, index_of(entry, floor))

    def parts_of(self, run: Run, parts_max: int) -> list[IndexPart]:
        """The first entries of a run of several items, `parts_max` at most."""
        end_seq = run.first_seq + len(run)
        found = islice(self._by_seq.between(run.first_seq, end_seq - 1), parts_max)
        return [entry for entry in found if isinstance(entry, IndexPart)]

    def trim_below(self, floor: ItemKey) -> Slice | None:
        """Remove and return the items below `floor` of the first entry, if it has such items and also other items.

        Otherwise returns None.
        """
        entry = self._by_time.first
        at = 0 if entry is None else index_of(entry, floor)
        if entry is None or not entry.lo < at < entry.hi:
            return None
        assert isinstance(entry, IndexPart), "an entry of one item has nothing between its ends"
        trimmed = Slice(entry.run, entry.lo, at)
        if entry.run.times[at] == entry.first_time:  # the entry stays the first of the entries that begin at this time
            entry.lo = at
        else:
            self._by_time.remove(entry)
            self._by_seq.remove(entry)
            self._add(IndexPart(entry.run, at, entry.hi))
        return trimmed
