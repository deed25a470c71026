"""Makes random choices from bytes, which a fuzzer, a seed or a stored input gives. Targets need no other input."""

from __future__ import annotations

import random
from collections.abc import Sequence
from typing import TypeVar

T = TypeVar("T")


class ByteSource:
    """Gives numbers and bytes from `data`, and zeros at its end.

    At the end `choice` gives the first option, and `chance` gives False.
    """

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._at = 0

    @property
    def left(self) -> int:
        """The number of bytes that have not been used."""
        return len(self._data) - self._at

    def take(self, count: int) -> bytes:
        """The next bytes, fewer at the end."""
        taken = self._data[self._at : self._at + count]
        self._at += len(taken)
        return taken

    def rest(self) -> bytes:
        """The remaining bytes."""
        return self.take(self.left)

    def below(self, bound: int) -> int:
        """A number from 0 to `bound` - 1."""
        width = ((bound - 1).bit_length() + 7) // 8
        return int.from_bytes(self.take(width)) % bound

    def chance(self, percent: int) -> bool:
        """True in this number of 100 cases."""
        return self.below(100) >= 100 - percent

    def choice(self, among: Sequence[T]) -> T:
        """One of the options."""
        return among[self.below(len(among))]


def drawn_bytes(random_source: random.Random, most: int = 400) -> bytes:
    """Input for a target without coverage guidance: mostly short."""
    return random_source.randbytes(random_source.randint(0, random_source.choice((20, 80, most))))
