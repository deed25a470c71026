"""Threads for calls that block, which also work after the main thread of the program has ended."""

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
    """As its base class, but it takes calls until `shutdown`, and the interpreter does not wait for its threads.

    The base class refuses all calls once the main thread has ended. A host inside a program has its last work to do
    then. (An event loop takes only this base class for its default executor.)
    """

    def __init__(self, max_workers: int, thread_name_prefix: str) -> None:
        super().__init__(max_workers, thread_name_prefix)
        self._most, self._name = max_workers, thread_name_prefix
        self._calls: _Calls = SimpleQueue()
        self._free = threading.Semaphore(0)  # counts the threads that wait for a call
        self._made: list[threading.Thread] = []
        self._guard = threading.Lock()
        self._end = weakref.finalize(self, self._calls.put, None)
        self._end.atexit = False

    def submit(
        self, fn: Callable[Arguments, Result], /, *args: Arguments.args, **kwargs: Arguments.kwargs
    ) -> Future[Result]:
        """See the base class. Raises RuntimeError after `shutdown`."""
        told: Future[Result] = Future()
        with self._guard:
            if not self._end.alive:
                raise RuntimeError(f"the threads {self._name} have been shut down")
            self._calls.put((told, partial(fn, *args, **kwargs)))
            if len(self._made) < self._most and not self._free.acquire(blocking=False):
                self._make_thread()
        return told

    def _make_thread(self) -> None:
        made = threading.Thread(
            target=_work,
            args=(self._calls, self._free),
            name=f"{self._name}_{len(self._made)}",
            daemon=True,
        )
        self._made.append(made)
        made.start()

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the threads after the calls that have come. With `cancel_futures`, leaves out those that wait."""
        with self._guard:
            if cancel_futures:
                while not self._calls.empty():
                    call = self._calls.get()
                    if call is not None:
                        call[0].cancel()
            self._end()
        if wait:
            for thread in self._made:
                thread.join()


def _work(calls: _Calls, free: threading.Semaphore) -> None:
    """Perform calls until None comes."""
    while (taken := calls.get()) is not None:
        told, call = taken
        if told.set_running_or_notify_cancel():
            try:
                told.set_result(call())
            except BaseException as error:  # noqa: BLE001  # the caller raises it
                told.set_exception(error)
        del taken, told, call  # the next call may come much later
        free.release()
    calls.put(None)  # for the next thread
