"""Confirmed reads of one event loop. All calls that come while a read is under way share the next read.

A read costs the log's thread one step and the members one round of messages, however many callers wait for it. The
position that it finds is valid for every call that began before the read.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable

from stampede_rt_supernode.replication.interface import LogUnavailable
from stampede_rt_supernode.replication.rules.confirmed_reads import ConfirmedRead
from stampede_rt_supernode.replication.threads.loop_bridge import LoopBridge

_Waiting = tuple[float, asyncio.Future[int | None]]  # the deadline by time.monotonic, and the future


class SharedReads:
    """The waiting callers of one event loop. `start` hands a read to the log's thread.

    Invariant: a caller is in `_waiting`, or belongs to the read under way, until it is answered.
    """

    def __init__(self, start: Callable[[ConfirmedRead], None], bridge: LoopBridge, *, waiting_max: int) -> None:
        self._start = start
        self._bridge = bridge
        self._waiting_max = waiting_max
        self._waiting: list[_Waiting] = []
        self._under_way = False
        self._closed = False

    async def confirm(self, timeout: float) -> int | None:
        """An applied index that includes every write acknowledged before this call.

        None if the time is up, or the log closes. Raises LogUnavailable if too many callers wait.
        """
        if len(self._waiting) >= self._waiting_max:
            raise LogUnavailable(f"{self._waiting_max} reads wait already: slow down and try again")
        answer: asyncio.Future[int | None] = asyncio.get_running_loop().create_future()
        self._waiting.append((time.monotonic() + timeout, answer))
        self._begin()
        try:
            async with asyncio.timeout(timeout):
                return await answer
        except TimeoutError:
            return None

    def close(self) -> None:
        """Answer all waiting callers with None, and begin no more reads."""
        self._closed = True
        _set_results(self._waiting, None)
        self._waiting = []

    def _begin(self) -> None:
        if self._under_way or self._closed or not self._waiting:
            return
        callers, self._waiting = self._waiting, []
        self._under_way = True
        deadline = max(deadline for deadline, _ in callers)
        self._start(ConfirmedRead(deadline, lambda index: self._bridge.post(lambda: self._finish(callers, index))))

    def _finish(self, callers: list[_Waiting], index: int | None) -> None:
        self._under_way = False
        _set_results(callers, index)
        self._begin()


def _set_results(callers: list[_Waiting], index: int | None) -> None:
    for _, answer in callers:
        if not answer.done():
            answer.set_result(index)
