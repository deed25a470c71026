"""Things with deadlines: a heap that passes over things whose deadline has changed. Pure."""

from __future__ import annotations

import heapq
from typing import Generic, Protocol, TypeVar

_SLACK = 64


class Timed(Protocol):
    """A thing with a deadline. `order` settles ties and is unique; `due` is None while nothing is due."""

    due: int | None

    @property
    def order(self) -> int:
        """Which of two things that are due together comes first."""


T = TypeVar("T", bound=Timed)


class Deadlines(Generic[T]):
    """Amortised O(log n) for each operation; the heap is never larger than twice what is due, and a little."""

    def __init__(self) -> None:
        self._heap: list[tuple[int, int, T]] = []
        self._live = 0

    def arm(self, thing: T, due: int) -> None:
        """It is due then, and not when it was before."""
        if thing.due == due:
            return
        self._live += thing.due is None
        thing.due = due
        heapq.heappush(self._heap, (due, thing.order, thing))
        if len(self._heap) > 2 * self._live + _SLACK:
            self._heap = [entry for entry in self._heap if entry[2].due == entry[0]]
            heapq.heapify(self._heap)

    def disarm(self, thing: T) -> None:
        """It is not due any more. Idempotent."""
        self._live -= thing.due is not None
        thing.due = None

    def pop(self, now: int) -> T | None:
        """The thing with the earliest deadline up to now; it is disarmed. None: nothing is due."""
        due = self.next()
        if due is None or due > now:
            return None
        thing = heapq.heappop(self._heap)[2]
        self.disarm(thing)
        return thing

    def next(self) -> int | None:
        """When something is due next."""
        while self._heap and self._heap[0][2].due != self._heap[0][0]:
            heapq.heappop(self._heap)
        return self._heap[0][0] if self._heap else None
