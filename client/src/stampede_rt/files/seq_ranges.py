"""A set of seqs, kept as ranges: the seqs of a recording have few holes. Pure."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator


class SeqRanges:
    """Whole numbers, as ranges that do not touch."""

    def __init__(self) -> None:
        self._firsts: list[int] = []
        self._lasts: list[int] = []

    def __contains__(self, seq: int) -> bool:
        place = bisect_right(self._firsts, seq) - 1
        return place >= 0 and seq <= self._lasts[place]

    def add(self, seq: int) -> bool:
        """Add a seq. Returns whether it is new."""
        if seq in self:
            return False
        self.add_range(seq, seq)
        return True

    def add_range(self, first: int, last: int) -> None:
        """Add the seqs from `first` to `last`, inclusive."""
        begin = bisect_right(self._lasts, first - 2)  # the first range that touches or follows
        end = bisect_right(self._firsts, last + 1)
        if begin < end:
            first, last = min(first, self._firsts[begin]), max(last, self._lasts[end - 1])
        self._firsts[begin:end], self._lasts[begin:end] = [first], [last]

    def end_from(self, seq: int) -> int:
        """Return the first seq from `seq` on that the set lacks."""
        place = bisect_right(self._firsts, seq) - 1
        return self._lasts[place] + 1 if place >= 0 and self._lasts[place] >= seq else seq

    def next_from(self, seq: int) -> int | None:
        """Return the least seq of the set from `seq` on; None: there is none."""
        place = bisect_right(self._lasts, seq - 1)
        return max(seq, self._firsts[place]) if place < len(self._firsts) else None

    def missing(self, first: int, last: int) -> Iterator[tuple[int, int]]:
        """Yield the ranges between `first` and `last`, inclusive, that the set lacks."""
        place = bisect_right(self._lasts, first - 1)
        while first <= last:
            if place >= len(self._firsts) or self._firsts[place] > last:
                yield first, last
                return
            if self._firsts[place] > first:
                yield first, self._firsts[place] - 1
            first = self._lasts[place] + 1
            place += 1

    def common(self, other: SeqRanges) -> int:
        """Return how many seqs both sets have."""
        ranges = zip(self._firsts, self._lasts, strict=True)
        return sum(
            last - first + 1 - sum(end - begin + 1 for begin, end in other.missing(first, last))
            for first, last in ranges
        )
