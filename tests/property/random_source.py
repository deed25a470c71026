"""Choices drawn from one whole number: quick to generate in thousands, and smaller numbers mean simpler choices."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

T = TypeVar("T")


class RandomSource:
    """Each choice takes a digit off the number, in the base of its choices; a used-up number chooses the first."""

    def __init__(self, number: int) -> None:
        self._left = number

    def below(self, sides: int) -> int:
        self._left, digit = divmod(self._left, sides)
        return digit

    def pick(self, choices: Sequence[T]) -> T:
        return choices[self.below(len(choices))]

    def one_in(self, chances: int) -> bool:
        return self.below(chances) == chances - 1
