"""The memory of a host for large requests that are not yet complete."""

from __future__ import annotations

import asyncio
from collections import Counter, deque
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import NamedTuple

INCOMPLETE_BYTES_MAX = 128 * 2**20
CALLER_BYTES_MAX = INCOMPLETE_BYTES_MAX // 2


class _WaitingRequest(NamedTuple):
    """A request that waits for room. `admitted` is done when the request has its room."""

    admitted: asyncio.Future[None]
    caller: str
    wanted_bytes: int


class RequestRoom:
    """The memory of a host for requests that are not yet complete. One caller gets at most half of it.

    Requests get room in the order in which they came. Only a request whose caller has used up its half waits longer,
    while later requests of other callers get room.
    """

    def __init__(self, bytes_max: int = INCOMPLETE_BYTES_MAX, caller_bytes_max: int = CALLER_BYTES_MAX) -> None:
        self.used_bytes = 0
        self._bytes_max, self._caller_bytes_max = bytes_max, caller_bytes_max
        self._of_callers: Counter[str] = Counter()
        self._waiting: deque[_WaitingRequest] = deque()

    @asynccontextmanager
    async def taken(self, caller: str, wanted_bytes: int) -> AsyncIterator[None]:
        """Wait until there is room for one request, and keep it for the duration of the block."""
        waiting = _WaitingRequest(asyncio.get_running_loop().create_future(), caller, wanted_bytes)
        self._waiting.append(waiting)
        self._admit()
        try:
            await waiting.admitted
            yield
        finally:
            if waiting.admitted.done() and not waiting.admitted.cancelled():
                self._count(waiting, -wanted_bytes)
            waiting.admitted.cancel()
            self._admit()

    def _admit(self) -> None:
        """Give room to the waiting requests, in their order, until the next one does not fit."""
        left: deque[_WaitingRequest] = deque()
        while self._waiting and self.used_bytes + self._waiting[0].wanted_bytes <= self._bytes_max:
            waiting = self._waiting.popleft()
            if waiting.admitted.cancelled():
                continue
            if self._of_callers[waiting.caller] + waiting.wanted_bytes > self._caller_bytes_max:
                left.append(waiting)
                continue
            self._count(waiting, waiting.wanted_bytes)
            waiting.admitted.set_result(None)
        self._waiting = left + self._waiting

    def _count(self, waiting: _WaitingRequest, more_bytes: int) -> None:
        self.used_bytes += more_bytes
        self._of_callers[waiting.caller] += more_bytes
        if not self._of_callers[waiting.caller]:
            del self._of_callers[waiting.caller]
