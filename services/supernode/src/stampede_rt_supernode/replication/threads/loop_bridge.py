"""Passes calls from the log's thread to the asyncio loop, in order, with one wake-up for many calls."""

from __future__ import annotations

import asyncio
import threading
from collections import deque
from collections.abc import Callable


class LoopBridge:
    """Calls functions on a loop. The limits for proposals and messages also limit the number of waiting calls."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._calls: deque[Callable[[], None]] = deque()
        self._scheduled = False
        self._lock = threading.Lock()

    def post(self, call: Callable[[], None]) -> None:
        """Have the loop run `call` soon. Callable on any thread. Drops all waiting calls if the loop is closed."""
        with self._lock:
            self._calls.append(call)
            if self._scheduled:
                return
            try:
                self._loop.call_soon_threadsafe(self._drain)
            except RuntimeError:
                if not self._loop.is_closed():
                    raise
                self._calls.clear()
            else:
                self._scheduled = True

    def _drain(self) -> None:
        with self._lock:
            calls, self._calls = self._calls, deque()
            self._scheduled = False
        for call in calls:
            call()
