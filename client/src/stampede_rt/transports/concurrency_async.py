"""What the client needs of asyncio, under names that `concurrency_sync` has, too."""

from __future__ import annotations

import asyncio
import inspect
import os
import time
import weakref
from collections.abc import AsyncIterator, Awaitable, Callable, Generator, Hashable, Sequence
from contextlib import asynccontextmanager, suppress
from types import TracebackType
from typing import Any, Self, TypeVar
from weakref import WeakValueDictionary

from stampede_rt.errors import InvalidArgument

Result = TypeVar("Result")
_CALLERS = frozenset((0,))
_inherited: list[object] = []
_running: set[asyncio.Future[None]] = set()  # held, so that none is collected before it is done

monotonic_s = time.monotonic
monotonic_nanos = time.monotonic_ns


class Mutex:
    """Guards short sections without waiting inside. Tasks of one loop need no lock for that."""

    def __enter__(self) -> None:
        return None

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        return None


class Signal:
    """Something happened; whoever waits looks again."""

    def __init__(self) -> None:
        self._event = asyncio.Event()

    def set(self) -> None:
        """Wake all that wait."""
        self._event.set()

    def clear(self) -> None:
        """From now on waits block again."""
        self._event.clear()

    async def wait(self, timeout_s: float | None) -> bool:
        """Block until `set`, `timeout_s` at most; whether it was set."""
        try:
            async with asyncio.timeout(timeout_s):
                await self._event.wait()
        except TimeoutError:
            return False
        return True


async def sleep(delay_s: float) -> None:
    """Block for `delay_s`."""
    await asyncio.sleep(delay_s)


async def in_thread(operation: Callable[[], Result]) -> Result:
    """The result of an operation that blocks."""
    return await asyncio.to_thread(operation)


async def together(operations: Sequence[Callable[[], Awaitable[Result]]]) -> list[Result]:
    """The results of all operations, which run at the same time; raises what the first one to fail met."""
    tasks = [asyncio.ensure_future(operation()) for operation in operations]
    try:
        return await asyncio.gather(*tasks)
    finally:
        for task in tasks:
            task.cancel()


at_once = together


class Turns:
    """Those who look for the same thing go one after the other, so that what the first one finds serves all."""

    def __init__(self) -> None:
        self._locks: WeakValueDictionary[Hashable, asyncio.Lock] = WeakValueDictionary()

    @asynccontextmanager
    async def of(self, key: Hashable, timeout_s: float) -> AsyncIterator[None]:
        """One's own turn, or after `timeout_s` beside the one whose turn it is."""
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


def callers() -> frozenset[int]:
    """What `thread_id` gives to those who can still call."""
    return _CALLERS


def thread_id() -> int:
    """What tells callers with connections of their own apart: nothing, since all tasks share the loop's."""
    return 0


def begin_now(operation: Callable[[], Awaitable[None]]) -> None:
    """Do at once what needs no awaiting: on asyncio nothing, the first await does it."""


class Background:
    """Work of the library's own beside the caller's: a task. It must handle its errors itself."""

    def __init__(self, operation: Callable[[], Awaitable[None]], name: str) -> None:
        self._task = asyncio.ensure_future(operation())
        _running.add(self._task)
        self._task.add_done_callback(_running.discard)
        if isinstance(self._task, asyncio.Task):
            self._task.set_name(f"stampede {name}")

    async def join(self, timeout_s: float) -> bool:
        """Block until it has ended, `timeout_s` at most; whether it has. The work itself does not wait for its end."""
        if self._task is asyncio.current_task():
            return False
        ended, _ = await asyncio.wait((self._task,), timeout=timeout_s)
        return bool(ended)


def when_dropped(owner: object, operation: Callable[[], Awaitable[None]]) -> None:
    """Run `operation`, which must not hold `owner`, on this loop once nobody holds `owner`.

    Objects are dropped on any thread, with any lock held, and after the loop's end.
    """
    finalizer = weakref.finalize(owner, _run_soon, asyncio.get_running_loop(), os.getpid(), operation)
    finalizer.atexit = False


def _run_soon(loop: asyncio.AbstractEventLoop, pid: int, operation: Callable[[], Awaitable[None]]) -> None:
    if pid != os.getpid():  # in a forked child the loop is the parent's; letting go of what is open there may hang
        _inherited.append(operation)
        return
    with suppress(RuntimeError):  # the loop has ended, and with it all that was open
        loop.call_soon_threadsafe(Background, operation, "closing")


class Beginning:
    """What begins by itself in the background; awaiting it waits until it has begun."""

    async def _begun(self) -> None:
        raise NotImplementedError

    async def _await(self) -> Self:
        await self._begun()
        return self

    def __await__(self) -> Generator[Any, None, Self]:
        return self._await().__await__()


def check_callback(function: object) -> None:
    """Raises InvalidArgument for what cannot be called. Plain functions and coroutine functions will do."""
    if not callable(function):
        raise InvalidArgument(f"fn is {function!r}; give a function")


async def call_back(function: Callable[..., Any], *arguments: Any) -> Any:
    """The result of a function that may be a coroutine function. A plain one holds up the loop while it runs."""
    result = function(*arguments)
    if not inspect.isawaitable(result):
        return result
    try:
        return await result
    except asyncio.CancelledError as error:
        task = asyncio.current_task()
        if task is not None and task.cancelling():
            raise
        raise RuntimeError("what the function awaited was cancelled") from error  # a failure of its own, not our end
