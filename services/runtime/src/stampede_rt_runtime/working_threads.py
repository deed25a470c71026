"""Threads for calls that block. They also work after the main thread of the program has ended."""

from __future__ import annotations

import threading
import weakref
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from queue import SimpleQueue
from typing import Any, ParamSpec, TypeVar

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")
_Calls = SimpleQueue[tuple[Future[Any], Callable[[], Any]] | None]


class WorkingThreads(ThreadPoolExecutor):
    """A pool of threads that takes calls until `shutdown`. The interpreter does not wait for its threads.

    The class `ThreadPoolExecutor` refuses all calls after the main thread has ended. A host inside a program leaves the
    cluster at that time, and still needs threads. This class has `ThreadPoolExecutor` as its base class only because an
    event loop accepts no other class as its default executor.
    """

    def __init__(self, max_workers: int, thread_name_prefix: str) -> None:
        super().__init__(max_workers, thread_name_prefix)
        self._threads_max, self._name = max_workers, thread_name_prefix
        self._calls: _Calls = SimpleQueue()
        self._free = threading.Semaphore(0)  # counts the threads that wait for a call
        self._started_threads: list[threading.Thread] = []
        self._guard = threading.Lock()
        self._end = weakref.finalize(self, self._calls.put, None)
        self._end.atexit = False

    def submit(
        self, fn: Callable[Arguments, Result], /, *args: Arguments.args, **kwargs: Arguments.kwargs
    ) -> Future[Result]:
        """See the base class. Raises RuntimeError after `shutdown`."""
        answer: Future[Result] = Future()
        with self._guard:
            if not self._end.alive:
                raise RuntimeError(f"the threads {self._name} have been shut down")
            self._calls.put((answer, partial(fn, *args, **kwargs)))
            if len(self._started_threads) < self._threads_max and not self._free.acquire(blocking=False):
                self._make_thread()
        return answer

    def _make_thread(self) -> None:
        thread = threading.Thread(
            target=_work,
            args=(self._calls, self._free),
            name=f"{self._name}_{len(self._started_threads)}",
            daemon=True,
        )
        self._started_threads.append(thread)
        thread.start()

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the threads after they have performed all submitted calls.

        `cancel_futures`: cancel the calls that no thread has begun.
        """
        with self._guard:
            if cancel_futures:
                while not self._calls.empty():
                    call = self._calls.get()
                    if call is not None:
                        call[0].cancel()
            self._end()
        if wait:
            for thread in self._started_threads:
                thread.join()


def _work(calls: _Calls, free: threading.Semaphore) -> None:
    """Perform calls until None comes."""
    while (taken := calls.get()) is not None:
        answer, call = taken
        if answer.set_running_or_notify_cancel():
            try:
                answer.set_result(call())
            except BaseException as error:  # noqa: BLE001  # the caller raises it
                answer.set_exception(error)
        del taken, answer, call  # the next call may come much later
        free.release()
    calls.put(None)  # the next thread that takes a call ends, too
