"""Things with deadlines, in a heap. Entries with an outdated deadline are skipped. Pure."""

from __future__ import annotations

import heapq
from typing import Generic, Protocol, TypeVar

_SLACK = 64


class Timed(Protocol):
    """A thing with a deadline.

    `order` is unique and decides between equal deadlines. `due` is None if it has no deadline.
    """

    due: int | None

    @property
    def order(self) -> int:
        """The sort key of things that are due together."""


T = TypeVar("T", bound=Timed)


class Deadlines(Generic[T]):
    """Things by deadline.

    Each operation costs amortised O(log n). The heap has hardly more than two entries for each thing.
    """

    def __init__(self) -> None:
        self._heap: list[tuple[int, int, T]] = []
        self._live = 0

    def arm(self, thing: T, due: int) -> None:
        """Set the deadline of a thing. It replaces an earlier one."""
        if thing.due == due:
            return
        self._live += thing.due is None
        thing.due = due
        heapq.heappush(self._heap, (due, thing.order, thing))
        if len(self._heap) > 2 * self._live + _SLACK:
            self._heap = [entry for entry in self._heap if entry[2].due == entry[0]]
            heapq.heapify(self._heap)

    def disarm(self, thing: T) -> None:
        """Remove the deadline of a thing. Idempotent."""
        self._live -= thing.due is not None
        thing.due = None

    def pop(self, now: int) -> T | None:
        """Remove and return the thing with the earliest deadline up to `now`. None: no deadline has come."""
        due = self.next()
        if due is None or due > now:
            return None
        thing = heapq.heappop(self._heap)[2]
        self.disarm(thing)
        return thing

    def next(self) -> int | None:
        """The next deadline."""
        while self._heap and self._heap[0][2].due != self._heap[0][0]:
            heapq.heappop(self._heap)
        return self._heap[0][0] if self._heap else None
