"""Accepts connections a few at a time.

An event loop accepts all connections that wait at a listening socket in one turn: up to its backlog of 512, which took
up to 17 ms (decision 0144).
"""

from __future__ import annotations

import asyncio
import logging
import socket
from collections.abc import Callable

logger = logging.getLogger(__name__)

ACCEPTED_PER_TURN = 4
PAUSE_SECONDS = 0.001
"""The time until the next connections are accepted, if ACCEPTED_PER_TURN have come. Other work can run in that time."""
RETRY_SECONDS = 1.0  # after a failure, such as that no file descriptor is left


class Acceptor:
    """Accepts the connections of a listening socket, which it owns, from `start` to `close`."""

    def __init__(self, listening: socket.socket, take: Callable[[socket.socket], object]) -> None:
        """`take` gets each connection, and owns it."""
        self._listening, self._take = listening, take
        self._loop = asyncio.get_running_loop()
        self._restart: asyncio.TimerHandle | None = None

    def start(self) -> None:
        """Accept from now on."""
        self._restart = None
        self._loop.add_reader(self._listening, self._accept_some)

    def close(self) -> None:
        """Accept nothing more, and close the listening socket. Idempotent."""
        if self._restart is not None:
            self._restart.cancel()
        if self._listening.fileno() >= 0:
            self._loop.remove_reader(self._listening)
            self._listening.close()

    def _accept_some(self) -> None:
        for _ in range(ACCEPTED_PER_TURN):
            try:
                accepted, _ = self._listening.accept()
            except (BlockingIOError, InterruptedError, ConnectionAbortedError):
                return
            except OSError as error:
                logger.warning(
                    "connections cannot be accepted",
                    extra={"event": "accept_failed", "why": error.strerror or str(error)},
                )
                self._pause(RETRY_SECONDS)
                return
            accepted.setblocking(False)
            self._take(accepted)
        self._pause(PAUSE_SECONDS)

    def _pause(self, seconds: float) -> None:
        self._loop.remove_reader(self._listening)
        self._restart = self._loop.call_later(seconds, self.start)
