"""The memory of a host for large requests, from their first piece until they are judged."""

from __future__ import annotations

import asyncio
from collections import Counter, deque
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

from stampede_rt.wire.request_pieces import JOINED_BYTES_MAX

ROOM_BYTES = 128 * 2**20
CALLER_BYTES_MAX = ROOM_BYTES // 2


class RequestRooms:
    """The memory of a host for all requests that it has not judged yet. One caller gets at most half of it.

    One half of the memory is for requests up to JOINED_BYTES_MAX, and the other half for larger requests. So producers
    that join small items in a request do not wait behind large requests whose pieces do not come.
    """

    def __init__(self) -> None:
        self._joined, self._large = (RequestRoom(ROOM_BYTES // 2, CALLER_BYTES_MAX // 2) for _ in range(2))

    @property
    def used_bytes(self) -> int:
        """The memory of the requests that have room."""
        return self._joined.used_bytes + self._large.used_bytes

    async def take(self, caller: str, wanted_bytes: int) -> Callable[[], None]:
        """Wait until there is room for one request. Returns a function that gives the room back. Call it once."""
        room = self._joined if wanted_bytes <= JOINED_BYTES_MAX else self._large
        return await room.take(caller, wanted_bytes)


class _WaitingRequest(NamedTuple):
    """A request that waits for room. `admitted` is done when the request has its room."""

    admitted: asyncio.Future[None]
    caller: str
    wanted_bytes: int


class RequestRoom:
    """Memory for requests that are not judged. One caller gets at most `caller_bytes_max`.

    Requests get room in the order in which they came. Only a request whose caller has used up its part waits longer,
    while later requests of other callers get room.
    """

    def __init__(self, bytes_max: int, caller_bytes_max: int) -> None:
        self.used_bytes = 0
        self._bytes_max, self._caller_bytes_max = bytes_max, caller_bytes_max
        self._of_callers: Counter[str] = Counter()
        self._waiting: deque[_WaitingRequest] = deque()

    async def take(self, caller: str, wanted_bytes: int) -> Callable[[], None]:
        """Wait until there is room for one request. Returns a function that gives the room back. Call it once."""
        waiting = _WaitingRequest(asyncio.get_running_loop().create_future(), caller, wanted_bytes)
        self._waiting.append(waiting)
        self._admit()
        give_back = partial(self._give_back, waiting)
        try:
            await waiting.admitted
        except asyncio.CancelledError:
            give_back()
            raise
        return give_back

    def _give_back(self, waiting: _WaitingRequest) -> None:
        if waiting.admitted.done() and not waiting.admitted.cancelled():
            self._count(waiting, -waiting.wanted_bytes)
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
