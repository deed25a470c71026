"""Work that is done aside, so that the log's own thread need not stand still for it."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from typing import Protocol, TypeVar

T = TypeVar("T")
T_co = TypeVar("T_co", covariant=True)


class Result(Protocol[T_co]):
    """What becomes of it."""

    def done(self) -> bool:
        """Whether it is finished."""

    def result(self) -> T_co:
        """What it gave, once it is finished. Raises what it raised."""


class RunAside(Protocol):
    """Has work done elsewhere, one piece of it after the other."""

    def __call__(self, work: Callable[[], T], /) -> Result[T]:
        """Begin; never blocks."""


def run_at_once(work: Callable[[], T], /) -> Result[T]:
    """Do the work here and now."""
    finished: Future[T] = Future()
    finished.set_result(work())
    return finished
