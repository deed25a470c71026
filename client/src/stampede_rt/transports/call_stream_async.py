"""An open bidirectional stream on asyncio. One task of the stream sends the requests, and another reads the responses.

The callers wait for futures. `call_stream_sync` has the same stream for threads, which need no tasks and no futures.
"""

from __future__ import annotations

import asyncio
from typing import Any, TypeVar

import grpc
import grpc.aio

from stampede_rt.errors import DeadlineExceeded, StampedeError, Unavailable
from stampede_rt.status import from_rpc_error
from stampede_rt.transports import forking
from stampede_rt.transports.requests_async import Requests, spawn
from stampede_rt.transports.socket_routes import SocketRoute
from stampede_rt.transports.streams_async import closed

Response = TypeVar("Response")


class CallStream:
    """An open bidirectional stream with a task that reads its responses."""

    def __init__(self, call: Any, target: str, tasks: set[asyncio.Task[None]], route: SocketRoute) -> None:
        self._call = call
        self._route, self._late_arrivals = route, route.late_arrivals
        self._target = target
        self._forks = forking.forks()
        self._requests = Requests(call, tasks)
        self.broken = False
        spawn(tasks, self._read())

    @property
    def is_outdated(self) -> bool:
        """Whether a new stream may be faster than this one. Then the owner should replace this one while it is idle."""
        return self._route.late_arrivals != self._late_arrivals

    async def _read(self) -> None:
        error: StampedeError = Unavailable(f"{self._target} ended the stream")
        try:
            async for response in self._call:
                await self._receive(response)
        except grpc.RpcError as failure:
            error = from_rpc_error(failure, self._target)
        except asyncio.CancelledError:
            error = closed(self._target)
        except StampedeError as defect:
            error = defect
        except Exception as defect:  # noqa: BLE001  # the waiting callers must get the error
            error = StampedeError(f"{self._target} sent an unexpected message: {defect!r}")
        self.cancel()
        await self._end(error)

    async def _receive(self, response: Any) -> None:
        raise NotImplementedError

    async def _end(self, error: StampedeError) -> None:
        raise NotImplementedError

    def cancel(self) -> None:
        """End the stream."""
        self.broken = True
        if self._forks == forking.forks():
            self._call.cancel()


async def within(future: asyncio.Future[Response], timeout_s: float | None, target: str) -> Response:
    """Return the result of `future`. Raises DeadlineExceeded after `timeout_s` seconds; None: waits without limit."""
    try:
        async with asyncio.timeout(timeout_s):
            return await future
    except TimeoutError:
        raise DeadlineExceeded(f"{target} did not answer within {timeout_s:g} s; it may be overloaded") from None
    finally:
        if not future.cancel() and not future.cancelled():
            future.exception()  # mark the error as retrieved, so that asyncio does not log it


def fail(future: asyncio.Future[Any], error: StampedeError) -> None:
    """End `future` with `error`, unless it has ended."""
    if not future.done():
        future.set_exception(error)
