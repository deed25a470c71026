"""An object on which coroutines wait for a change of a group or a channel."""

from __future__ import annotations

import asyncio

from stampede_rt.errors import StampedeError
from stampede_rt_channel_host.channels.observers import ChangeObserver


class Waiter(ChangeObserver):
    """An observer on which a coroutine waits. Register it at each source of changes."""

    def __init__(self) -> None:
        super().__init__()
        self._wakeup = asyncio.Event()
        self._error: StampedeError | None = None

    def wake(self) -> None:
        """Note that something may have changed."""
        self._wakeup.set()

    def end(self, error: StampedeError) -> None:
        """Note that the host no longer serves the group or channel."""
        self._error = error
        self._wakeup.set()

    async def wait(self, timeout_s: float | None) -> bool:
        """Wait until `wake` is called. Returns True, immediately if `wake` was called since the last wait.

        Returns False after `timeout_s`; None: no limit. Raises the error that `end` got.
        """
        try:
            async with asyncio.timeout(timeout_s):
                await self._wakeup.wait()
        except TimeoutError:
            return False
        self._wakeup.clear()
        self.listen()
        if self._error is not None:
            raise self._error
        return True
