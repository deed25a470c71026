"""A merge of many sorted lists. The caller may add the lists in small steps. Pure."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Iterator
from heapq import heappop, heappush, heapreplace
from typing import Any, Generic, TypeVar

T = TypeVar("T")


class Merge(Generic[T]):
    """Iterates over the things of all added lists in ascending order of their keys. Each list must have this order.

    `heapq.merge` takes all lists in one call, and that call looks at the first thing of each list. Here, a caller that
    works in pieces adds each list in a step of its own. The caller adds all lists before it takes the first thing.
    """

    def __init__(self, key: Callable[[T], Any]) -> None:
        self._key = key
        self._added = 0
        # for each list with things left: the key of its next thing, its number, that thing, and the things after it
        self._heap: list[tuple[Any, int, T, Iterator[T]]] = []

    def add(self, things: Iterable[T]) -> None:
        """Add a list. Takes the first thing from it."""
        self._added += 1
        rest = iter(things)
        for first in rest:
            heappush(self._heap, (self._key(first), self._added, first, rest))
            return

    def emptying(self) -> Generator[None, None, None]:
        """Free the remaining things in pieces, one list in each piece."""
        while self._heap:
            self._heap.pop()
            yield

    @property
    def is_empty(self) -> bool:
        """Whether no thing is left to give."""
        return not self._heap

    def __iter__(self) -> Iterator[T]:
        return self

    def __next__(self) -> T:
        if not self._heap:
            raise StopIteration
        _, number, thing, rest = self._heap[0]
        for following in rest:
            heapreplace(self._heap, (self._key(following), number, following, rest))
            return thing
        heappop(self._heap)
        return thing
