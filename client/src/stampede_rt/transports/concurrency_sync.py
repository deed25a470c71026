"""The client's tools for threads. `concurrency_async` has the same names for asyncio."""

from __future__ import annotations

import inspect
import logging
import os
import sys
import threading
import time
import weakref
from collections import deque
from collections.abc import Callable, Hashable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from functools import partial
from math import inf
from queue import SimpleQueue
from typing import Any, TypeVar

from stampede_rt.errors import InvalidArgument
from stampede_rt.transports import forking

END_LIMIT_S = 2.0  # the time that the end of a call or connection may take
LOOK_S = 0.2  # how often the waiting main thread looks for signals

Result = TypeVar("Result")
_log = logging.getLogger("stampede_rt")

Mutex = StepLock = threading.Lock
sleep = time.sleep
monotonic_s = time.monotonic
monotonic_nanos = time.monotonic_ns
thread_id = threading.get_ident


class StepTask:
    """Performs the steps of an iterator. With asyncio a step may outlive a caller that cancels it."""

    def run(self, step: Callable[[], None]) -> None:
        """Perform the step."""
        step()


class KeyedLock:
    """Locks nothing, because each thread finds and caches its own bindings."""

    @contextmanager
    def hold(self, key: Hashable, timeout_s: float) -> Iterator[None]:
        """Continue immediately."""
        yield


def live_thread_ids() -> set[int | None]:
    """Return the ids of the threads that are alive."""
    return {thread.ident for thread in threading.enumerate()}


def wait_in_parts(wait: Callable[[float | None], bool], timeout_s: float | None) -> bool:
    """Call `wait` until it returns True, for at most `timeout_s`. Returns the last value that `wait` returned.

    Only the main thread runs handlers of signals, such as the handler of Ctrl-C, and it runs none inside a wait for a
    lock. The system ends that wait for a signal, but not if the signal comes just before the wait begins, or at another
    thread. Therefore the main thread waits for LOOK_S at a time.
    """
    if threading.current_thread() is not threading.main_thread():
        return wait(timeout_s)
    ends_s = inf if timeout_s is None else time.monotonic() + timeout_s
    while not wait(max(0.0, min(LOOK_S, ends_s - time.monotonic()))):
        if time.monotonic() >= ends_s:
            return False
    return True


class Signal:
    """A flag that callers can wait for. After each wait a caller must check whether its own condition holds.

    `set` and `clear` wait for nothing, also if they interrupt each other on one thread, as a signal handler may.
    """

    def __init__(self) -> None:
        self._is_set = False
        self._round = object()  # a new one after each `set`
        self._waiting: deque[threading.Lock] = deque()  # one for each waiting caller, who waits until it is released

    def set(self) -> None:
        """Wake all waiting callers, also if `clear` follows immediately."""
        self._is_set, self._round = True, object()
        with suppress(IndexError):  # another thread has woken them
            for _ in range(len(self._waiting)):
                self._waiting.popleft().release()

    def clear(self) -> None:
        """Make later waits block again."""
        self._is_set = False

    def wait(self, timeout_s: float | None) -> bool:
        """Wait until `set`, for at most `timeout_s`. Returns whether it is set, or was set meanwhile."""
        return wait_in_parts(partial(self._wait, self._round), timeout_s)

    def _wait(self, since: object, timeout_s: float | None) -> bool:
        woken = threading.Lock()
        woken.acquire()
        self._waiting.append(woken)
        try:
            if not self._is_set and self._round is since:
                woken.acquire(timeout=-1 if timeout_s is None else max(timeout_s, 0.0))
        finally:
            with suppress(ValueError):  # `set` has taken it
                self._waiting.remove(woken)
        return self._is_set or self._round is not since


class Steps:
    """Runs short steps one after the other, even if several threads call. A step waits for nothing.

    A signal handler or `__del__` may run a step, also if it interrupts another step on its thread. The interrupted call
    then runs the new step at its end.
    """

    def __init__(self) -> None:
        self._mutex = threading.RLock()
        self._waiting: deque[Callable[[], None]] = deque()
        self._runner = 0  # the thread that runs a step

    @property
    def is_interrupted(self) -> bool:
        """Whether the calling code interrupts a step that runs on the same thread."""
        # An exception of a signal handler may end a step before it resets `_runner`. So the lock decides as well.
        return self._runner == threading.get_ident() and self._mutex._is_owned()  # type: ignore[attr-defined]

    def run(self, step: Callable[..., None], *arguments: Any) -> None:
        """Run the step before this call returns, unless the caller interrupts another step. Waits for other threads."""
        if self.is_interrupted:
            self._waiting.append(partial(step, *arguments))
            return
        with self._mutex:
            if self._waiting:
                self._run_waiting()  # other calls have offered these steps before
            try:
                self._runner = threading.get_ident()
                step(*arguments)
            finally:
                self._runner = 0
        while self._waiting and not self.is_interrupted:
            with self._mutex:
                self._run_waiting()

    def offer(self, step: Callable[..., None], *arguments: Any) -> None:
        """Run the step now, or leave it to the thread that runs a step at present. Waits for nothing.

        Call it only on threads of the client: Ctrl-C could leave the steps locked.
        """
        self._waiting.append(partial(step, *arguments))
        while self._waiting and not self.is_interrupted and self._mutex.acquire(blocking=False):
            try:
                self._run_waiting()
            finally:
                self._mutex.release()

    def _run_waiting(self) -> None:
        """Run all waiting steps. If a signal ends this call, a step that has run may still wait, and run again."""
        try:
            self._runner = threading.get_ident()  # from now on a signal handler only adds steps
            while self._waiting:
                step = self._waiting[0]
                try:
                    step()
                finally:
                    self._waiting.popleft()
        finally:
            self._runner = 0


def run_all(operations: Sequence[Callable[[], Result]]) -> list[Result]:
    """Run all operations, one after the other, and return their results. Raises the first failure.

    The asynchronous counterpart runs them at the same time. `run_concurrently` runs them at the same time in both
    clients.
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


def result_of(future: Future[Result], timeout_s: float | None) -> Result:
    """Return the result of a call that another thread performs. Raises its error, and TimeoutError.

    If the wait ends early, cancels the call, unless it is being performed.
    """
    try:
        return future.result(timeout_s)
    finally:
        future.cancel()  # does nothing if it is done


def begin_if_blocking(operation: Callable[[], None]) -> None:
    """Run `operation` now. In the asynchronous client the first await of the handle runs it."""
    operation()


class BackgroundTask:
    """A daemon thread of the client. `operation` must handle its errors itself."""

    def __init__(self, operation: Callable[[], None], name: str) -> None:
        self._thread = threading.Thread(target=operation, name=f"stampede {name}", daemon=True)
        self._thread.start()

    def join(self, timeout_s: float) -> bool:
        """Wait until the thread has ended, for at most `timeout_s`.

        Returns whether it has; False if the thread calls this itself.
        """
        return self._thread is not threading.current_thread() and wait_in_parts(self._ended, timeout_s)

    def _ended(self, timeout_s: float | None) -> bool:
        self._thread.join(timeout_s)
        return not self._thread.is_alive()


def within_limit(operation: Callable[[], object], limit_s: float = END_LIMIT_S) -> bool:
    """Run `operation` on a new thread, and wait for at most `limit_s` seconds until it has ended.

    Returns whether it has ended. Use this for operations that take locks of gRPC: if a signal handler has raised an
    exception inside gRPC's code, such a lock may stay locked for ever. While the interpreter ends, this function only
    returns False, because Python no longer runs new threads, and `Thread.start` would wait for ever.
    """
    if sys.is_finalizing():
        return False
    thread = threading.Thread(target=operation, name="stampede ends a call", daemon=True)
    try:
        thread.start()
    except RuntimeError:  # the interpreter is ending, and starts no new threads
        return False
    thread.join(limit_s)
    return not thread.is_alive()


class _LastOperations:
    """Runs the last operations of deleted objects on a daemon thread. The first operation starts the thread.

    Python deletes objects on any thread, while any lock may be held, also a lock of gRPC. At that moment this class
    only notes the operation.
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
            except Exception:  # noqa: BLE001  # a defect in one operation must not stop the others
                _log.exception("an object that the program has dropped could not be closed")
            del operation  # the operation references the closed object


_dropped = _LastOperations()


def _after_fork() -> None:
    """In a forked child, forget the thread and the noted operations, because they belong to the parent."""
    global _dropped
    _dropped = _LastOperations()


os.register_at_fork(after_in_child=_after_fork)


def when_dropped(owner: object, operation: Callable[[], object]) -> None:
    """Run `operation` on a thread of the client when no code references `owner`.

    `operation` itself must not reference `owner`.
    """
    _dropped.start()
    finalizer = weakref.finalize(owner, _dropped.operations.put, operation)
    finalizer.atexit = False


def run_later(operation: Callable[[], object]) -> None:
    """Run `operation` on the thread that `when_dropped` has started. Does not wait, even if the caller holds locks."""
    _dropped.operations.put(operation)


def from_any_thread(operation: Callable[..., None]) -> Callable[..., None]:
    """Return a function that any thread may call: `operation` itself."""
    return operation


class EventLoopCheck:
    """Checks nothing, because any thread may use a blocking connection."""

    def check_thread(self) -> None:
        """Do nothing."""


def process_check(made_at: int, _event_loop: EventLoopCheck) -> Callable[[], None]:
    """Return the function that raises ForkedProcess in a forked child. `made_at`: see `forking.check`."""
    return partial(forking.check, made_at)


class BackgroundStart:
    """A handle that has started when the program gets it. The handle of the asyncio client starts in the background."""


def check_callback(function: object) -> None:
    """Raise InvalidArgument if `function` is not a function, or is a coroutine function."""
    if not callable(function):
        raise InvalidArgument(f"fn is {function!r}; give a function")
    if inspect.iscoroutinefunction(function):
        raise InvalidArgument(f"fn is the coroutine function {function!r}; give a plain one, or use stampede_rt.aio")


def call_back(function: Callable[..., Any], *arguments: Any) -> Any:
    """Call the function and return its result."""
    return function(*arguments)
