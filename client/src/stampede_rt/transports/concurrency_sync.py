"""What the client needs of threads, under names that `concurrency_async` has, too."""

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

Result = TypeVar("Result")
_log = logging.getLogger("stampede_rt")

Mutex = threading.Lock
sleep = time.sleep
monotonic_s = time.monotonic
monotonic_nanos = time.monotonic_ns
thread_id = threading.get_ident


class Turns:
    """Threads find their ways each for itself: they have connections of their own."""

    @contextmanager
    def of(self, key: Hashable, timeout_s: float) -> Iterator[None]:
        """One's own turn, at once."""
        yield


def callers() -> set[int | None]:
    """What `thread_id` gives to those who can still call: the threads that are alive."""
    return {thread.ident for thread in threading.enumerate()}


class Signal:
    """Something happened; whoever waits looks again."""

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


def together(operations: Sequence[Callable[[], Result]]) -> list[Result]:
    """The results of all operations, one after the other; raises what the first one to fail met."""
    return [operation() for operation in operations]


def at_once(operations: Sequence[Callable[[], Result]]) -> list[Result]:
    """The results of all operations, which run at the same time, on threads of their own: they are few and short."""
    if len(operations) < 2:
        return [operation() for operation in operations]
    with ThreadPoolExecutor(len(operations), thread_name_prefix="stampede at once") as pool:
        return [future.result() for future in [pool.submit(operation) for operation in operations]]


def in_thread(operation: Callable[[], Result]) -> Result:
    """The result of an operation that blocks; this thread is the caller's own."""
    return operation()


def begin_now(operation: Callable[[], None]) -> None:
    """Do at once what needs no awaiting."""
    operation()


class Background:
    """Work of the library's own beside the caller's: a daemon thread. It must handle its errors itself."""

    def __init__(self, operation: Callable[[], None], name: str) -> None:
        self._thread = threading.Thread(target=operation, name=f"stampede {name}", daemon=True)
        self._thread.start()

    def join(self, timeout_s: float) -> bool:
        """Block until it has ended, `timeout_s` at most; whether it has. The work itself does not wait for its end."""
        if self._thread is threading.current_thread():
            return False
        self._thread.join(timeout_s)
        return not self._thread.is_alive()


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


class Beginning:
    """What begins by itself in the background. Here it has begun when its maker returns."""


def check_callback(function: object) -> None:
    """Raises InvalidArgument for what cannot be called, and for coroutine functions, which nobody here would run."""
    if not callable(function):
        raise InvalidArgument(f"fn is {function!r}; give a function")
    if inspect.iscoroutinefunction(function):
        raise InvalidArgument(f"fn is the coroutine function {function!r}; give a plain one, or use stampede_rt.aio")


def call_back(function: Callable[..., Any], *arguments: Any) -> Any:
    """The function's result."""
    return function(*arguments)
