"""Reports soon that a peer has closed its socket, even while the service reads nothing from this socket.

asyncio notices a closed socket only when it reads. A caller cancels its call when it closes the stream. The service
must notice this even while it reads no messages from the stream. A caller that ends may leave thousands of sockets, so
the service closes a few of them in each turn of its event loop (decision 0190).
"""

from __future__ import annotations

import asyncio
import contextlib
import select
from collections import deque
from collections.abc import Callable
from typing import Any, NamedTuple

CLOSES_PER_TURN_MAX = 4
"""The most sockets that the service closes in one turn of the event loop, because their peers have closed them.

The close of one socket takes about 50 us, for its transport, its stream's task, and its slot.
"""


class _WatchedSocket(NamedTuple):
    socket: Any
    close: Callable[[], object]


class HangupWatcher:
    """Watches sockets for the end of their connection.

    On a system without epoll it watches nothing. The service then notices the end when it sends its next sign of life.
    """

    def __init__(self) -> None:
        self._epoll: Any = None
        # By the number of the socket's file. The system may give the number of a closed socket to a new socket.
        self._watched: dict[int, _WatchedSocket] = {}
        self._numbers: dict[int, int] = {}  # the number of the file of each watched socket, by `id` of the socket
        self._to_close: deque[Callable[[], object]] = deque()  # the calls that close sockets, in their order

    def watch(self, one: Any, close: Callable[[], object]) -> None:
        """Call `close` soon after the peer of the socket `one` has closed the connection, as `close_soon` does."""
        if not hasattr(select, "epoll"):
            return
        if self._epoll is None:
            self._epoll = select.epoll()
            asyncio.get_running_loop().add_reader(self._epoll.fileno(), self._look)
        number = self._numbers[id(one)] = one.fileno()
        self._watched[number] = _WatchedSocket(one, close)
        with contextlib.suppress(FileExistsError):
            self._epoll.register(number, select.EPOLLRDHUP)

    def forget(self, one: Any) -> None:
        """Stop watching a socket, which may be closed already. Idempotent."""
        number = self._numbers.pop(id(one), -1)
        watched = self._watched.get(number)
        if watched is not None and watched.socket is one:
            self._drop(number)

    def _look(self) -> None:
        if self._to_close:  # these sockets close first; the next turn of the loop calls this method again
            return
        for number, _ in self._epoll.poll(0, CLOSES_PER_TURN_MAX):
            watched = self._watched.get(number)
            self._drop(number)
            if watched is not None:
                self._numbers.pop(id(watched.socket), None)
                self.close_soon(watched.close)

    def close_soon(self, close: Callable[[], object]) -> None:
        """Call `close` in this turn of the event loop or in a later one: CLOSES_PER_TURN_MAX in each turn."""
        self._to_close.append(close)
        if len(self._to_close) == 1:
            asyncio.get_running_loop().call_soon(self._close_some)

    def _close_some(self) -> None:
        for _ in range(min(CLOSES_PER_TURN_MAX, len(self._to_close))):
            self._to_close.popleft()()
        if self._to_close:
            asyncio.get_running_loop().call_soon(self._close_some)

    def _drop(self, number: int) -> None:
        self._watched.pop(number, None)
        with contextlib.suppress(OSError):  # the system has dropped a closed socket by itself
            self._epoll.unregister(number)

    def close(self) -> None:
        """Stop watching all sockets, and close the sockets that still wait for their turn."""
        if self._epoll is not None:
            asyncio.get_running_loop().remove_reader(self._epoll.fileno())
            self._epoll.close()
            self._epoll = None
            self._watched.clear()
            self._numbers.clear()
        while self._to_close:
            self._to_close.popleft()()
