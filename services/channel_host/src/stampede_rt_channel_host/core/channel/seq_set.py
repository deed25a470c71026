"""Sets of seqs that are nearly always one range: what was consumed, what is gone. Pure."""

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

    def first_range(self, seq: int) -> tuple[int, int] | None:
        """The first range above `below` that begins at or above `seq`; None: there is none."""
        low = next(self._ranges.irange(seq), None)
        return None if low is None else (low, self._ranges[low])

    @property
    def ranges(self) -> list[tuple[int, int]]:
        """What is in above `below`, ascending: first and end, the end excluded."""
        return list(self._ranges.items())

    def touching(self, first: int, end: int) -> Iterator[tuple[int, int]]:
        """The ranges that share a seq with those from `first` up to `end`, or adjoin them; the first one may be the one
        below `below`."""
        if first <= self.below and self.below > 1:
            yield 1, self.below
        low = self._floor(first)
        if low is not None and self._ranges[low] >= first:
            yield low, self._ranges[low]
        for low in self._ranges.irange(first, end, (False, True)):
            yield low, self._ranges[low]

    def _floor(self, seq: int) -> int | None:
        """Where the last range begins that begins at or below `seq`. By keys: places would be counted anew."""
        return next(self._ranges.irange(None, seq, reverse=True), None)

    def end_of(self, seq: int) -> int:
        """The first seq at or above `seq` that is not in."""
        if seq < self.below:
            return self.below
        low = self._floor(seq)
        return seq if low is None else max(seq, self._ranges[low])

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
        touched = [one for one in self.touching(first, end) if one[0] > self.below]
        for low, high in touched:
            del self._ranges[low]
            self.size -= high - low
            self._meet(max(low, first), min(high, end))
        if touched:
            first, end = min(first, touched[0][0]), max(end, touched[-1][1])
        return first, end

    def _meet(self, first: int, end: int) -> None:
        """Seqs are put in that were in already."""


BLOCK_SEQS = 1024


class CountedSeqs(SeqSet):
    """A set of seqs that knows how many of them lie between two others, however many ranges they make."""

    __slots__ = ("_blocks", "_first_block")

    def __init__(self) -> None:
        super().__init__()
        self._blocks: dict[int, int] = {}  # of each BLOCK_SEQS seqs, how many are in; not of those below `below`
        self._first_block = 0

    def add(self, first: int, end: int) -> int:
        """Put in the seqs from `first` up to, not including, `end`; how many were not in."""
        first = max(first, self.below)
        self._count(first, end, 1)
        added = super().add(first, end)
        for block in range(self._first_block, self.below // BLOCK_SEQS):
            self._blocks.pop(block, None)
        self._first_block = max(self._first_block, self.below // BLOCK_SEQS)
        return added

    def _meet(self, first: int, end: int) -> None:
        self._count(first, end, -1)

    def _count(self, first: int, end: int, each: int) -> None:
        while first < end:
            block = first // BLOCK_SEQS
            till = min(end, (block + 1) * BLOCK_SEQS)
            self._blocks[block] = self._blocks.get(block, 0) + each * (till - first)
            first = till

    def count(self, first: int, end: int) -> int:
        """How many of the seqs from `first` up to, not including, `end` are in. Walks one block, and counts the others
        in between."""
        known = max(0, min(end, self.below) - first)
        first = max(first, self.below)
        low, high = -(-first // BLOCK_SEQS), end // BLOCK_SEQS
        if low >= high:
            return known + self._walk(first, end)
        known += self._walk(first, low * BLOCK_SEQS) + self._walk(high * BLOCK_SEQS, end)
        return known + sum(self._blocks.get(block, 0) for block in range(low, high))

    def _walk(self, first: int, end: int) -> int:
        if first >= end:
            return 0
        parts = self.touching(first, end)
        return sum(max(0, min(high, end) - max(low, first)) for low, high in parts)
