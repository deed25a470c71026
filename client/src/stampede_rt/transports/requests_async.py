"""The sending side of an open stream on asyncio."""

from __future__ import annotations

import asyncio
from collections import OrderedDict
from contextlib import suppress
from typing import Any

import grpc
import grpc.aio


class Requests:
    """Writes the requests of one call in their order, in a task of its own, until the call ends.

    grpc.aio gives a call up if a task is cancelled while it writes, and a write waits for ever if the call was given up
    while it opened. So nobody else writes: `send` only leaves the request here. It neither blocks nor can be cancelled.
    That the call has ended is told by its responses, never here.
    """

    def __init__(self, call: Any, tasks: set[asyncio.Task[None]]) -> None:
        self._call = call
        self._waiting: OrderedDict[int, Any] = OrderedDict()
        self._sent = 0
        self._more = asyncio.Event()
        self._task = spawn(tasks, self._write_each())
        call.add_done_callback(self._stop)

    def __len__(self) -> int:
        """How many requests wait for being written."""
        return len(self._waiting)

    def send(self, request: Any) -> int:
        """Write `request` behind those that were left before; a number for `withdraw`.

        What the call does not take any more is dropped.
        """
        self._sent += 1
        self._waiting[self._sent] = request
        self._more.set()
        return self._sent

    def withdraw(self, number: int) -> bool:
        """Do not write this request, if it still waits here; whether it did.

        Without it the requests that callers gave up would pile up while the other side is stopped and takes none.
        """
        return self._waiting.pop(number, None) is not None

    async def _write_each(self) -> None:
        with suppress(grpc.RpcError, asyncio.InvalidStateError, asyncio.CancelledError):
            while True:
                while self._waiting:
                    await self._call.write(self._waiting.popitem(last=False)[1])
                self._more.clear()
                await self._more.wait()

    def _stop(self, _: Any) -> None:
        self._task.cancel()
        self._waiting.clear()


def spawn(tasks: set[asyncio.Task[None]], work: Any) -> asyncio.Task[None]:
    """A task that is held in `tasks` until it is done."""
    task: asyncio.Task[None] = asyncio.create_task(work)
    tasks.add(task)
    task.add_done_callback(tasks.discard)
    return task
