"""The seqs that a subscription owes its reader, as ranges. Pure."""

from __future__ import annotations

from array import array
from bisect import bisect_right
from collections.abc import Iterable, Iterator
from itertools import islice

from stampede_rt_channel_host.core.channel import pieces
from stampede_rt_channel_host.core.channel.holdings import Holdings
from stampede_rt_channel_host.core.channel.item_keys import LAST_KEY, ItemKey
from stampede_rt_channel_host.core.channel.pieces import Pieces
from stampede_rt_channel_host.core.merging import Merge

Range = tuple[int, int]
"""The seqs from the first up to the end, exclusive."""


class OwedRanges:
    """Ranges of seqs in ascending order, in an array with two numbers for each range. Adjacent ranges become one range.

    A cursor may have half a million ranges. A single array is freed in one short step.
    """

    __slots__ = ("_bounds",)

    def __init__(self, ranges: Iterable[Range] = ()) -> None:
        self._bounds = array("q")
        self.extend(ranges)

    def __iter__(self) -> Iterator[Range]:
        bounds = self._bounds
        return ((bounds[at], bounds[at + 1]) for at in range(0, len(bounds), 2))

    def between(self, first: int, end: int) -> Iterator[Range]:
        """The parts of the ranges from the seq `first` up to `end`, exclusive."""
        bounds, at = self._bounds, bisect_right(self._bounds, first)
        for low in range(at - at % 2, len(bounds), 2):
            part = max(bounds[low], first), min(bounds[low + 1], end)
            if part[0] >= part[1]:
                return
            yield part

    def takes(self, ranges: OwedRanges) -> bool:
        """Append `ranges` if all of them lie above the present ranges. Otherwise append nothing, and return False."""
        if ranges._bounds and self._bounds and ranges._bounds[0] < self._bounds[-1]:
            return False
        self.extend(ranges)
        return True

    def extend(self, ranges: Iterable[Range]) -> None:
        """Append `ranges`, which ascend and lie above the present ranges."""
        bounds = self._bounds
        for low, high in ranges:
            if bounds and bounds[-1] == low:
                bounds[-1] = high
            else:
                bounds.extend((low, high))


def owed_ranges(held: Holdings, low: ItemKey) -> Pieces[OwedRanges]:
    """The ranges of seqs of the held items from the key `low` on."""
    last, merge = OwedRanges(), Merge[Range](_itself)
    snapshot = held.snapshot()
    try:
        while True:  # ends with the last held item
            parts = [*islice(snapshot.slices(low, LAST_KEY), pieces.STEPS_PER_PIECE)]
            found = OwedRanges(sorted((one.first_seq, one.end_seq) for one in parts if snapshot.shows(one)))
            if not last.takes(found):  # items in order make one list, which needs no merge
                merge.add(last)
                last = found
            if len(parts) < pieces.STEPS_PER_PIECE:
                break
            low = parts[-1].last_time, parts[-1].end_seq
            snapshot.hold()
            yield
    finally:
        snapshot.close()
    return (yield from _merged(last, merge))


def _merged(last: OwedRanges, others: Merge[Range]) -> Pieces[OwedRanges]:
    """The ranges of `last` and `others` in one list."""
    if others.is_empty:
        return last
    others.add(last)
    whole = OwedRanges()
    while part := [*islice(others, pieces.STEPS_PER_PIECE)]:
        whole.extend(part)
        yield
    return whole


def _itself(one: Range) -> Range:
    return one
