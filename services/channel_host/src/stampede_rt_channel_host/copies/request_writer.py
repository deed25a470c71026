"""Writes the requests of one feed to its source, one after the other."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from stampede_rt.errors import StampedeError
from stampede_rt.v1 import replica_service_pb2 as pb
from stampede_rt_channel_host.copies.feed_calls import BROKEN_AFTER_SECONDS
from stampede_rt_runtime.sockets.dialing import HostStream


class RequestWriter:
    """The requests of the open stream of a feed.

    A task writes each request that no message of the source causes. This task begins with the first such request,
    because most moves are over earlier.
    """

    def __init__(
        self, wait_seconds: Callable[[], float], check_source: Callable[[], None],
        next_request: Callable[[], pb.FeedRequest],
    ) -> None:  # fmt: skip
        """`wait_seconds` returns the time until the task's next request. `check_source` raises TimeoutError if the
        source is silent. `next_request` makes a request; it may raise StampedeError.
        """
        self._wait_seconds = wait_seconds
        self._check_source = check_source
        self._next_request = next_request
        self._turn = asyncio.Lock()  # taken while a request is written
        self._wakeup = asyncio.Event()
        self._call: Any = None  # None: no stream is open
        self._tasks: asyncio.TaskGroup | None = None
        self._task: asyncio.Task[None] | None = None
        self._timer: asyncio.TimerHandle | None = None

    def open(self, call: Any, tasks: asyncio.TaskGroup) -> None:
        """Begin to write to a stream. `tasks` gets the task. Its errors are those of the stream and of `next_request`,
        and TimeoutError.
        """
        self._call, self._tasks, self._task = call, tasks, None
        self._timer = asyncio.get_running_loop().call_later(self._wait_seconds(), self._begin)
        if self._wakeup.is_set():
            self._begin()

    @property
    def is_busy(self) -> bool:
        """Whether a request is being written, so that further requests have to wait."""
        return self._turn.locked()

    def wake(self) -> None:
        """Let the task write a request soon."""
        self._wakeup.set()
        self._begin()

    def write_soon(self) -> None:
        """Write a request immediately if the stream takes it without a wait. Otherwise the task writes it.

        Raises nothing: the task gets the error of `next_request`.
        """
        write = None if self.is_busy or not isinstance(self._call, HostStream) else self._call.write_now
        with suppress(StampedeError):
            if write is not None:
                write(self._next_request())
                return
        self.wake()

    async def write(self) -> None:
        """Write a request. If another one is being written, lets the task write it."""
        if self.is_busy:
            self.wake()
            return
        async with self._turn:
            await self._call.write(self._next_request())

    def note_request(self) -> None:
        """Note that a request has been made. It has everything for which somebody called `wake`."""
        self._wakeup.clear()

    def _begin(self) -> None:
        if self._tasks is not None and self._task is None:
            self._task = self._tasks.create_task(self._write_all(self._call))

    async def _write_all(self, call: Any) -> None:
        while True:  # until `aclose` cancels this task, or an error ends it
            self._check_source()
            async with asyncio.timeout(BROKEN_AFTER_SECONDS), self._turn:
                await call.write(self._next_request())
            with suppress(TimeoutError):
                async with asyncio.timeout(self._wait_seconds()):
                    await self._wakeup.wait()

    def stop(self) -> None:
        """Begin no task any more, because the stream ends. Idempotent."""
        self._call = self._tasks = None
        if self._timer is not None:
            self._timer.cancel()

    async def aclose(self) -> None:
        """Stop, and end the task after its present request: gRPC would end a stream in which a write is cancelled."""
        self.stop()
        if self._task is not None:
            async with self._turn:
                self._task.cancel()
