"""The memory into which the sockets of a port are read.

The service reads only a few long frames of each caller at the same time. The others wait in the buffers of the system.
A caller may have thousands of streams. Without this limit it could make the event loop read a long frame of each stream
in one turn, and keep an unfinished frame of each stream in memory.
"""

from __future__ import annotations

import asyncio
from collections import OrderedDict
from weakref import WeakKeyDictionary

from stampede_rt_runtime.quotas.accounts import Account, unlimited
from stampede_rt_runtime.quotas.working import SOCKET_COSTS, CallerWork

SHORT_BYTES = 2**14
"""The most bytes of one read. A frame that needs more is long, and waits for a place."""
PLACES = 16
"""The most long frames of one caller that the service reads at the same time. To read 256 KiB takes about 0.1 ms."""


class _Line:
    """The free places of one caller, and the streams that wait for one."""

    __slots__ = ("free", "waiting")

    def __init__(self) -> None:
        self.free = PLACES
        self.waiting: OrderedDict[asyncio.Future[None], None] = OrderedDict()

    def leave(self) -> None:
        """Give the place to the first stream that waits."""
        while self.waiting:
            first, _ = self.waiting.popitem(last=False)
            if not first.done():
                first.set_result(None)
                return
        self.free += 1


class FrameBuffers:
    """One buffer for all short reads, and the places for long frames. A caller without quotas needs no place."""

    def __init__(self) -> None:
        self.short = memoryview(bytearray(SHORT_BYTES))
        self._lines: WeakKeyDictionary[Account, _Line] = WeakKeyDictionary()

    def place(self, caller: Account) -> FramePlace:
        """A place for one stream of the caller. It is not taken yet."""
        if caller is unlimited():
            return FramePlace(caller, None)
        line = self._lines.get(caller)
        if line is None:
            line = self._lines[caller] = _Line()
        return FramePlace(caller, line)


class FramePlace:
    """The right of one stream to read a long frame. The stream takes a place for each long frame."""

    __slots__ = ("_line", "_work")

    def __init__(self, caller: Account, line: _Line | None) -> None:
        """`line`: None for a caller without quotas."""
        self._line, self._work = line, CallerWork(caller, SOCKET_COSTS)

    def take_now(self) -> bool:
        """Take a place if the stream need not wait. Returns whether it has one. `leave` must follow."""
        if self._line is None:
            return True
        if self._work.must_wait or not self._line.free:
            return False
        self._line.free -= 1
        return True

    async def take(self) -> None:
        """Wait for a free place, and for the turn of the caller. `leave` must follow."""
        if self._line is None:
            return
        if self._line.free:
            self._line.free -= 1
        else:
            await self._wait(self._line)
        if self._work.must_wait:
            try:
                await self._work.turn()
            except asyncio.CancelledError:
                self._line.leave()
                raise

    @staticmethod
    async def _wait(line: _Line) -> None:
        given: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        line.waiting[given] = None
        try:
            await given
        except asyncio.CancelledError:
            line.waiting.pop(given, None)
            if not given.cancelled():
                line.leave()
            raise

    def leave(self, lost_bytes: int = 0) -> None:
        """Give the place back. `lost_bytes` were read of a frame that never ended; they count for the caller."""
        self._work.spend_bytes(lost_bytes)
        if self._line is not None:
            self._line.leave()
