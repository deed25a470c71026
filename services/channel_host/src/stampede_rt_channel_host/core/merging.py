"""A merge of many sorted lists that begins in small steps. Pure."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Iterator
from heapq import heappop, heappush, heapreplace
from typing import Any, Generic, TypeVar

T = TypeVar("T")


class Merge(Generic[T]):
    """Gives the things of all added lists in ascending order of their keys. Each list is in this order itself.

    `heapq.merge` needs all lists at once, and looks at the first thing of each in one step. Here, work in pieces adds
    each list as soon as it has found it. Add all lists before the first thing is taken.
    """

    def __init__(self, key: Callable[[T], Any]) -> None:
        self._key = key
        self._added = 0
        # the key of the next thing of a list, the number of the list, that thing, and the things after it
        self._heap: list[tuple[Any, int, T, Iterator[T]]] = []

    def add(self, things: Iterable[T]) -> None:
        """Add a list. Looks at its first thing."""
        self._added += 1
        rest = iter(things)
        for first in rest:
            heappush(self._heap, (self._key(first), self._added, first, rest))
            return

    def emptying(self) -> Generator[None, None, None]:
        """Free the remaining things, one list in each piece."""
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
