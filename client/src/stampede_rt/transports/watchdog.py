"""Time limits for blocking reads on open streams. gRPC has no time limit for one read."""

from __future__ import annotations

import heapq
import logging
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial

from stampede_rt.transports.concurrency_sync import within_limit

IDLE_S = 30.0  # see `Watchdog`
CALL_LIMIT_S = 0.1  # the longest time for which the thread waits for one function
_log = logging.getLogger("stampede_rt")


class Watchdog:
    """Calls a function for each `with` block that lasts too long.

    One daemon thread watches all blocks. The first block starts the thread. The thread ends after IDLE_S without a
    block, so that no thread remains after the program has dropped a connection.
    """

    def __init__(self) -> None:
        self._changed = threading.Condition()
        # A heap of limits: the due time, a serial number, `on_overdue`, and the lists `overdue` and `done`. The serial
        # number orders limits with equal due times.
        self._limits: list[tuple[float, int, Callable[[], object], list[bool], list[bool]]] = []
        self._count = 0
        self._wakes_at_s = float("inf")  # when the thread looks next; an earlier limit wakes it
        self._thread: threading.Thread | None = None
        self._closed = False

    @contextmanager
    def limit(self, timeout_s: float | None, on_overdue: Callable[[], object]) -> Iterator[list[bool]]:
        """Call `on_overdue`, on another thread, if the `with` block lasts longer than `timeout_s`.

        None: the block may last for ever. Yields a list, which is empty at first, and has an entry when the block has
        lasted longer than `timeout_s`.
        """
        overdue: list[bool] = []
        if timeout_s is None:
            yield overdue
            return
        done: list[bool] = []
        self._add(time.monotonic() + timeout_s, on_overdue, overdue, done)
        try:
            yield overdue
        finally:
            done.append(True)

    def _add(self, at_s: float, on_overdue: Callable[[], object], overdue: list[bool], done: list[bool]) -> None:
        with self._changed:
            while self._limits and self._limits[0][4]:
                heapq.heappop(self._limits)
            self._count += 1
            heapq.heappush(self._limits, (at_s, self._count, on_overdue, overdue, done))
            if self._thread is None:
                self._thread = threading.Thread(target=self._watch, name="stampede watchdog", daemon=True)
                self._thread.start()
            elif at_s < self._wakes_at_s:
                self._changed.notify()

    def _watch(self) -> None:
        while (on_overdue := self._next_overdue()) is not None:
            # The thread does not hold `_changed` here: the function takes locks of gRPC, and callers of `limit` must
            # not wait for these. The thread waits for at most CALL_LIMIT_S: an interrupt may have left a lock of gRPC
            # locked for ever.
            within_limit(partial(_call, on_overdue), CALL_LIMIT_S)

    def _next_overdue(self) -> Callable[[], object] | None:
        """Wait until a block is overdue, and return its function. None: the thread must end."""
        with self._changed:
            while not self._closed:
                while self._limits and self._limits[0][4]:
                    heapq.heappop(self._limits)
                self._wakes_at_s = self._limits[0][0] if self._limits else float("inf")
                left_s = self._wakes_at_s - time.monotonic()
                if left_s <= 0:
                    _, _, on_overdue, overdue, _ = heapq.heappop(self._limits)
                    overdue.append(True)
                    return on_overdue
                if self._limits:
                    self._changed.wait(left_s)
                elif not self._changed.wait(IDLE_S) and not self._limits:
                    break
            self._thread = None
            return None

    def close(self) -> None:
        """End the thread. No further `on_overdue` is called."""
        with self._changed:
            self._closed = True
            self._changed.notify()


def _call(on_overdue: Callable[[], object]) -> None:
    try:
        on_overdue()
    except Exception:  # noqa: BLE001  # a defect at one limit must not stop the others
        _log.exception("an overdue call could not be cancelled")
