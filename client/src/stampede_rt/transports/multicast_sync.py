"""Receives datagrams in the blocking client. `multicast_async` has the same names for asyncio."""

from __future__ import annotations

import select
import socket
import threading
import weakref

from stampede_rt.transports.concurrency_sync import LOOK_S
from stampede_rt.transports.multicast_joining import received


class GroupSocket:
    """A socket that has joined a multicast group. One thread receives, and any thread may call `close`."""

    def __init__(self, joined: socket.socket) -> None:
        self._joined = joined
        self._woken, self._waker = socket.socketpair()
        self._waiting = select.poll()  # `select` takes no more than 1024 files
        for one in (joined, self._woken):
            self._waiting.register(one, select.POLLIN)
        # Guards the flags, and keeps the sockets open while a thread uses them. A signal handler may call `close`.
        self._mutex = threading.RLock()
        self._waits = self._closed = False
        self._end = weakref.finalize(self, _close_all, joined, self._woken, self._waker)
        self._end.atexit = False

    def poll(self) -> list[bytes]:
        """Return the datagrams that have come, at most DATAGRAMS_PER_POLL."""
        with self._mutex:
            return [] if self._closed else received(self._joined)

    def wait(self, timeout_s: float) -> None:
        """Wait until a datagram has come or somebody calls `close`, for at most `timeout_s`.

        The main thread waits for LOOK_S at most, so that it sees signals.
        """
        is_main = threading.current_thread() is threading.main_thread()
        with self._mutex:
            if self._closed:
                return
            self._waits = True
        try:
            self._waiting.poll(1000 * (min(timeout_s, LOOK_S) if is_main else timeout_s))
        finally:
            with self._mutex:
                self._waits = False
                if self._closed:
                    self._end()

    def close(self) -> None:
        """Leave the group, and end the wait. Idempotent."""
        with self._mutex:
            self._closed = True
            if self._waits:
                self._waker.send(b"\0")
            else:
                self._end()


def _close_all(*sockets: socket.socket) -> None:
    for one in sockets:
        one.close()
