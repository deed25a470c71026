"""The times of one channel's items, as the page draws them. Pure.

A track holds the newest ITEMS_MAX items that the page has seen, in time order, in columns. It also holds marks: the
instants at which something went wrong. An item stays in the track after the host has collected it. The page draws such
an item paler.
"""

from __future__ import annotations

from array import array
from bisect import bisect_left, bisect_right
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal, NamedTuple

ITEMS_MAX = 32_768
MARKS_MAX = 256
MISSING_MAX = 4096  # the seqs of accepted items that the track does not hold
ABSENT = -1  # in the column of durations: the item has no duration

MarkKind = Literal["late", "refused", "lost", "missed"]


class TrackItem(NamedTuple):
    """The facts about one item: instants and durations in nanoseconds, the payload's length in bytes."""

    time: int
    duration: int
    seq: int
    length_bytes: int


@dataclass(frozen=True, slots=True)
class Mark:
    """Something that went wrong at an instant, with a sentence for people.

    "late": an item came after a later one. "refused": the host refused items. "lost": the host was lost with its items.
    "missed": items left memory before the page read them.
    """

    time: int
    kind: MarkKind
    text: str


class ItemTrack:
    """The items of one channel, in the order of their times.

    `seq_max` is the highest seq that the channel has accepted, as far as the track knows. `ends_early` says that the
    track shows a part of the past, and that this part has more items than the page has read.
    """

    def __init__(self) -> None:
        self.times = array("q")
        self.durations = array("q")
        self.seqs = array("Q")
        self.lengths = array("Q")
        self.marks: deque[Mark] = deque(maxlen=MARKS_MAX)
        self.incarnation: int | None = None
        self.seq_max = 0
        self.ends_early = False
        self._missing: set[int] = set()

    def __len__(self) -> int:
        return len(self.times)

    @property
    def has_missing(self) -> bool:
        """Whether the channel accepted items that the track does not hold: late items, or items that were already
        collected."""
        return bool(self._missing)

    def begin_incarnation(self, incarnation: int, now: int) -> None:
        """Note the channel's incarnation. If it differs from the incarnation before, mark the loss and forget the
        seqs."""
        if self.incarnation is not None and incarnation != self.incarnation:
            self.marks.append(Mark(now, "lost", "The channel's host was lost, and its items with it."))
        if incarnation != self.incarnation:
            self.incarnation, self.seq_max, self._missing = incarnation, 0, set()

    def extend(self, items: Iterable[TrackItem]) -> None:
        """Add items that are later than all others of the track. The seqs between the seqs of these items become
        missing."""
        for item in items:
            if self.seq_max and item.seq > self.seq_max + 1:
                self._note_missing(range(self.seq_max + 1, item.seq))
            self._missing.discard(item.seq)
            self.seq_max = max(self.seq_max, item.seq)
            self._insert(len(self), item)
        self._forget_oldest()

    def prepend(self, items: Iterable[TrackItem]) -> None:
        """Add items that are older than all others of the track, in time order.

        If there is no room for all, drop the oldest.
        """
        older = list(items)
        older = older[max(0, len(older) - (ITEMS_MAX - len(self))) :]
        self.times = array("q", [item.time for item in older]) + self.times
        self.durations = array("q", [item.duration for item in older]) + self.durations
        self.seqs = array("Q", [item.seq for item in older]) + self.seqs
        self.lengths = array("Q", [item.length_bytes for item in older]) + self.lengths
        self.seq_max = max([self.seq_max, *(item.seq for item in older)])

    def add_late(self, items: Iterable[TrackItem], now: int) -> None:
        """Add the missing ones among `items`, each with a mark "late".

        One mark "missed" then represents all items that are still missing, and the track forgets their seqs.
        """
        for item in items:
            if item.seq in self._missing:
                self._missing.discard(item.seq)
                self._insert(bisect_right(self.times, item.time), item)
                self.marks.append(Mark(item.time, "late", f"Item {item.seq} came after a later item."))
        if self._missing:
            count = len(self._missing)
            items_text = "1 item" if count == 1 else f"{count} items"
            self.marks.append(Mark(now, "missed", f"{items_text} left memory before this page read them."))
            self._missing.clear()
        self._forget_oldest()

    def expect(self, seq: int) -> None:
        """Note that the channel has accepted items up to `seq`. Seqs above `seq_max` become missing."""
        if seq > self.seq_max:
            self._note_missing(range(self.seq_max + 1, seq + 1))
            self.seq_max = seq

    def between(self, start: int, end: int) -> range:
        """Return the indexes of the items whose span can touch [start, end], in nanoseconds.

        The last item before `start` is among them, because its span may reach into the interval.
        """
        return range(max(0, bisect_left(self.times, start) - 1), bisect_right(self.times, end))

    def _note_missing(self, seqs: range) -> None:
        self._missing.update(seqs[-MISSING_MAX:])
        while len(self._missing) > MISSING_MAX:
            self._missing.discard(min(self._missing))

    def _insert(self, index: int, item: TrackItem) -> None:
        self.times.insert(index, item.time)
        self.durations.insert(index, item.duration)
        self.seqs.insert(index, item.seq)
        self.lengths.insert(index, item.length_bytes)

    def _forget_oldest(self) -> None:
        beyond = len(self) - ITEMS_MAX
        if beyond > 0:
            for column in (self.times, self.durations, self.seqs, self.lengths):
                del column[:beyond]
