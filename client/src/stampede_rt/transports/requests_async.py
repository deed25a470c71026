"""The sending side of an open stream on asyncio."""

from __future__ import annotations

import asyncio
from collections import OrderedDict
from contextlib import suppress
from typing import Any

import grpc
import grpc.aio

from stampede_rt.errors import StampedeError
from stampede_rt.transports.socket_async import OpeningCall
from stampede_rt.wire.request_pieces import messages_of


class Requests:
    """Writes the requests of one call in their order, in its own task, until the call ends.

    If a task is cancelled while it writes, grpc.aio ends the call. If the call ends during its opening, a write waits
    for ever. Therefore only one task writes, and only the end of the call cancels it. `send` only adds a request to a
    list, so it does not block and cannot be cancelled. This class does not report the end of the call; the reader of
    the responses learns of it.
    """

    def __init__(self, call: Any, tasks: set[asyncio.Task[None]]) -> None:
        self._call = call
        self._waiting: OrderedDict[int, Any] = OrderedDict()
        self._sent = 0
        self._more = asyncio.Event()
        self._task = spawn(tasks, self._write_each())
        call.add_done_callback(self._stop)

    def __len__(self) -> int:
        """The number of requests that are not written yet."""
        return len(self._waiting)

    def send(self, request: Any) -> int:
        """Add `request`, and return its number for `withdraw`. After the end of the call the request is not sent."""
        self._sent += 1
        self._waiting[self._sent] = request
        self._more.set()
        return self._sent

    def withdraw(self, number: int) -> bool:
        """Remove a request that is not written yet. Returns whether it was still there.

        Without this, requests of callers that gave up would pile up while the server is stopped.
        """
        return self._waiting.pop(number, None) is not None

    async def _write_each(self) -> None:
        with suppress(grpc.RpcError, StampedeError, asyncio.InvalidStateError, asyncio.CancelledError):
            while True:
                while self._waiting:
                    request = self._waiting.popitem(last=False)[1]
                    for message in (request,) if isinstance(self._call, OpeningCall) else messages_of(request):
                        await self._call.write(message)
                self._more.clear()
                await self._more.wait()

    def _stop(self, _: Any) -> None:
        self._task.cancel()
        self._waiting.clear()


def spawn(tasks: set[asyncio.Task[None]], work: Any) -> asyncio.Task[None]:
    """Start a task, and keep it in `tasks` until it is done."""
    task: asyncio.Task[None] = asyncio.create_task(work)
    tasks.add(task)
    task.add_done_callback(tasks.discard)
    return task
