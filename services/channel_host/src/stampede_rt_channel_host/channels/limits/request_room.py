"""The memory of a host for large requests, from their first piece until they are judged."""

from __future__ import annotations

import asyncio
import itertools
from collections import OrderedDict
from collections.abc import Callable
from functools import partial
from heapq import heappop, heappush
from typing import NamedTuple

from stampede_rt.wire.request_pieces import JOINED_BYTES_MAX

ROOM_BYTES = 128 * 2**20
CALLER_BYTES_MAX = ROOM_BYTES // 2


class RequestRooms:
    """The memory of a host for all requests that it has not judged yet. One caller gets at most half of it.

    One half of the memory is for requests up to JOINED_BYTES_MAX, and the other half for larger requests. So producers
    that join small items in a request do not wait for large requests whose pieces do not come.
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


class _Line:
    """The requests of one caller: `used_bytes` of the requests that have room, and the waiting requests by number, in
    order.

    `is_listed`: `RequestRoom` looks at this line when there is room. Otherwise the caller has used up its part.
    """

    def __init__(self) -> None:
        self.used_bytes = 0
        self.waiting: OrderedDict[int, _WaitingRequest] = OrderedDict()
        self.is_listed = False


class _WaitingRequest(NamedTuple):
    """A request that waits for room. `admitted` is done when the request has its room."""

    admitted: asyncio.Future[None]
    wanted_bytes: int


class RequestRoom:
    """Memory for requests that are not judged. One caller gets at most `caller_bytes_max`.

    Requests get room in the order in which they came. Only a request whose caller has used up its part waits longer,
    while later requests of other callers get room. A step looks at one request for each request that it admits, and at
    one more of each caller at most. It looks at no other request of a caller that has used up its part.
    """

    def __init__(self, bytes_max: int, caller_bytes_max: int) -> None:
        self.used_bytes = 0
        self._bytes_max, self._caller_bytes_max = bytes_max, caller_bytes_max
        self._numbers = itertools.count()
        self._lines: dict[str, _Line] = {}
        self._listed: list[tuple[int, str]] = []  # a heap of the lines' first numbers; a number may be an older one

    async def take(self, caller: str, wanted_bytes: int) -> Callable[[], None]:
        """Wait until there is room for one request. Returns a function that gives the room back. Call it once."""
        line, number = self._lines.setdefault(caller, _Line()), next(self._numbers)
        waiting = line.waiting[number] = _WaitingRequest(asyncio.get_running_loop().create_future(), wanted_bytes)
        self._list(caller, line)
        self._admit()
        give_back = partial(self._give_back, caller, number, waiting)
        try:
            await waiting.admitted
        except asyncio.CancelledError:
            give_back()
            raise
        return give_back

    def _give_back(self, caller: str, number: int, waiting: _WaitingRequest) -> None:
        line = self._lines.setdefault(caller, _Line())
        line.waiting.pop(number, None)
        if waiting.admitted.done() and not waiting.admitted.cancelled():
            self._count(line, -waiting.wanted_bytes)
        waiting.admitted.cancel()
        self._list(caller, line)
        self._admit()

    def _list(self, caller: str, line: _Line) -> None:
        """Look at this line when there is room, unless nothing waits there."""
        if line.waiting and not line.is_listed:
            line.is_listed = True
            heappush(self._listed, (next(iter(line.waiting)), caller))
        elif not (line.waiting or line.is_listed or line.used_bytes):
            del self._lines[caller]

    def _unlist(self) -> None:
        """Do not look at the first line again before `_list`."""
        _, caller = heappop(self._listed)
        self._lines[caller].is_listed = False

    def _admit(self) -> None:
        """Give room to the waiting requests, in their order, until the next one does not fit."""
        while self._listed:
            number, caller = self._listed[0]
            line = self._lines[caller]
            waiting = line.waiting.get(number)
            if waiting is not None and not waiting.admitted.cancelled():
                if line.used_bytes + waiting.wanted_bytes > self._caller_bytes_max:
                    self._unlist()
                    continue
                if self.used_bytes + waiting.wanted_bytes > self._bytes_max:
                    return
                self._count(line, waiting.wanted_bytes)
                waiting.admitted.set_result(None)
            line.waiting.pop(number, None)
            self._unlist()
            self._list(caller, line)

    def _count(self, line: _Line, more_bytes: int) -> None:
        self.used_bytes += more_bytes
        line.used_bytes += more_bytes
