"""What the client needs of threads, under names that `concurrency_async` has, too."""

from __future__ import annotations

import inspect
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

from stampede_rt.errors import InvalidArgument

Result = TypeVar("Result")

Mutex = threading.Lock
sleep = time.sleep
monotonic_s = time.monotonic
monotonic_nanos = time.monotonic_ns
thread_id = threading.get_ident


def callers() -> set[int | None]:
    """The ids that `thread_id` gives to those who can still call: the threads that are alive."""
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
