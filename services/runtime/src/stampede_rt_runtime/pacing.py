"""Lets a few streams go on in each turn of the event loop, however many of their messages have come or gone at once.

gRPC hands over all completed operations of a turn together. With 1000 subscriptions 200 of them had written a message,
and each then looked for its next one: a turn of 10 ms and more, in which the service did nothing else (decision 0123).
"""

from __future__ import annotations

import asyncio
import contextlib
import inspect
from collections import deque
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import aclosing
from typing import Any

import grpc

from stampede_rt_runtime.handlers import behavior_of, is_stream, with_behavior
from stampede_rt_runtime.rpc import Context

STREAMS_PER_TURN = 16


class TurnGate:
    """Admits STREAMS_PER_TURN callers in each turn of the event loop. The others wait in line for the next turns."""

    def __init__(self) -> None:
        self._left = STREAMS_PER_TURN
        self._line: deque[asyncio.Future[None]] = deque()
        self._is_counting = False

    def admits(self) -> bool:
        """Whether the caller may go on in this turn. If not, it must await `turn`."""
        if not self._left or self._line:
            return False
        self._left -= 1
        if not self._is_counting:
            self._is_counting = True
            asyncio.get_running_loop().call_soon(self._begin_turn)
        return True

    async def turn(self) -> None:
        """Return in the turn in which the caller may go on."""
        place = asyncio.get_running_loop().create_future()
        self._line.append(place)
        await place

    def _begin_turn(self) -> None:
        self._left = STREAMS_PER_TURN
        while self._line and self._left:
            place = self._line.popleft()
            if not place.done():  # if it is, its caller has gone
                place.set_result(None)
                self._left -= 1
        self._is_counting = bool(self._line) or self._left < STREAMS_PER_TURN
        if self._is_counting:
            asyncio.get_running_loop().call_soon(self._begin_turn)


class PacedContext:
    """The context of a stream. After a message was read or written, the stream goes on when its gate admits it."""

    def __init__(self, context: Context, reads: TurnGate, writes: TurnGate) -> None:
        self._context = context
        self._reads = reads
        self._writes = writes

    async def read(self) -> Any:
        """The next message, or EOF. Returns when the message is there and the gate admits the stream."""
        message = await self._context.read()
        if not self._reads.admits():
            await self._reads.turn()
        return message

    async def write(self, message: Any) -> None:
        """Write a message. Returns when gRPC has taken the message and the gate admits the stream."""
        await self._context.write(message)
        if not self._writes.admits():
            await self._writes.turn()

    def __getattr__(self, name: str) -> Any:
        """Every other attribute of the context."""
        return getattr(self._context, name)


class PacingInterceptor(grpc.aio.ServerInterceptor):  # type: ignore[misc, unused-ignore]
    """Paces the streams of a server. Streams that read do not wait for streams that write."""

    def __init__(self) -> None:
        self._reads, self._writes, self._ends = TurnGate(), TurnGate(), TurnGate()

    async def intercept_service(
        self,
        continuation: Callable[[grpc.HandlerCallDetails], Awaitable[Any]],
        handler_call_details: grpc.HandlerCallDetails,
    ) -> Any:
        """The method's handler, with a paced context if it is a stream."""
        handler = await continuation(handler_call_details)
        if handler is None or not is_stream(handler):
            return handler
        behavior = behavior_of(handler)
        writing = _writing(behavior) if inspect.isasyncgenfunction(behavior) else behavior
        return with_behavior(handler, self._paced(writing))

    def _paced(self, behavior: Callable[..., Any]) -> Callable[..., Any]:
        async def call(request: Any, context: Context) -> Any:
            paced = PacedContext(context, self._reads, self._writes)
            serving: asyncio.Task[Any] = asyncio.create_task(behavior(request, paced))
            try:
                await asyncio.wait({serving})
            except asyncio.CancelledError:  # the caller has gone, maybe with many streams: they end a few at a time
                if not self._ends.admits():
                    # a second cancellation may come here; without `serving.cancel` the stream would stay for good
                    with contextlib.suppress(asyncio.CancelledError):
                        await self._ends.turn()
                serving.cancel()
            try:
                return await serving
            finally:
                del serving  # an error refers to this frame, and the task to the error: leave no reference cycle

        return call


def _writing(behavior: Callable[..., AsyncIterator[Any]]) -> Callable[..., Awaitable[None]]:
    """A method that writes its responses to its context instead of yielding them."""

    async def write_all(request: Any, context: Context) -> None:
        responses: Any = behavior(request, context)
        async with aclosing(responses):
            async for response in responses:
                await context.write(response)

    return write_all
