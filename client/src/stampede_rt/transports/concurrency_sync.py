"""The client's tools for threads. `concurrency_async` has the same names for asyncio."""

from __future__ import annotations

import inspect
import logging
import os
import threading
import time
import weakref
from collections.abc import Callable, Hashable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from queue import SimpleQueue
from typing import Any, TypeVar

from stampede_rt.errors import InvalidArgument

END_LIMIT_S = 2.0  # for ending calls and connections

Result = TypeVar("Result")
_log = logging.getLogger("stampede_rt")

Mutex = threading.Lock
sleep = time.sleep
monotonic_s = time.monotonic
monotonic_nanos = time.monotonic_ns
thread_id = threading.get_ident


class KeyedLock:
    """Locks nothing: each thread has connections of its own and looks for its channels itself."""

    @contextmanager
    def hold(self, key: Hashable, timeout_s: float) -> Iterator[None]:
        """Go on at once."""
        yield


def live_thread_ids() -> set[int | None]:
    """The ids of the threads that are alive."""
    return {thread.ident for thread in threading.enumerate()}


class Signal:
    """A flag that callers can wait for. A woken caller looks again at the state that it waits for."""

    def __init__(self) -> None:
        self._event = threading.Event()

    def set(self) -> None:
        """Wake all that wait."""
        self._event.set()

    def clear(self) -> None:
        """From now on waits block again."""
        self._event.clear()

    def wait(self, timeout_s: float | None) -> bool:
        """Block until `set`, `timeout_s` at most; whether it was set."""
        return self._event.wait(timeout_s)


def run_all(operations: Sequence[Callable[[], Result]]) -> list[Result]:
    """Run all operations, one after the other, and return their results. Raises the first failure.

    The asynchronous counterpart runs them at the same time; `run_concurrently` does so in both clients.
    """
    return [operation() for operation in operations]


def run_concurrently(operations: Sequence[Callable[[], Result]]) -> list[Result]:
    """Run a few short operations at the same time, each on its own thread, and return their results."""
    if len(operations) < 2:
        return [operation() for operation in operations]
    with ThreadPoolExecutor(len(operations), thread_name_prefix="stampede call") as pool:
        return [future.result() for future in [pool.submit(operation) for operation in operations]]


def in_thread(operation: Callable[[], Result]) -> Result:
    """Run a blocking operation on the calling thread and return its result."""
    return operation()


def begin_if_blocking(operation: Callable[[], None]) -> None:
    """Run `operation` now. In the asynchronous client the first await of the handle runs it."""
    operation()


class BackgroundTask:
    """Work of the library beside the caller's: a daemon thread. It must handle its errors itself."""

    def __init__(self, operation: Callable[[], None], name: str) -> None:
        self._thread = threading.Thread(target=operation, name=f"stampede {name}", daemon=True)
        self._thread.start()

    def join(self, timeout_s: float) -> bool:
        """Block until it has ended, at most `timeout_s`. Returns whether it has; False if the work itself asks."""
        if self._thread is threading.current_thread():
            return False
        self._thread.join(timeout_s)
        return not self._thread.is_alive()


def within_limit(operation: Callable[[], object], limit_s: float = END_LIMIT_S) -> None:
    """Run what takes locks of gRPC's to end something, and wait `limit_s` at most.

    An exception that a signal's handler raised in gRPC's code may have left such a lock locked for good.
    """
    thread = threading.Thread(target=operation, name="stampede ends a call", daemon=True)
    try:
        thread.start()
    except RuntimeError:  # the interpreter ends, and starts no more threads
        return
    thread.join(limit_s)


class _Dropped:
    """Runs what is left to do for objects that nobody holds any more, on a daemon thread that starts with the first.

    Objects are dropped on any thread, with any lock held, gRPC's own among them: there nothing may be done but this.
    """

    def __init__(self) -> None:
        self.operations: SimpleQueue[Callable[[], object]] = SimpleQueue()
        self._mutex = threading.Lock()
        self._started = False

    def start(self) -> None:
        with self._mutex:
            if not self._started:
                threading.Thread(target=self._run, name="stampede dropped", daemon=True).start()
                self._started = True

    def _run(self) -> None:
        while True:
            operation = self.operations.get()
            try:
                operation()
            except Exception:  # noqa: BLE001  # a defect of one must not keep the others open
                _log.exception("something that nobody uses any more could not be closed")
            del operation  # holds what it closed


_dropped = _Dropped()


def _after_fork() -> None:
    """The thread is the parent's; what it would have closed is, too."""
    global _dropped
    _dropped = _Dropped()


os.register_at_fork(after_in_child=_after_fork)


def when_dropped(owner: object, operation: Callable[[], object]) -> None:
    """Run `operation`, which must not hold `owner`, on a thread of the library's own once nobody holds `owner`."""
    _dropped.start()
    finalizer = weakref.finalize(owner, _dropped.operations.put, operation)
    finalizer.atexit = False


class BackgroundStart:
    """A handle that begins in the background. Here it has begun once the method that makes it returns."""


def check_callback(function: object) -> None:
    """Raises InvalidArgument for what cannot be called, and for coroutine functions, which nobody here would run."""
    if not callable(function):
        raise InvalidArgument(f"fn is {function!r}; give a function")
    if inspect.iscoroutinefunction(function):
        raise InvalidArgument(f"fn is the coroutine function {function!r}; give a plain one, or use stampede_rt.aio")


def call_back(function: Callable[..., Any], *arguments: Any) -> Any:
    """The function's result."""
    return function(*arguments)
