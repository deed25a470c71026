"""Calls that are cancelled and timed out at random, and must end in any case."""

from __future__ import annotations

import asyncio
import inspect
import random
from collections.abc import Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

import stampede_rt as st

BOUND_S = 30.0
"""A call may exceed its own time by this much. The client tries for 10 s, its last try may take another 10 s, and a
connection takes up to 3 s.
"""
INTERRUPTED = object()
FAILED = object()
ENDED = object()
PASSING = (st.Unavailable, st.DeadlineExceeded, st.Overloaded)


class CallingClient:
    """Makes calls of one client. Calls of the blocking client run in threads."""

    def __init__(self, seed: str, pool: ThreadPoolExecutor | None) -> None:
        self.rng = random.Random(seed)
        self._pool = pool
        self.calls = self.interrupted = self.failed = 0

    @property
    def is_async(self) -> bool:
        """Whether calls can be cancelled."""
        return self._pool is None

    async def plain(self, function: Callable[..., Any], *arguments: Any, **named: Any) -> Any:
        """The result of one call."""
        if self._pool is not None:
            loop = asyncio.get_running_loop()
            return await loop.run_in_executor(self._pool, partial(function, *arguments, **named))
        result = function(*arguments, **named)
        return await result if inspect.isawaitable(result) else result

    async def step(self, iterator: Any) -> Any:
        """The next result of an iterator of the client; ENDED after its end."""
        if self._pool is not None:
            return await self.plain(next, iterator, ENDED)
        return await anext(iterator, ENDED)

    async def outcome(self, what: str, call: Awaitable[Any], own_s: float = 0.0, *, endless: bool = False) -> Any:
        """Wait for the call, and cancel some calls at a random moment. Returns the result, INTERRUPTED or FAILED.

        `endless`: the call may wait for ever, so an asyncio client always cancels it. Raises AssertionError if the call
        hangs, or fails with an error that no broken network explains.
        """
        self.calls += 1
        task = asyncio.ensure_future(call)
        if self.is_async and (endless or self.rng.random() < 0.4):
            await self.interrupt(task)
        return await self.ended(what, task, own_s)

    async def interrupt(self, task: asyncio.Future[Any]) -> None:
        """Cancel at one of the first steps of the event loop, or some time later."""
        if self.rng.random() < 0.5:
            for _ in range(self.rng.randrange(40)):
                await asyncio.sleep(0)
        else:
            await asyncio.wait([task], timeout=self.rng.random() ** 3)
        task.cancel()

    async def ended(self, what: str, task: asyncio.Future[Any], own_s: float) -> Any:
        """The outcome of the call."""
        await asyncio.wait([task], timeout=own_s + BOUND_S)
        if not task.done():
            stack = task.get_stack() if isinstance(task, asyncio.Task) else ""
            raise AssertionError(f"{what} hangs: {stack}")
        if task.cancelled():
            self.interrupted += 1
            return INTERRUPTED
        error = task.exception()
        if error is None:
            return task.result()
        if not isinstance(error, PASSING):
            raise AssertionError(f"{what} failed with an error that no broken network explains") from error
        self.failed += 1
        return FAILED
