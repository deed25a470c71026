"""Tells at once that a peer has gone from whose socket nothing is read at present.

asyncio learns of a closed socket only when it reads. A caller that closes its stream cancels it, also while the service
takes no more of its messages.
"""

from __future__ import annotations

import asyncio
import select
from collections.abc import Callable
from typing import Any

_EVENTS_PER_TURN = 64


class Hangups:
    """Watches sockets for the end of their connection. On a system without epoll it watches nothing.

    There the next sign of life tells that a peer has gone.
    """

    def __init__(self) -> None:
        self._epoll: Any = None
        self._watched: dict[int, Callable[[], object]] = {}

    def watch(self, one: Any, on_hangup: Callable[[], object]) -> None:
        """Call `on_hangup` when the peer of the socket `one` has gone. Call `forget` before the socket is closed."""
        if not hasattr(select, "epoll"):
            return
        if self._epoll is None:
            self._epoll = select.epoll()
            asyncio.get_running_loop().add_reader(self._epoll.fileno(), self._look)
        self._watched[one.fileno()] = on_hangup
        self._epoll.register(one.fileno(), select.EPOLLRDHUP)

    def forget(self, one: Any) -> None:
        """Watch a socket no longer. Idempotent."""
        if self._watched.pop(one.fileno(), None) is not None:
            self._epoll.unregister(one.fileno())

    def _look(self) -> None:
        for number, _ in self._epoll.poll(0, _EVENTS_PER_TURN):
            on_hangup = self._watched.pop(number, None)
            if on_hangup is not None:
                self._epoll.unregister(number)
                on_hangup()

    def close(self) -> None:
        """Watch no socket any longer."""
        if self._epoll is not None:
            asyncio.get_running_loop().remove_reader(self._epoll.fileno())
            self._epoll.close()
            self._epoll = None
            self._watched.clear()
