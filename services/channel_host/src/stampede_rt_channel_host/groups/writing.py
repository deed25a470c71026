"""The writing side of a stream of events: the turns of its caller, a time limit for each write, and signs of life."""

from __future__ import annotations

import asyncio

from stampede_rt.errors import Overloaded
from stampede_rt_channel_host.channels.subscriptions.subscription import WRITE_SECONDS_MAX
from stampede_rt_runtime.access.control import current_work
from stampede_rt_runtime.rpc import Context

SIGN_OF_LIFE_SECONDS = 4.0  # the silence before a sign of life; the contract promises a message every 5 s


class EventWriter:
    """Writes the messages of one stream. `what` is the word for an event in error texts, such as "match"."""

    def __init__(self, context: Context, what: str) -> None:
        self._context = context
        self._what = what
        self._work = current_work()
        self._written_s = _now_s()

    @property
    def silence_left_s(self) -> float:
        """The seconds until a sign of life is due; 0 or less: it is due now. Every write postpones it."""
        return self._written_s + SIGN_OF_LIFE_SECONDS - _now_s()

    async def turn(self) -> None:
        """Wait until the caller has its turn on the event loop. Call this before the work for the next message."""
        if self._work.must_wait:
            await self._work.turn()

    async def write(self, message: bytes) -> None:
        """Write a message. Waits while the reader takes nothing. Raises Overloaded after WRITE_SECONDS_MAX."""
        self._work.spend_write()
        try:
            async with asyncio.timeout(WRITE_SECONDS_MAX):
                await self._context.write(message)
        except TimeoutError:
            raise Overloaded(
                f"the reader took no {self._what} for {WRITE_SECONDS_MAX:g} s, and its subscription is ended; read "
                f"faster, and subscribe again after the last {self._what}"
            ) from None
        self._written_s = _now_s()


def _now_s() -> float:
    return asyncio.get_running_loop().time()
