"""Receives datagrams in the client on asyncio."""

from __future__ import annotations

import asyncio
import socket
import weakref

from stampede_rt.transports.multicast_joining import received


class GroupSocket:
    """A socket that has joined a multicast group. Only code on the event loop uses it."""

    def __init__(self, joined: socket.socket) -> None:
        self._joined = joined
        self._waiter: asyncio.Future[None] | None = None
        self._closed = False
        weakref.finalize(self, joined.close).atexit = False

    def poll(self) -> list[bytes]:
        """Return the datagrams that have come, at most DATAGRAMS_PER_POLL."""
        return [] if self._closed else received(self._joined)

    async def wait(self, timeout_s: float) -> None:
        """Wait until a datagram has come or somebody calls `close`, for at most `timeout_s`."""
        if self._closed:
            return
        loop = asyncio.get_running_loop()
        self._waiter = loop.create_future()
        loop.add_reader(self._joined, self._wake)
        try:
            async with asyncio.timeout(timeout_s):
                await self._waiter
        except TimeoutError:
            pass
        finally:
            self._waiter = None
            if not self._closed:
                loop.remove_reader(self._joined)

    def _wake(self) -> None:
        if self._waiter is not None and not self._waiter.done():
            self._waiter.set_result(None)

    def close(self) -> None:
        """Leave the group, and end the wait. Idempotent."""
        if self._closed:
            return
        self._closed = True
        if self._waiter is not None:
            self._waiter.get_loop().remove_reader(self._joined)
        self._wake()
        self._joined.close()
