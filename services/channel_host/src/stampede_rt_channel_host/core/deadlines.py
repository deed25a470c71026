"""Things with deadlines, in a heap. A changed deadline leaves its old entry in the heap, to be skipped later. Pure."""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from typing import Generic, Protocol, TypeVar

_SLACK = 64  # a heap may have this many entries more than twice the number of things with a deadline


class DeadlineEntry(Protocol):
    """A thing with a deadline.

    `order` is unique and decides between equal deadlines. `due` is None while the thing has no deadline.
    """

    due: int | None

    @property
    def order(self) -> int:
        """The sort key of things that are due together."""


T = TypeVar("T", bound=DeadlineEntry)


Entry = tuple[int, int, T]  # the deadline, `order`, and the thing
OUTDATED_PER_CALL_MAX = 512
EMPTIED_PER_PIECE = 1024
_MOVED_PER_ARM = 4  # the entries of the old heap that one `set_due` looks at


class Deadlines(Generic[T]):
    """Things by deadline.

    Each operation costs amortised O(log n). When more than about half of the entries are outdated, the heap becomes the
    old heap, and a new heap begins. Each `set_due` then takes a few entries from the old heap, and moves the entries
    that still count to the new heap. So no call scans all entries.
    """

    def __init__(self) -> None:
        self._heap: list[Entry[T]] = []
        self._old: list[Entry[T]] = []
        self._live = 0

    def set_due(self, thing: T, due: int) -> None:
        """Set the deadline of a thing. The new deadline replaces the former one."""
        if thing.due == due:
            return
        self._live += thing.due is None
        thing.due = due
        heapq.heappush(self._heap, (due, thing.order, thing))
        if self._old:
            self._move_some()
        elif len(self._heap) > 2 * self._live + _SLACK:
            self._old, self._heap = self._heap, []

    def disarm(self, thing: T) -> None:
        """Remove the deadline of a thing. Idempotent."""
        self._live -= thing.due is not None
        thing.due = None

    def pop(self, now: int) -> T | None:
        """Remove and return the thing with the earliest deadline. Returns None if this deadline is after `now`, or if
        no thing has a deadline. Also returns None while there are very many changed deadlines; `next` is not after
        `now` then.
        """
        first = self._first()
        if not first or first[0][0] > now or first[0][2].due != first[0][0]:
            return None
        thing = heapq.heappop(first)[2]
        self.disarm(thing)
        return thing

    def next(self) -> int | None:
        """The earliest deadline, or None if no thing has one. If very many deadlines were changed, an earlier time."""
        first = self._first()
        return first[0][0] if first else None

    def emptying(self) -> Iterator[None]:
        """Free all entries, in pieces. The caller must not use this object any more."""
        for heap in (self._heap, self._old):
            while heap:
                del heap[-EMPTIED_PER_PIECE:]
                yield

    def _first(self) -> list[Entry[T]]:
        """The heap whose top is the earliest deadline. The returned heap is empty if no thing has a deadline.

        If there are too many outdated entries for one call, the top is one of them.
        """
        left = OUTDATED_PER_CALL_MAX
        for heap in (self._heap, self._old):
            while left and heap and heap[0][2].due != heap[0][0]:
                heapq.heappop(heap)
                left -= 1
        if not self._heap or not self._old:
            return self._heap or self._old
        return self._heap if self._heap[0][:2] <= self._old[0][:2] else self._old

    def _move_some(self) -> None:
        """Take the last entries from the old heap, and move the entries that still count to the new heap.

        The rest of the old heap is still a heap.
        """
        for _ in range(min(_MOVED_PER_ARM, len(self._old))):
            entry = self._old.pop()
            if entry[2].due == entry[0]:
                heapq.heappush(self._heap, entry)
