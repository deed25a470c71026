"""The last files of a former owner, which come to the object store a moment after a channel has moved."""

from __future__ import annotations

import asyncio
import time

WAIT_SECONDS_MAX = 8.0
"""The longest wait of readers for these files, counted from the move."""


class FormerFiles:
    """Lets readers wait while the archive of this owner expects files of the former owner."""

    def __init__(self) -> None:
        self._until_s: float | None = None  # the monotonic time at which the wait is over; None: no wait
        self._arrival = asyncio.Event()

    @property
    def are_expected(self) -> bool:
        """Whether reads of the archive should wait for the files."""
        return self._until_s is not None and time.monotonic() < self._until_s

    def expect(self) -> None:
        """Let reads wait from now on, for WAIT_SECONDS_MAX at most."""
        self._until_s = time.monotonic() + WAIT_SECONDS_MAX
        self._arrival.clear()

    def note_complete(self) -> None:
        """Note that the archive has the files. Idempotent."""
        self._until_s = None
        self._arrival.set()

    async def wait(self) -> None:
        """Wait while the files are expected."""
        if self._until_s is None:
            return
        try:
            async with asyncio.timeout(self._until_s - time.monotonic()):
                await self._arrival.wait()
        except TimeoutError:  # the former owner is lost or too slow: reads say what the archive lacks
            pass
