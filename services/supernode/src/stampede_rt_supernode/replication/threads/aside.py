"""Work that is done aside, so that the log's own thread need not stand still for it."""

from __future__ import annotations

import sys
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Protocol, TypeVar

SWITCH_SECONDS, USUAL_SWITCH_SECONDS = 0.0005, sys.getswitchinterval()

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


class AsideThread:
    """A thread for it, which gives way to the others soon.

    The log's thread waits for the disk many times in a step, and after each for the thread that computes: with the 5 ms
    of Python's default the longest step beside the encoding of 100,000 channels took 200 ms, now 20. At other times the
    default stays, since more switches cost the service a tenth of its speed.
    """

    def __init__(self) -> None:
        self._executor = ThreadPoolExecutor(1, thread_name_prefix="aside")

    def run(self, work: Callable[[], T], /) -> Result[T]:
        """See RunAside."""
        return self._executor.submit(_giving_way, work)

    def close(self) -> None:
        """Begin nothing any more; the thread ends with the process, and what it gives is thrown away."""
        self._executor.shutdown(wait=False, cancel_futures=True)


def _giving_way(work: Callable[[], T]) -> T:
    sys.setswitchinterval(SWITCH_SECONDS)
    try:
        return work()
    finally:
        sys.setswitchinterval(USUAL_SWITCH_SECONDS)
