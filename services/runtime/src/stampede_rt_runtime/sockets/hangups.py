"""Reports soon that a peer has gone, even while the service reads nothing from its socket.

asyncio notices a closed socket only when it reads. A caller that closes its stream also cancels its call, even while
the service takes no more of its messages.
"""

from __future__ import annotations

import asyncio
import contextlib
import select
from collections.abc import Callable
from typing import Any, NamedTuple

_EVENTS_PER_TURN = 64


class _Watched(NamedTuple):
    socket: Any
    on_hangup: Callable[[], object]


class HangupWatcher:
    """Watches sockets for the end of their connection.

    On a system without epoll it watches nothing. The service then notices the end at its next sign of life.
    """

    def __init__(self) -> None:
        self._epoll: Any = None
        # By the number of the socket's file. The system may give the number of a closed socket to another one.
        self._watched: dict[int, _Watched] = {}
        self._numbers: dict[int, int] = {}  # by the identity of the socket

    def watch(self, one: Any, on_hangup: Callable[[], object]) -> None:
        """Call `on_hangup` when the peer of the socket `one` has gone."""
        if not hasattr(select, "epoll"):
            return
        if self._epoll is None:
            self._epoll = select.epoll()
            asyncio.get_running_loop().add_reader(self._epoll.fileno(), self._look)
        number = self._numbers[id(one)] = one.fileno()
        self._watched[number] = _Watched(one, on_hangup)
        with contextlib.suppress(FileExistsError):
            self._epoll.register(number, select.EPOLLRDHUP)

    def forget(self, one: Any) -> None:
        """Watch a socket no longer, which may be closed already. Idempotent."""
        number = self._numbers.pop(id(one), -1)
        watched = self._watched.get(number)
        if watched is not None and watched.socket is one:
            self._drop(number)

    def _look(self) -> None:
        for number, _ in self._epoll.poll(0, _EVENTS_PER_TURN):
            watched = self._watched.get(number)
            self._drop(number)
            if watched is not None:
                self._numbers.pop(id(watched.socket), None)
                watched.on_hangup()

    def _drop(self, number: int) -> None:
        self._watched.pop(number, None)
        with contextlib.suppress(OSError):  # the system has dropped a closed socket by itself
            self._epoll.unregister(number)

    def close(self) -> None:
        """Watch no socket any longer."""
        if self._epoll is not None:
            asyncio.get_running_loop().remove_reader(self._epoll.fileno())
            self._epoll.close()
            self._epoll = None
            self._watched.clear()
            self._numbers.clear()
