"""The client's tools for asyncio. `concurrency_sync` has the same names for threads."""

from __future__ import annotations

import asyncio
import inspect
import os
import time
import weakref
from collections.abc import AsyncIterator, Awaitable, Callable, Generator, Hashable, Sequence
from concurrent.futures import Future
from contextlib import asynccontextmanager, suppress
from functools import partial
from types import TracebackType
from typing import Any, Self, TypeVar
from weakref import WeakValueDictionary

from stampede_rt.errors import InvalidArgument, WrongEventLoop
from stampede_rt.transports import forking

Result = TypeVar("Result")
_CALLERS = frozenset((0,))  # all values of `thread_id`
_inherited: list[object] = []  # keeps the parent's operations in a forked child, which must not run or delete them
_running: set[asyncio.Future[None]] = set()  # keeps tasks alive until they are done

StepLock = asyncio.Lock  # lets one step of an iterator run at a time; other callers wait
monotonic_s = time.monotonic
monotonic_nanos = time.monotonic_ns


class Mutex:
    """Does nothing. The blocking client has a lock here, around code that never waits. Tasks of one loop need no lock
    for such code.
    """

    def __enter__(self) -> None:
        return None

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        return None


class Steps:
    """Runs steps immediately. In the blocking client several threads and signal handlers run steps, one by one."""

    is_interrupted = False

    def run(self, step: Callable[..., None], *arguments: Any) -> None:
        """Run the step."""
        step(*arguments)

    def offer(self, step: Callable[..., None], *arguments: Any) -> None:
        """Run the step."""
        step(*arguments)


class Signal:
    """A flag that callers can wait for. After each wait a caller must check whether its own condition holds."""

    def __init__(self) -> None:
        self._event = asyncio.Event()

    def set(self) -> None:
        """Wake all waiting callers."""
        self._event.set()

    def clear(self) -> None:
        """Make later waits block again."""
        self._event.clear()

    async def wait(self, timeout_s: float | None) -> bool:
        """Wait until `set`, for at most `timeout_s`. Returns whether it is set."""
        try:
            async with asyncio.timeout(timeout_s):
                await self._event.wait()
        except TimeoutError:
            return False
        return True


async def sleep(delay_s: float) -> None:
    """Wait for `delay_s` seconds."""
    await asyncio.sleep(delay_s)


async def in_thread(operation: Callable[[], Result]) -> Result:
    """Run a blocking operation on a worker thread and return its result."""
    return await asyncio.to_thread(operation)


async def result_of(future: Future[Result], timeout_s: float | None) -> Result:
    """Return the result of a call that another thread performs. Raises its error, and TimeoutError.

    If the wait ends early, cancels the call, unless it is being performed.
    """
    async with asyncio.timeout(timeout_s):
        return await asyncio.wrap_future(future)


async def run_all(operations: Sequence[Callable[[], Awaitable[Result]]]) -> list[Result]:
    """Run all operations at the same time and return their results. Raises the first failure.

    The blocking counterpart runs them one after the other. `run_concurrently` runs them at the same time in both
    clients.
    """
    tasks = [asyncio.ensure_future(operation()) for operation in operations]
    try:
        return await asyncio.gather(*tasks)
    finally:
        for task in tasks:
            task.cancel()


run_concurrently = run_all


class StepTask:
    """Performs the steps of an iterator. Even a caller that cancels each of its steps gets items in the end.

    Usually a step runs in the task of its caller, and ends with this task. After a caller has cancelled a step, further
    steps run in tasks of their own, which continue without their callers. The next caller waits for the step under way.
    Otherwise a caller with a short timeout would begin the opening of a stream again and again, and never get an item.
    """

    def __init__(self) -> None:
        self._outlives_callers = False
        self._under_way: asyncio.Future[None] | None = None

    async def run(self, step: Callable[[], Awaitable[None]]) -> None:
        """Perform the step, or wait for the step under way. Only one caller at a time may call this."""
        if not self._outlives_callers:
            try:
                await step()
            except asyncio.CancelledError:
                self._outlives_callers = True
                raise
            return
        if self._under_way is None:
            self._under_way = asyncio.ensure_future(step())
            _running.add(self._under_way)
            self._under_way.add_done_callback(_ended)
        under_way = self._under_way
        try:
            await asyncio.shield(under_way)
        finally:
            if under_way.done():
                self._under_way = None


def _ended(task: asyncio.Future[None]) -> None:
    _running.discard(task)
    if not task.cancelled():
        task.exception()  # otherwise asyncio logs the error, which the next step raises in any case


class KeyedLock:
    """One lock for each key. If several callers need the same binding, only the first asks for it; the others wait."""

    def __init__(self) -> None:
        self._locks: WeakValueDictionary[Hashable, asyncio.Lock] = WeakValueDictionary()

    @asynccontextmanager
    async def hold(self, key: Hashable, timeout_s: float) -> AsyncIterator[None]:
        """Hold the lock of `key` during the block. If it is not free after `timeout_s`, the block runs without it."""
        lock, held = self._locks.setdefault(key, asyncio.Lock()), True
        try:
            async with asyncio.timeout(timeout_s):
                await lock.acquire()
        except TimeoutError:
            held = False
        try:
            yield
        finally:
            if held:
                lock.release()


def live_thread_ids() -> frozenset[int]:
    """Return the values of `thread_id` whose callers are alive."""
    return _CALLERS


def thread_id() -> int:
    """Return the key of the caller's bindings and streams. It is always 0, because all tasks of a loop share them."""
    return 0


def begin_if_blocking(operation: Callable[[], Awaitable[None]]) -> None:
    """Do nothing: an asyncio handle runs `operation` at its first await. In the blocking client this call runs it."""


class EventLoopCheck:
    """Remembers the event loop of its first check, and refuses every other loop.

    gRPC's connections and asyncio's locks belong to one loop. On another loop their users would wait for ever.
    """

    def __init__(self) -> None:
        self._loop: asyncio.AbstractEventLoop | None = None

    def check(self) -> None:
        """Raise WrongEventLoop on another event loop. Does nothing if the calling thread runs no loop."""
        try:
            running = asyncio.get_running_loop()
        except RuntimeError:
            return
        if self._loop is None:
            self._loop = running
        elif running is not self._loop:
            raise WrongEventLoop(
                "this connection belongs to another event loop; connect once on each loop, or send coroutines to the "
                "connection's loop with asyncio.run_coroutine_threadsafe"
            )

    def check_thread(self) -> None:
        """Raise WrongEventLoop unless this thread runs the loop at present.

        asyncio does not notice a call from another thread. The loop may then sleep on, and not act on the call.
        """
        try:
            running = asyncio.get_running_loop()
        except RuntimeError:
            running = None
        if self._loop is not None and running is not self._loop and (running is not None or self._loop.is_running()):
            raise WrongEventLoop(
                "this handle belongs to the event loop of another thread; call the method there, with "
                "loop.call_soon_threadsafe"
            )


def process_check(made_at: int, event_loop: EventLoopCheck) -> Callable[[], None]:
    """Return the function that raises ForkedProcess in a forked child, and WrongEventLoop on another event loop.

    `made_at`: see `forking.check`.
    """

    def check() -> None:
        forking.check(made_at)
        event_loop.check()

    return check


class BackgroundTask:
    """A task of the client. `operation` must handle its errors itself."""

    def __init__(self, operation: Callable[[], Awaitable[None]], name: str) -> None:
        self._task = asyncio.ensure_future(operation())
        _running.add(self._task)
        self._task.add_done_callback(_running.discard)
        if isinstance(self._task, asyncio.Task):
            self._task.set_name(f"stampede {name}")

    async def join(self, timeout_s: float) -> bool:
        """Wait until the task has ended, for at most `timeout_s`.

        Returns whether it has; False if the task calls this itself.
        """
        if self._task is asyncio.current_task():
            return False
        ended, _ = await asyncio.wait((self._task,), timeout=timeout_s)
        return bool(ended)


def when_dropped(owner: object, operation: Callable[[], Awaitable[None]]) -> None:
    """Run `operation` on this loop when no code references `owner`. `operation` itself must not reference `owner`.

    Python may delete `owner` on any thread, while that thread holds any lock. This is why `operation` runs on the loop.
    If the loop has ended before, `operation` does not run.
    """
    finalizer = weakref.finalize(owner, _run_soon, asyncio.get_running_loop(), os.getpid(), operation)
    finalizer.atexit = False


def _run_soon(loop: asyncio.AbstractEventLoop, pid: int, operation: Callable[[], Awaitable[None]]) -> None:
    if pid != os.getpid():  # a forked child: the loop is the parent's, and closing its streams may hang
        _inherited.append(operation)
        return
    with suppress(RuntimeError):  # the loop has ended with all its streams
        loop.call_soon_threadsafe(BackgroundTask, operation, "closing")


def from_any_thread(operation: Callable[..., Awaitable[None]]) -> Callable[..., None]:
    """Return a function that any thread may call. It runs `operation` on this loop, one call after the other.

    `operation` must handle its errors itself. If the loop has ended, `operation` does not run.
    """
    loop = asyncio.get_running_loop()

    def call(*arguments: Any) -> None:
        with suppress(RuntimeError):  # the loop has ended
            loop.call_soon_threadsafe(BackgroundTask, partial(operation, *arguments), "callback")

    return call


class BackgroundStart:
    """A handle that starts in the background. `await` on it waits for the start."""

    async def _wait_for_start(self) -> None:
        raise NotImplementedError

    async def _await(self) -> Self:
        await self._wait_for_start()
        return self

    def __await__(self) -> Generator[Any, None, Self]:
        return self._await().__await__()


def check_callback(function: object) -> None:
    """Raise InvalidArgument for an object that is neither a function nor a coroutine function."""
    if not callable(function):
        raise InvalidArgument(f"fn is {function!r}; give a function")


async def call_back(function: Callable[..., Any], *arguments: Any) -> Any:
    """Call a function or coroutine function and return its result. A plain function blocks the loop while it runs."""
    result = function(*arguments)
    if not inspect.isawaitable(result):
        return result
    try:
        return await result
    except asyncio.CancelledError as error:
        task = asyncio.current_task()
        if task is not None and task.cancelling():
            raise
        raise RuntimeError(
            "the function awaited something that was cancelled"
        ) from error  # the function failed; this task was not cancelled
