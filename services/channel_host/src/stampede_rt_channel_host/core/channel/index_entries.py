"""The entries of a channel's index. Pure.

An entry is a part of one run whose items ascend in time, with no other item between them.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Iterator

from stampede_rt_channel_host.core.channel.item_keys import ItemKey
from stampede_rt_channel_host.core.channel.run import Run, SingleItemRun, Slice


class IndexPart:
    """An entry of a run of several items: positions `lo` up to `hi` of the run, exclusive.

    A split changes `hi`. A trim that removes only a part of the entry's first bucket changes `lo`, but not `first_seq`,
    because the index finds the entry by this number. Any other trim makes a new entry.
    """

    __slots__ = ("first_seq", "first_time", "hi", "lo", "run")

    def __init__(self, run: Run, lo: int, hi: int) -> None:
        self.run = run
        self.lo = lo
        self.hi = hi
        self.first_time = run.times[lo]
        self.first_seq = run.first_seq + lo

    @property
    def last_time(self) -> int:
        """The last item's time."""
        return self.run.times[self.hi - 1]

    def refer_to(self, run: Run) -> None:
        """Refer to `run` instead of the present run. `run` must hold exactly the items of this entry."""
        self.run, self.lo, self.hi = run, 0, len(run)


Entry = IndexPart | SingleItemRun
"""One entry of the index. A run of one item is its own entry."""


def index_of(entry: Entry, key: ItemKey) -> int:
    """The position in the entry's run of its first item at or above `key`; `entry.hi` if there is none."""
    time, seq = key
    if entry.first_time > time:
        return entry.lo
    times = entry.run.times
    bucket = bisect_left(times, time, entry.lo, entry.hi)
    bucket_end = bisect_right(times, time, bucket, entry.hi)
    return min(max(bucket, seq - entry.run.first_seq), bucket_end)


def is_below(entry: Entry, floor: ItemKey) -> bool:
    """Whether all items of the entry are below `floor`."""
    if entry.first_time > floor[0]:
        return False
    return (entry.last_time, entry.run.first_seq + entry.hi - 1) < floor


def clipped(entry: Entry, low: ItemKey, high: ItemKey) -> Iterator[Slice]:
    """The items of the entry at or above `low` and below `high`: one slice, or none."""
    lo = entry.lo if entry.first_time > low[0] else index_of(entry, low)
    hi = entry.hi if entry.last_time < high[0] else index_of(entry, high)
    if lo < hi:
        yield Slice(entry.run, lo, hi)


def clipped_by_seq(entry: Entry, low: int, high: int, floor: ItemKey) -> Iterator[Slice]:
    """The items of the entry with seqs from `low` up to `high`, exclusive, and keys at or above `floor`."""
    first = entry.run.first_seq
    lo = max(entry.lo, low - first)
    hi = min(entry.hi, high - first)
    if entry.first_time <= floor[0]:
        lo = max(lo, index_of(entry, floor))
    if lo < hi:
        yield Slice(entry.run, lo, hi)
