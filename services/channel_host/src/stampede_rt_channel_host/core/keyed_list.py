"""Things in the order of a key, in a plain list. Pure."""

from __future__ import annotations

from bisect import bisect_left, bisect_right, insort
from collections.abc import Callable
from typing import Generic, TypeVar

Key = tuple[int, int]
Thing = TypeVar("Thing")


class KeyedList(Generic[Thing]):
    """Things sorted by unique keys. The list may hold some ten thousand things.

    Every channel has four of these lists, and nearly all of them are empty. An empty `KeyedList` takes 100 bytes, an
    empty `SortedKeyList` 450. An insertion moves the references to the later things. With 20,000 things these are at
    most 160 KB (decision 0148).
    """

    __slots__ = ("_things", "key")

    def __init__(self, key: Callable[[Thing], Key]) -> None:
        self.key = key
        self._things: list[Thing] = []

    def __len__(self) -> int:
        return len(self._things)

    def __getitem__(self, position: int) -> Thing:
        return self._things[position]

    def add(self, thing: Thing) -> None:
        """Add a thing. Its key must not change before `remove`."""
        insort(self._things, thing, key=self.key)

    def remove(self, thing: Thing) -> None:
        """Remove a thing from the list."""
        at = bisect_left(self._things, self.key(thing), key=self.key)
        assert self._things[at] is thing, "no two things have the same key, and keys do not change"
        del self._things[at]

    def after(self, last: Key | None, end: Key, things_max: int) -> list[Thing]:
        """The first things with keys above `last` and up to `end`, inclusive; at most `things_max` things.

        If `last` is None, the answer starts with the first thing of the list.
        """
        low = 0 if last is None else bisect_right(self._things, last, key=self.key)
        high = bisect_right(self._things, end, low, key=self.key)
        return self._things[low : min(high, low + things_max)]
