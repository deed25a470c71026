"""What the client needs of threads, under names that `concurrency_async` has, too."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import TypeVar

Result = TypeVar("Result")

Mutex = threading.Lock
sleep = time.sleep
monotonic_s = time.monotonic
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


def in_thread(operation: Callable[[], Result]) -> Result:
    """The result of an operation that blocks; this thread is the caller's own."""
    return operation()


def begin_now(operation: Callable[[], None]) -> None:
    """Do at once what needs no awaiting."""
    operation()
