"""When many callers need the same answer of the directory at the same time, only one of them asks."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager


class SingleFlight:
    """One lock for each thing about which a caller asks. Drops the lock when no caller holds it or waits for it."""

    def __init__(self) -> None:
        self._locks: dict[bytes, asyncio.Lock] = {}
        self._callers: dict[bytes, int] = {}

    @asynccontextmanager
    async def about(self, thing: bytes) -> AsyncIterator[None]:
        """Hold the lock of `thing` during the block. Inside, first check whether another caller has got the answer."""
        lock = self._locks.setdefault(thing, asyncio.Lock())
        self._callers[thing] = self._callers.get(thing, 0) + 1
        try:
            async with lock:
                yield
        finally:
            self._callers[thing] -= 1
            if not self._callers[thing]:
                del self._locks[thing], self._callers[thing]
