"""The work of a stream or call on its event loop. Each step of it runs when it is the turn of its caller."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from functools import partial

from stampede_rt_runtime.quotas.accounts import Account
from stampede_rt_runtime.quotas.turns import Turns

READ_NANOS = 40_000
WRITE_NANOS = 250_000
CALL_NANOS = 400_000
"""The approximate time that gRPC takes to read a message, to write a message, and for a call. The measured steps do not
contain this time.
"""


def loop_turns() -> Turns:
    """The turns of the callers of the running event loop."""
    return Turns(time.monotonic_ns, _schedule)


def _schedule(delay_s: float, call: Callable[[], None]) -> object:
    loop = asyncio.get_running_loop()
    return loop.call_later(delay_s, call) if delay_s else loop.call_soon(call)


class CallerWork:
    """The work of one stream or call.

    Before a step: `if work.must_wait: await work.turn()`. Then call `begin`, and call `end` before the step awaits
    anything. This costs a put about half a microsecond while only its caller has work.
    """

    __slots__ = ("_began_at", "_turn")

    def __init__(self, account: Account) -> None:
        self._turn = account.turn
        self._began_at = 0

    @property
    def must_wait(self) -> bool:
        """Whether the next step must wait for its caller's turn."""
        return self._turn is not None and self._turn.must_wait

    async def turn(self) -> None:
        """Wait for the caller's turn."""
        assert self._turn is not None, "an account without turns never waits"
        came: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._turn.stand(partial(_set_unless_done, came))
        await came

    def begin(self) -> None:
        """Note that a step begins."""
        self._began_at = time.monotonic_ns()

    def end(self, more_nanos: int = READ_NANOS) -> None:
        """Note that the step has ended or will await something. `more_nanos`: the time that gRPC takes for it."""
        if self._turn is not None:
            self._turn.spend(time.monotonic_ns() - self._began_at + more_nanos)

    def count_call(self) -> None:
        """Note that a call has come, and count the time that gRPC takes for it."""
        if self._turn is not None:
            self._turn.spend(CALL_NANOS)


def _set_unless_done(came: asyncio.Future[None]) -> None:
    """Wake the waiting step, unless it was cancelled."""
    if not came.done():
        came.set_result(None)
