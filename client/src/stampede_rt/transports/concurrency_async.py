"""What the client needs of asyncio, under names that `concurrency_sync` has, too."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable
from types import TracebackType
from typing import TypeVar

Result = TypeVar("Result")

monotonic_s = time.monotonic


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


def callers() -> set[int]:
    """The ids that `thread_id` gives to those who can still call."""
    return {0}


def thread_id() -> int:
    """What tells callers with connections of their own apart: nothing, since all tasks share the loop's."""
    return 0


def begin_now(operation: Callable[[], Awaitable[None]]) -> None:
    """Do at once what needs no awaiting: on asyncio nothing, the first await does it."""
