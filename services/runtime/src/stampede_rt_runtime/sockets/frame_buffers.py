"""The memory into which the sockets of a port are read.

The service reads only a few long frames of each caller at the same time. The others wait in the buffers of the system.
A caller may have thousands of streams. Without this limit it could make the event loop read a long frame of each stream
in one turn, and keep an unfinished frame of each stream in memory.
"""

from __future__ import annotations

import asyncio
from collections import OrderedDict
from weakref import WeakKeyDictionary

from stampede_rt.wire.stream_frames import has_views
from stampede_rt_runtime.quotas.accounts import Account, unlimited
from stampede_rt_runtime.quotas.working import SOCKET_COSTS, CallerWork

SHORT_BYTES = 2**14
"""The most bytes of one read. A frame that needs more is long, and waits for a place."""
PLACES = 16
PLACE_BYTES = 2**18
"""The long frames of one caller share PLACES places. A frame takes a place for each PLACE_BYTES, and PLACES at most.

A read of 256 KiB takes about 0.1 ms."""
BUFFERS_KEPT = 4
"""The buffers of former frames that the port keeps for the next frames.

New memory for each frame would be filled with zeros first, and cost a page fault for each 4 KiB.
"""


class _Line:
    """The free places of one caller, and the streams that wait for some, with the number that each of them needs."""

    __slots__ = ("free", "waiting")

    def __init__(self) -> None:
        self.free = PLACES
        self.waiting: OrderedDict[asyncio.Future[None], int] = OrderedDict()

    def leave(self, places: int) -> None:
        """Give the places to the streams that wait, the first one first."""
        self.free += places
        while self.waiting:
            first, needed = next(iter(self.waiting.items()))
            if not first.done() and needed > self.free:
                return
            del self.waiting[first]
            if not first.done():
                self.free -= needed
                first.set_result(None)


class FrameBuffers:
    """One buffer for all short reads; buffers and places for long frames. A caller without quotas needs no place."""

    def __init__(self) -> None:
        self.short = memoryview(bytearray(SHORT_BYTES))
        self._kept: list[bytearray] = []
        self._lines: WeakKeyDictionary[Account, _Line] = WeakKeyDictionary()

    def take_buffer(self, frame_bytes: int) -> bytearray:
        """Take a buffer for a long frame. The buffer may be longer than the frame."""
        for at, one in enumerate(self._kept):
            if len(one) >= frame_bytes and not has_views(one):
                return self._kept.pop(at)
        return bytearray(frame_bytes)

    def give_back(self, buffer: bytearray) -> None:
        """Keep the buffer of a frame for later frames. The method `take_buffer` skips it while a view of it exists.

        asyncio and uvloop have a view of it until they have returned from the call that completed the frame.
        """
        self._kept.append(buffer)
        if len(self._kept) > BUFFERS_KEPT:
            self._kept.remove(min(self._kept, key=len))

    def place(self, caller: Account) -> FramePlace:
        """The object with which one stream of the caller takes places. It has none yet."""
        if caller is unlimited():
            return FramePlace(caller, None)
        line = self._lines.get(caller)
        if line is None:
            line = self._lines[caller] = _Line()
        return FramePlace(caller, line)


class FramePlace:
    """The places that one stream has. It takes them for each long frame, and gives them back after the frame."""

    __slots__ = ("_line", "_taken", "_work")

    def __init__(self, caller: Account, line: _Line | None) -> None:
        """`line`: None for a caller without quotas."""
        self._line, self._work = line, CallerWork(caller, SOCKET_COSTS)
        self._taken = 0

    def take_now(self, frame_bytes: int) -> bool:
        """Take the places of a frame if the stream need not wait. Returns whether it did; then `leave` must follow."""
        if self._line is None:
            return True
        needed = _places_of(frame_bytes)
        if self._work.must_wait or self._line.waiting or needed > self._line.free:
            return False
        self._line.free -= needed
        self._taken = needed
        return True

    async def take(self, frame_bytes: int) -> None:
        """Wait for the places of a frame, and for the turn of the caller. `leave` must follow."""
        if self._line is None:
            return
        needed = _places_of(frame_bytes)
        if self._line.waiting or needed > self._line.free:
            await self._wait(self._line, needed)
        else:
            self._line.free -= needed
        self._taken = needed
        if self._work.must_wait:
            try:
                await self._work.turn()
            except asyncio.CancelledError:
                self.leave()
                raise

    @staticmethod
    async def _wait(line: _Line, needed: int) -> None:
        given: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        line.waiting[given] = needed
        try:
            await given
        except asyncio.CancelledError:
            line.waiting.pop(given, None)
            line.leave(0 if given.cancelled() else needed)
            raise

    def leave(self, lost_bytes: int = 0) -> None:
        """Give the places back. `lost_bytes` were read of a frame that never ended; they count for the caller."""
        self._work.spend_bytes(lost_bytes)
        if self._line is not None:
            taken, self._taken = self._taken, 0
            self._line.leave(taken)


def _places_of(frame_bytes: int) -> int:
    return min(PLACES, -(-frame_bytes // PLACE_BYTES))
