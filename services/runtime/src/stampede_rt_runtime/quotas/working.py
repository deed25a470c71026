"""The work of a stream or call at its event loop, step by step, each when it is the turn of its caller."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from functools import partial

from stampede_rt_runtime.quotas.accounts import Account
from stampede_rt_runtime.quotas.turns import Turns

READ_NANOS = 40_000
WRITE_NANOS = 150_000
CALL_NANOS = 400_000
"""gRPC takes about so much for reading a message, for writing one, and for a call, beside the steps that are
measured."""


def loop_turns() -> Turns:
    """The turns of the running event loop's callers."""
    return Turns(time.monotonic_ns, _schedule)


def _schedule(delay_s: float, call: Callable[[], None]) -> object:
    loop = asyncio.get_running_loop()
    return loop.call_later(delay_s, call) if delay_s else loop.call_soon(call)


class CallerWork:
    """Of one stream. Before a step: `if work.must_wait: await work.turn()`; then `begin`, and `end` before it awaits.

    That costs a put about half a microsecond while its caller is alone.
    """

    __slots__ = ("_began_at", "_turn")

    def __init__(self, account: Account) -> None:
        self._turn = account.turn
        self._began_at = 0

    @property
    def must_wait(self) -> bool:
        """Whether the next step is not its caller's turn yet."""
        return self._turn is not None and self._turn.must_wait

    async def turn(self) -> None:
        """Wait for it."""
        assert self._turn is not None, "only who has turns waits for them"
        came: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._turn.stand(partial(_set_unless_done, came))
        await came

    def begin(self) -> None:
        """A step begins."""
        self._began_at = time.monotonic_ns()

    def end(self, more_nanos: int = READ_NANOS) -> None:
        """The step has ended, or awaits something. `more_nanos`: taken by gRPC."""
        if self._turn is not None:
            self._turn.spend(time.monotonic_ns() - self._began_at + more_nanos)

    def count_call(self) -> None:
        """A call has come."""
        if self._turn is not None:
            self._turn.spend(CALL_NANOS)


def _set_unless_done(came: asyncio.Future[None]) -> None:
    """Who waited may have been cancelled."""
    if not came.done():
        came.set_result(None)
