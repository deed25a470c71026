"""Sets of seqs that are nearly always one range: what was consumed, what is gone. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import islice
from typing import Any

from sortedcontainers import SortedList

from stampede_rt.values.timeline import MAX_INSTANT

_LAST = MAX_INSTANT


class SeqSet:
    """All seqs below `below`, and ranges above it. Adding costs O(log ranges), amortised; in order it costs O(1)."""

    __slots__ = ("_ranges", "below", "size")

    def __init__(self, below: int = 1, ranges: Iterable[tuple[int, int]] = ()) -> None:
        """Seqs start at 1, so `below` 1 is the empty set. `ranges` are firsts with their ends, the end excluded."""
        self.below = below
        self.size = below - 1  # how many seqs are in
        # First and end; apart from each other, and all above `below`. No dict: a large one grows in one long step.
        self._ranges: Any = SortedList()
        for first, end in ranges:
            self.add(first, end)

    def first_range(self, seq: int) -> tuple[int, int] | None:
        """The first range above `below` that begins at or above `seq`; None: there is none."""
        return next(self._ranges.irange((seq, 0)), None)

    @property
    def ranges(self) -> list[tuple[int, int]]:
        """The ranges above `below`, ascending: first and end, the end excluded."""
        return list(self._ranges)

    @property
    def range_count(self) -> int:
        """How many ranges are in above `below`."""
        return len(self._ranges)

    def until(self, first: int, end: int, ranges_max: int) -> int:
        """How far from `first` towards `end` one step may add: no more than about so many ranges lie before that."""
        if len(self._ranges) <= ranges_max:
            return end
        beyond = next(islice(self._ranges.irange((first, _LAST), (end, 0)), ranges_max, None), None)
        return end if beyond is None else beyond[0]

    def touching(self, first: int, end: int) -> Iterator[tuple[int, int]]:
        """The ranges that share a seq with those from `first` up to `end`, or adjoin them; the first one may be the one
        below `below`."""
        if first <= self.below and self.below > 1:
            yield 1, self.below
        before = self._floor(first)
        if before is not None and before[1] >= first:
            yield before
        yield from self._ranges.irange((first, _LAST), (end, _LAST))

    def _floor(self, seq: int) -> tuple[int, int] | None:
        """The last range that begins at or below `seq`. By values: places would be counted anew."""
        return next(self._ranges.irange(None, (seq, _LAST), reverse=True), None)

    def end_of(self, seq: int) -> int:
        """The first seq at or above `seq` that is not in."""
        if seq < self.below:
            return self.below
        before = self._floor(seq)
        return seq if before is None else max(seq, before[1])

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
            self._ranges.add((first, end))
        return self.size - before

    def _absorb(self, first: int, end: int) -> tuple[int, int]:
        """Take out the ranges that touch first to end; the range that they are all in."""
        touched = [one for one in self.touching(first, end) if one[0] > self.below]
        for low, high in touched:
            self._ranges.remove((low, high))
            self.size -= high - low
            self._meet(max(low, first), min(high, end))
        if touched:
            first, end = min(first, touched[0][0]), max(end, touched[-1][1])
        return first, end

    def _meet(self, first: int, end: int) -> None:
        """Seqs are put in that were in already."""


BLOCK_SEQS = 1024
BLOCKS_FORGOTTEN_MAX = 64
"""So many blocks one call forgets that lie below `below`."""


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
        outdated = range(self._first_block, self.below // BLOCK_SEQS)[:BLOCKS_FORGOTTEN_MAX]
        for block in outdated:  # the next calls go on: nobody asks for these any more
            self._blocks.pop(block, None)
        self._first_block += len(outdated)
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
        in between; a range that holds `first` counts as a whole."""
        behind = max(first, min(end, self.end_of(first)))
        known, first = behind - first, behind
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
