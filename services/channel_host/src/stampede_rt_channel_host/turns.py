"""An event loop that lets other threads look at its objects between two of its steps.

The loop holds a lock, except while it waits for events. A thread that takes the lock finds the objects as they are
between two callbacks. It may look at them, and must change nothing.
"""

from __future__ import annotations

import asyncio
import selectors
import threading
import time

_LOOP_RUN_SECONDS = 0.0001


class LoopTurns:
    """The turns of one loop. `loop` makes it, on the thread that runs it. Other threads take `lock` to look."""

    def __init__(self) -> None:
        self.lock = threading.RLock()
        """Held by the loop during its steps. Other threads take it by `with turns.lock`, so that Ctrl-C cannot leave it
        locked.

        One thread may take it twice, because Python can run a signal handler or `__del__` of the program meanwhile.
        """
        self._is_awaited = False  # whether the loop waits for the lock

    def loop(self) -> asyncio.AbstractEventLoop:
        """A new event loop, which holds the lock from now on."""
        self.lock.acquire()
        made = asyncio.SelectorEventLoop(_GivingSelector(self))
        made.set_debug(False)
        return made

    @property
    def is_mine(self) -> bool:
        """Whether the calling thread holds the lock: it runs a step of the loop, or looks."""
        return self.lock._is_owned()  # type: ignore[attr-defined, no-any-return]

    def let_loop_run(self) -> None:
        """Let the loop run if it waits for the lock. A thread calls this method before it takes the lock."""
        if self._is_awaited:
            time.sleep(_LOOP_RUN_SECONDS)

    def loop_ended(self) -> None:
        """Release the lock, and never take it again. Call it on the loop's thread, when the loop is closed."""
        self.lock.release()

    def give(self) -> None:
        """Release the lock, so that other threads can look. The loop calls it before it waits for events."""
        self.lock.release()

    def take(self) -> None:
        """Take the lock again. The loop calls it after the wait."""
        self._is_awaited = True
        self.lock.acquire()
        self._is_awaited = False


class _GivingSelector(selectors.DefaultSelector):  # type: ignore[misc, valid-type, unused-ignore]  # one of several
    """A selector that releases the lock of `turns` while it waits."""

    def __init__(self, turns: LoopTurns) -> None:
        super().__init__()
        self._turns = turns

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        self._turns.give()
        try:
            return super().select(timeout)
        finally:
            self._turns.take()
