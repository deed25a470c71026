"""Reports soon that a peer has closed its socket, even while the service reads nothing from this socket.

asyncio notices a closed socket only when it reads. A caller that closes its stream also cancels its call, even while
the service takes no more of its messages. A caller that ends may leave thousands of sockets, so the service closes a
few of them in each turn of its event loop (decision 0190).
"""

from __future__ import annotations

import asyncio
import contextlib
import select
from collections import deque
from collections.abc import Callable
from typing import Any, NamedTuple

CLOSED_PER_TURN = 4
"""The most sockets of peers that have gone.

It takes about 50 us to close one: its transport, its stream's task, its slot.
"""


class _WatchedSocket(NamedTuple):
    socket: Any
    close: Callable[[], object]


class HangupWatcher:
    """Watches sockets for the end of their connection.

    On a system without epoll it watches nothing. The service then notices the end at its next sign of life.
    """

    def __init__(self) -> None:
        self._epoll: Any = None
        # By the number of the socket's file. The system may give the number of a closed socket to a new socket.
        self._watched: dict[int, _WatchedSocket] = {}
        self._numbers: dict[int, int] = {}  # by the identity of the socket
        self._gone: deque[Callable[[], object]] = deque()  # the calls that close the sockets whose peers have gone

    def watch(self, one: Any, close: Callable[[], object]) -> None:
        """Call `close` when the peer of the socket `one` has gone, see `gone`."""
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
        if self._gone:  # the next turn of the loop checks again
            return
        for number, _ in self._epoll.poll(0, CLOSED_PER_TURN):
            watched = self._watched.get(number)
            self._drop(number)
            if watched is not None:
                self._numbers.pop(id(watched.socket), None)
                self.gone(watched.close)

    def gone(self, close: Callable[[], object]) -> None:
        """Call `close` in this turn of the event loop or in a later one: CLOSED_PER_TURN in each turn."""
        self._gone.append(close)
        if len(self._gone) == 1:
            asyncio.get_running_loop().call_soon(self._close_some)

    def _close_some(self) -> None:
        for _ in range(min(CLOSED_PER_TURN, len(self._gone))):
            self._gone.popleft()()
        if self._gone:
            asyncio.get_running_loop().call_soon(self._close_some)

    def _drop(self, number: int) -> None:
        self._watched.pop(number, None)
        with contextlib.suppress(OSError):  # the system has dropped a closed socket by itself
            self._epoll.unregister(number)

    def close(self) -> None:
        """Stop watching all sockets, and close the sockets whose peers have gone."""
        if self._epoll is not None:
            asyncio.get_running_loop().remove_reader(self._epoll.fileno())
            self._epoll.close()
            self._epoll = None
            self._watched.clear()
            self._numbers.clear()
        while self._gone:
            self._gone.popleft()()
