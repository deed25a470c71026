"""Random choices that are all drawn from one whole number. Smaller numbers mean simpler choices."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

T = TypeVar("T")


class RandomSource:
    """Each choice takes one digit of the number, in the base of the number of options.

    A used-up number chooses the first option.
    """

    def __init__(self, number: int) -> None:
        self._left = number

    def below(self, sides: int) -> int:
        self._left, digit = divmod(self._left, sides)
        return digit

    def pick(self, choices: Sequence[T]) -> T:
        return choices[self.below(len(choices))]

    def one_in(self, chances: int) -> bool:
        return self.below(chances) == chances - 1
