"""Sets of seqs that are nearly always one range: consumed seqs, collected seqs. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import islice
from typing import Any

from sortedcontainers import SortedList

from stampede_rt.values.timeline import MAX_INSTANT

_LAST = MAX_INSTANT


class SeqSet:
    """A set that has all seqs that are less than `below`, and ranges of seqs that are greater than `below`.

    `add` costs amortised O(log ranges), and O(1) if the seqs come in order.
    """

    __slots__ = ("_ranges", "below", "size")

    def __init__(self, below: int = 1, ranges: Iterable[tuple[int, int]] = ()) -> None:
        """Make a set.

        Seqs start at 1, so with `below` 1 the set has only `ranges`: pairs of first seq and end, exclusive.
        """
        self.below = below
        self.size = below - 1  # the number of seqs in the set
        # Pairs of first seq and end, with gaps between them. All are greater than `below`. Not a dict: a large dict
        # grows in one long step.
        self._ranges: Any = SortedList()
        for first, end in ranges:
            self.add(first, end)

    def first_range(self, seq: int) -> tuple[int, int] | None:
        """The first range above `below` that begins at or above `seq`, or None if there is none."""
        return next(self._ranges.irange((seq, 0)), None)

    @property
    def ranges(self) -> list[tuple[int, int]]:
        """The ranges above `below`, in ascending order: first seq and end, exclusive."""
        return list(self._ranges)

    @property
    def range_count(self) -> int:
        """The number of ranges above `below`."""
        return len(self._ranges)

    def end_of_ranges(self, first: int, end: int, ranges_max: int) -> int:
        """The end of the part of `first` to `end` that one step may add, so that the step joins few ranges.

        The result is `end`, or less if a step up to `end` would join more than about `ranges_max` ranges.
        """
        if len(self._ranges) <= ranges_max:
            return end
        beyond = next(islice(self._ranges.irange((first, _LAST), (end, 0)), ranges_max, None), None)
        return end if beyond is None else beyond[0]

    def touching(self, first: int, end: int) -> Iterator[tuple[int, int]]:
        """The ranges that share a seq with the range from `first` up to `end`, or that are next to it.

        The first one may be the range of all seqs that are less than `below`.
        """
        if first <= self.below and self.below > 1:
            yield 1, self.below
        before = self._last_up_to(first)
        if before is not None and before[1] >= first:
            yield before
        yield from self._ranges.irange((first, _LAST), (end, _LAST))

    def _last_up_to(self, seq: int) -> tuple[int, int] | None:
        """The last range that begins at or below `seq`, or None.

        Searches by value. For a search by position the sorted list would first have to count all its elements.
        """
        return next(self._ranges.irange(None, (seq, _LAST), reverse=True), None)

    def end_of(self, seq: int) -> int:
        """The first seq at or above `seq` that is not in the set."""
        if seq < self.below:
            return self.below
        before = self._last_up_to(seq)
        return seq if before is None else max(seq, before[1])

    def add(self, first: int, end: int) -> int:
        """Add the seqs from `first` up to `end`, exclusive. Returns how many of them are new."""
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
        """Remove the ranges that touch `first` to `end`. Returns the range that covers them and `first` to `end`."""
        touched = [one for one in self.touching(first, end) if one[0] > self.below]
        for low, high in touched:
            self._ranges.remove((low, high))
            self.size -= high - low
            self._note_known(max(low, first), min(high, end))
        if touched:
            first, end = min(first, touched[0][0]), max(end, touched[-1][1])
        return first, end

    def _note_known(self, first: int, end: int) -> None:
        """`add` calls this method with seqs that the set has already: those from `first` up to `end`, exclusive.

        `CountedSeqs` overrides it.
        """


BLOCK_SEQS = 1024
"""`CountedSeqs` counts the seqs of a set in blocks of this many."""

BLOCKS_FORGOTTEN_MAX = 64
"""The most blocks that one `add` forgets, of the blocks whose seqs are all less than `below`."""


class CountedSeqs(SeqSet):
    """A set of seqs that quickly counts its seqs within given bounds, however many ranges it has."""

    __slots__ = ("_blocks", "_first_block")

    def __init__(self) -> None:
        super().__init__()
        # for each block with a seq of `below` or greater: how many seqs of the block are in the set
        self._blocks: dict[int, int] = {}
        self._first_block = 0

    def add(self, first: int, end: int) -> int:
        """Add the seqs from `first` up to `end`, exclusive. Returns how many of them are new."""
        first = max(first, self.below)
        self._count(first, end, 1)
        added = super().add(first, end)
        outdated = range(self._first_block, self.below // BLOCK_SEQS)[:BLOCKS_FORGOTTEN_MAX]
        for block in outdated:  # `count` does not need them; the next calls forget the rest
            self._blocks.pop(block, None)
        self._first_block += len(outdated)
        return added

    def _note_known(self, first: int, end: int) -> None:
        self._count(first, end, -1)

    def _count(self, first: int, end: int, each: int) -> None:
        while first < end:
            block = first // BLOCK_SEQS
            till = min(end, (block + 1) * BLOCK_SEQS)
            self._blocks[block] = self._blocks.get(block, 0) + each * (till - first)
            first = till

    def count(self, first: int, end: int) -> int:
        """The number of seqs from `first` up to `end`, exclusive, that are in the set.

        Scans the ranges of the first and the last block, and adds the stored counts of the blocks between. If a range
        has `first`, the method counts the seqs of that range in one step.
        """
        known_end = max(first, min(end, self.end_of(first)))
        known, first = known_end - first, known_end
        low, high = -(-first // BLOCK_SEQS), end // BLOCK_SEQS
        if low >= high:
            return known + self._scan(first, end)
        known += self._scan(first, low * BLOCK_SEQS) + self._scan(high * BLOCK_SEQS, end)
        return known + sum(self._blocks.get(block, 0) for block in range(low, high))

    def _scan(self, first: int, end: int) -> int:
        """The number of seqs of the set from `first` up to `end`, by a scan of the ranges."""
        if first >= end:
            return 0
        parts = self.touching(first, end)
        return sum(max(0, min(high, end) - max(low, first)) for low, high in parts)
