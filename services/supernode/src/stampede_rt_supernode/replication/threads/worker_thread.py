"""Runs long work on a thread of its own, so that the log's thread can continue."""

from __future__ import annotations

import sys
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Protocol, TypeVar

SWITCH_SECONDS, USUAL_SWITCH_SECONDS = 0.0005, sys.getswitchinterval()

T = TypeVar("T")
T_co = TypeVar("T_co", covariant=True)


class Result(Protocol[T_co]):
    """The result of work on another thread."""

    def done(self) -> bool:
        """Whether the work is finished."""

    def result(self) -> T_co:
        """The result of the finished work. Raises the error of the work."""


class RunInBackground(Protocol):
    """Gives work to another thread, which does the work of one call after the other."""

    def __call__(self, work: Callable[[], T], /) -> Result[T]:
        """Give `work` to the thread. Never blocks."""


def run_inline(work: Callable[[], T], /) -> Result[T]:
    """Do the work on the caller's thread, before this function returns: a RunInBackground without a second thread."""
    finished: Future[T] = Future()
    finished.set_result(work())
    return finished


class WorkerThread:
    """One thread for long work. During the work Python switches between threads every SWITCH_SECONDS.

    The log's thread waits for the disk many times in one step of the replica. After each wait it also waits until the
    worker thread releases Python's global lock. With Python's default switch interval of 5 ms, the longest step during
    the encoding of 100,000 channels took 200 ms; now it takes 20 ms. Without long work Python keeps the default
    interval, because more switches cost the service a tenth of its speed.
    """

    def __init__(self) -> None:
        self._executor = ThreadPoolExecutor(1, thread_name_prefix="replicated-log-worker")

    def run(self, work: Callable[[], T], /) -> Result[T]:
        """See RunInBackground."""
        return self._executor.submit(_giving_way, work)

    def close(self) -> None:
        """Begin no more work. Does not wait for the work that has begun: no code uses its result."""
        self._executor.shutdown(wait=False, cancel_futures=True)


def _giving_way(work: Callable[[], T]) -> T:
    sys.setswitchinterval(SWITCH_SECONDS)
    try:
        return work()
    finally:
        sys.setswitchinterval(USUAL_SWITCH_SECONDS)
