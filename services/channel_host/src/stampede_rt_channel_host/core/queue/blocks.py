"""A map from numbers to things for very many entries. Pure.

A table that grows is copied in one step: 9 ms for a dictionary of 300,000 entries.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Generic, TypeVar

from sortedcontainers import SortedDict

_BITS = 10

Thing = TypeVar("Thing")


class Blocks(Generic[Thing]):
    """Each 1024 numbers that follow each other have a table of their own."""

    __slots__ = ("_blocks", "_size")

    def __init__(self) -> None:
        self._blocks: Any = SortedDict()  # number >> _BITS -> the things of these numbers
        self._size = 0

    def __len__(self) -> int:
        """How many entries there are."""
        return self._size

    def __getitem__(self, number: int) -> Thing:
        """Raises KeyError."""
        return self._blocks[number >> _BITS][number]  # type: ignore[no-any-return]

    def __setitem__(self, number: int, thing: Thing) -> None:
        """Add an entry, or replace its thing."""
        block = self._blocks.get(number >> _BITS)
        if block is None:
            block = self._blocks[number >> _BITS] = {}
        self._size += number not in block
        block[number] = thing

    def __delitem__(self, number: int) -> None:
        """Raises KeyError."""
        block = self._blocks[number >> _BITS]
        del block[number]
        self._size -= 1
        if not block:
            del self._blocks[number >> _BITS]

    def get(self, number: int) -> Thing | None:
        """None: there is no such entry."""
        block = self._blocks.get(number >> _BITS)
        return None if block is None else block.get(number)

    def values(self, from_number: int | None = None) -> Iterator[Thing]:
        """In the order of numbers, from `from_number` on. Nobody may add or delete entries meanwhile."""
        for at in self._blocks.irange(minimum=None if from_number is None else from_number >> _BITS):
            block = self._blocks[at]
            for number in sorted(block):
                if from_number is None or number >= from_number:
                    yield block[number]
