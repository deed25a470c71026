"""The writing side of a stream of events: a time limit for each write, and when a sign of life is due."""

from __future__ import annotations

import asyncio

from stampede_rt.errors import Overloaded
from stampede_rt_channel_host.channels.subscription import WRITE_SECONDS_MAX
from stampede_rt_runtime.rpc import Context

LIFE_SECONDS = 4.0  # the contract says after 5 s


class EventWriter:
    """Of one stream. `what`: what its reader takes, for people."""

    def __init__(self, context: Context, what: str) -> None:
        self._context = context
        self._what = what
        self._written_s = _now_s()

    @property
    def silence_left_s(self) -> float:
        """In how many seconds a sign of life is due; 0 or less: now. Only what is written puts it off."""
        return self._written_s + LIFE_SECONDS - _now_s()

    async def write(self, message: bytes) -> None:
        """Blocks while the reader takes nothing; raises Overloaded after WRITE_SECONDS_MAX."""
        try:
            async with asyncio.timeout(WRITE_SECONDS_MAX):
                await self._context.write(message)
        except TimeoutError:
            raise Overloaded(
                f"the reader took no {self._what} for {WRITE_SECONDS_MAX:g} s, and its subscription is ended; read "
                f"faster, and subscribe again behind the last {self._what}"
            ) from None
        self._written_s = _now_s()


def _now_s() -> float:
    return asyncio.get_running_loop().time()
