"""Coroutines that wait for a group or a channel to change."""

from __future__ import annotations

import asyncio

from stampede_rt.errors import StampedeError


class Waiter:
    """A `ChannelObserver` that a coroutine waits on; register it wherever news may come from."""

    def __init__(self) -> None:
        self._news = asyncio.Event()
        self._error: StampedeError | None = None

    def wake(self) -> None:
        """There may be something to look at."""
        self._news.set()

    def end(self, error: StampedeError) -> None:
        """The channel or group that was waited for is not served any more."""
        self._error = error
        self._news.set()

    async def wait(self, timeout_s: float | None) -> bool:
        """Block until there is news, which is then taken note of; False after `timeout_s`. Raises what ended it."""
        try:
            async with asyncio.timeout(timeout_s):
                await self._news.wait()
        except TimeoutError:
            return False
        self._news.clear()
        if self._error is not None:
            raise self._error
        return True
