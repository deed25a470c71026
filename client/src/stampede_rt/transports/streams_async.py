"""Streams of responses on asyncio. `ServerStream` has one request; `BidiStream` sends requests at any time."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from functools import partial
from typing import Any, Generic, TypeVar

import grpc
import grpc.aio

from stampede_rt.errors import Unavailable
from stampede_rt.status import raise_from_rpc_error
from stampede_rt.transports import forking
from stampede_rt.transports.concurrency_async import when_dropped
from stampede_rt.transports.grpc_options import SILENCE_S_MAX, WAITING_REQUESTS_MAX
from stampede_rt.transports.requests_async import Requests

Response = TypeVar("Response")


def closed(target: str) -> Unavailable:
    """Return the error of a call during which its connection closed."""
    return Unavailable(f"the connection to {target} is closed")


def silent(target: str) -> Unavailable:
    """Return the error of a stream on which the server gave no sign of life."""
    return Unavailable(f"{target} gave no sign of life for {SILENCE_S_MAX:g} s; it may be stopped")


def is_cancelled() -> bool:
    """Whether this task was cancelled. If not, only its gRPC call was cancelled."""
    task = asyncio.current_task()
    return task is not None and task.cancelling() > 0


async def _give_up(call: Any) -> None:
    call.cancel()


class ServerStream(Generic[Response]):
    """The responses to one request. `cancel` ends the iteration; only code on the event loop may call it."""

    def __init__(self, call: Any, target: str) -> None:
        self._call = call
        self._target = target
        self._forks = forking.forks()
        self._cancelled = False
        when_dropped(self, partial(_give_up, call))

    @property
    def target(self) -> str:
        """The address of the server."""
        return self._target

    async def __aiter__(self) -> AsyncIterator[Response]:
        responses = aiter(self._call)
        try:
            while True:
                async with asyncio.timeout(SILENCE_S_MAX):
                    response = await anext(responses)
                yield response
                del response  # it may be a view of the memory into which the next one is read
        except StopAsyncIteration:
            pass
        except TimeoutError:
            self._call.cancel()
            raise silent(self._target) from None
        except grpc.RpcError as error:
            if not self._cancelled:
                raise_from_rpc_error(error, self._target)
        except asyncio.CancelledError:
            if is_cancelled():  # also if `cancel` was called in the same turn of the loop
                self._call.cancel()
                raise
            if not self._cancelled:
                raise closed(self._target) from None
        if not self._cancelled:
            raise Unavailable(f"{self._target} ended the stream")

    def cancel(self) -> None:
        """End the stream."""
        self._cancelled = True
        if self._forks == forking.forks():
            self._call.cancel()


class BidiStream(ServerStream[Response]):
    """A stream in both directions: `send` sends requests, and the iteration receives responses."""

    def __init__(self, call: Any, target: str, tasks: set[asyncio.Task[None]]) -> None:
        super().__init__(call, target)
        self._requests = Requests(call, tasks)

    async def send(self, request: Any) -> None:
        """Send `request` without waiting. If the stream is broken, the iteration raises the reason.

        Raises Unavailable if WAITING_REQUESTS_MAX requests wait because the server takes none of them.
        """
        if len(self._requests) >= WAITING_REQUESTS_MAX:
            self._call.cancel()
            raise Unavailable(f"{self._target} takes no requests; it may be stopped")
        self._requests.send(request)
