"""A parser under test: it gets any bytes, and must return a result or raise one of its documented errors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from tests.robustness.fuzz.drawing import ByteSource


@dataclass(frozen=True)
class Target:
    """`parse` draws its input, calls the parser, and checks the result.

    `refusals` are the errors that it may raise. Any other error is a finding.
    """

    name: str
    parse: Callable[[ByteSource], None]
    refusals: tuple[type[BaseException], ...]

    def __call__(self, data: bytes) -> bool:
        """Whether the parser accepted the input. Raises every other error: it is a finding."""
        try:
            self.parse(ByteSource(data))
        except self.refusals:
            return False
        return True
