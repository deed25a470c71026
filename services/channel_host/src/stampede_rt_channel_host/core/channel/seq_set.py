"""A set of seqs that is nearly always one range: what was consumed, what is gone. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

from sortedcontainers import SortedDict


class SeqSet:
    """All seqs below `below`, and ranges above it. Adding costs O(log ranges), amortised; in order it costs O(1)."""

    __slots__ = ("_ranges", "below", "size")

    def __init__(self, below: int = 1, ranges: Iterable[tuple[int, int]] = ()) -> None:
        """Seqs start at 1, so `below` 1 is the empty set. `ranges` are firsts with their ends, the end excluded."""
        self.below = below
        self.size = below - 1  # how many seqs are in
        self._ranges: Any = SortedDict()  # first -> end; apart from each other, and all above `below`
        for first, end in ranges:
            self.add(first, end)

    @property
    def ranges(self) -> list[tuple[int, int]]:
        """What is in above `below`, ascending: first and end, the end excluded."""
        return list(self._ranges.items())

    def copy(self) -> SeqSet:
        """Another set of the same seqs."""
        copy = SeqSet(self.below)
        copy.size, copy._ranges = self.size, SortedDict(self._ranges)
        return copy

    def touching(self, first: int, end: int) -> Iterator[tuple[int, int]]:
        """The ranges that share a seq with those from `first` up to `end`, or adjoin them; the first one may be the one
        below `below`."""
        if first <= self.below and self.below > 1:
            yield 1, self.below
        at = max(0, self._ranges.bisect_right(first) - 1)
        for low in self._ranges.islice(at):
            if low > end:
                return
            if self._ranges[low] >= first:
                yield low, self._ranges[low]

    def end_of(self, seq: int) -> int:
        """The first seq at or above `seq` that is not in."""
        if seq < self.below:
            return self.below
        at = self._ranges.bisect_right(seq) - 1
        return seq if at < 0 else max(seq, self._ranges.peekitem(at)[1])

    def add(self, first: int, end: int) -> int:
        """Put in the seqs from `first` up to, not including, `end`; how many were not in."""
        before = self.size
        first = max(first, self.below)
        if first >= end:
            return 0
        if self._ranges:
            first, end = self._absorb(first, end)
        if first <= self.below:
            self.size += end - self.below
            self.below = end
        else:
            self.size += end - first
            self._ranges[first] = end
        return self.size - before

    def _absorb(self, first: int, end: int) -> tuple[int, int]:
        """Take out the ranges that touch first to end; the range that they are all in."""
        at = self._ranges.bisect_left(first)
        if at and self._ranges.peekitem(at - 1)[1] >= first:
            at -= 1
        while at < len(self._ranges):  # ends with the ranges
            low, high = self._ranges.peekitem(at)
            if low > end:
                break
            self._ranges.popitem(at)
            self.size -= high - low
            first, end = min(first, low), max(end, high)
        return first, end
