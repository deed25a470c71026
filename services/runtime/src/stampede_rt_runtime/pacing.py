"""Counts the work of calls for their callers, and lets a few streams run in each turn of the event loop.

gRPC reports all completed operations of a turn of the event loop together. With 1000 subscriptions, 200 of them
completed a write in one turn, and each then looked for its next message. The turn took 10 ms and more, and the service
did nothing else meanwhile. Therefore a gate admits only a few streams to each turn (decision 0123). The streams of each
caller wait in a line of their own. So a caller with 3000 streams delays the streams of other callers by one turn only
(decision 0139).
"""

from __future__ import annotations

import asyncio
import contextlib
import inspect
import time
from collections import OrderedDict, deque
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import aclosing
from functools import partial
from typing import Any

import grpc

from stampede_rt_runtime.access.control import current_account, current_work
from stampede_rt_runtime.handlers import behavior_of, is_stream, with_behavior
from stampede_rt_runtime.quotas.accounts import Account, unlimited
from stampede_rt_runtime.quotas.working import CallerWork, charged, costs_of
from stampede_rt_runtime.rpc import Context
from stampede_rt_runtime.stream_headers import send_headers

STREAMS_PER_TURN = 4
"""The steps of this number of streams take up to 0.5 ms. With 16, each step would take 0.3 us less (decision 0123)."""
SAME_TURN_NANOS = 1_000_000


class TurnGate:
    """Admits STREAMS_PER_TURN streams in each turn of the event loop. The others wait for the next turns.

    The waiting streams of each caller have a line of their own. The gate admits one stream of each line in rotation.
    """

    def __init__(self) -> None:
        self._admissions_left = STREAMS_PER_TURN
        self._lines: OrderedDict[Account, deque[asyncio.Future[None]]] = OrderedDict()
        self._is_counting = False

    def try_admit(self, caller: Account) -> bool:
        """Admit a stream of the caller to this turn, if the turn has room and no stream of the caller waits.

        If this returns False, the stream must await `turn`.
        """
        if not self._admissions_left or caller in self._lines:
            return False
        self._admissions_left -= 1
        if not self._is_counting:
            self._is_counting = True
            asyncio.get_running_loop().call_soon(self._begin_turn)
        return True

    async def turn(self, caller: Account) -> None:
        """Wait for the turn of the event loop in which the stream may run."""
        admission = asyncio.get_running_loop().create_future()
        self._lines.setdefault(caller, deque()).append(admission)
        await admission

    def _begin_turn(self) -> None:
        self._admissions_left = STREAMS_PER_TURN
        while self._lines and self._admissions_left:
            caller, line = self._lines.popitem(last=False)
            admission = line.popleft()
            if line:
                self._lines[caller] = line  # after the other callers
            if not admission.done():  # otherwise the stream has ended
                admission.set_result(None)
                self._admissions_left -= 1
        self._is_counting = bool(self._lines) or self._admissions_left < STREAMS_PER_TURN
        if self._is_counting:
            asyncio.get_running_loop().call_soon(self._begin_turn)


class SameTurnBudget:
    """Limits the time for which messages are answered in the turn of the event loop in which they come.

    When the answers of one turn have used SAME_TURN_NANOS, further messages go to their streams. The gates let only a
    few streams run in each turn. Each pause between two answers reduces the used time by the length of the pause. So a
    loop with little to do keeps its whole budget.
    """

    def __init__(self, now: Callable[[], int] = time.monotonic_ns) -> None:
        self._now = now
        self._used_nanos = self._ended_at = 0
        self._reset_is_scheduled = False

    def is_left(self) -> bool:
        """Whether the next message may be answered now. If not, schedule a reset of the budget in the next turn."""
        if self._used_nanos - (self._now() - self._ended_at) < SAME_TURN_NANOS:
            return True
        if not self._reset_is_scheduled:
            self._reset_is_scheduled = True
            asyncio.get_running_loop().call_soon(self._begin_turn)
        return False

    def spend(self, nanos: int) -> None:
        """Count the time of an answer that ends now."""
        now = self._now()
        self._used_nanos = max(0, self._used_nanos - (now - nanos - self._ended_at)) + nanos
        self._ended_at = now

    def _begin_turn(self) -> None:
        self._used_nanos, self._reset_is_scheduled = 0, False


class PacedContext:
    """The context of a stream. After a message was read or written, the stream continues when its gate admits it."""

    def __init__(
        self,
        context: Context,
        reads: TurnGate,
        writes: TurnGate,
        caller: Account | None = None,
        same_turn: SameTurnBudget | None = None,
    ) -> None:
        """`caller`: None for one without quotas. `same_turn`: None if all messages go to the stream."""
        self._context = context
        self._same_turn = same_turn
        self._has_headers = False
        self._reads = reads
        self._writes = writes
        self._caller = caller or unlimited()
        self._work = CallerWork(self._caller, costs_of(context))

    async def read(self) -> Any:
        """The next message, or EOF. Returns when the message is there and the gate admits the stream."""
        message = await self._context.read()
        self._work.received(message)
        if not self._reads.try_admit(self._caller):
            await self._reads.turn(self._caller)
        return message

    async def write(self, message: Any) -> None:
        """Write a message. Returns when gRPC has taken the message and the gate admits the stream."""
        if not self._has_headers:
            self._has_headers = True
            await send_headers(self._context)
        await self._context.write(message)
        if not self._writes.try_admit(self._caller):
            await self._writes.turn(self._caller)

    @property
    def write_now(self) -> Callable[[bytes], None] | None:
        """See `SocketContext`. None over gRPC."""
        write: Callable[[bytes], None] | None = getattr(self._context, "write_now", None)
        return write

    def answer_in_same_turn(self, take: Callable[[bytes | memoryview, Callable[[bytes], None]], bool]) -> None:
        """See `SocketContext`. Streams over gRPC cannot do this.

        `take` gets a message only if the caller need not wait for its turn. The work of `take` counts for the caller.
        """
        answer = getattr(self._context, "answer_in_same_turn", None)
        if answer is not None and self._same_turn is not None:
            answer(partial(self._take_in_same_turn, self._same_turn, take))

    def _take_in_same_turn(
        self,
        budget: SameTurnBudget,
        take: Callable[[bytes | memoryview, Callable[[bytes], None]], bool],
        message: bytes | memoryview,
        write: Callable[[bytes], None],
    ) -> bool:
        if self._work.must_wait or not budget.is_left():
            return False
        began_at = time.thread_time_ns()
        is_taken = take(message, write)
        nanos = time.thread_time_ns() - began_at
        budget.spend(nanos)
        self._work.spend(nanos)
        if is_taken:
            self._work.received(message)
        return is_taken

    def __getattr__(self, name: str) -> Any:
        """Every other attribute of the context."""
        return getattr(self._context, name)


class PacingInterceptor(grpc.aio.ServerInterceptor):  # type: ignore[misc, unused-ignore]
    """Charges the work of all calls to their callers, and paces streams.

    Streams that read do not wait for streams that write.
    """

    def __init__(self) -> None:
        self._reads, self._writes, self._ends = TurnGate(), TurnGate(), TurnGate()
        self._same_turn = SameTurnBudget()

    async def intercept_service(
        self,
        continuation: Callable[[grpc.HandlerCallDetails], Awaitable[Any]],
        handler_call_details: grpc.HandlerCallDetails,
    ) -> Any:
        """The method's handler, with a paced context if it is a stream."""
        handler = await continuation(handler_call_details)
        if handler is None:
            return None
        behavior = behavior_of(handler)
        if not is_stream(handler):
            return with_behavior(handler, _charging(behavior))
        writing = _writing(behavior) if inspect.isasyncgenfunction(behavior) else behavior
        return with_behavior(handler, self._paced(writing))

    def _paced(self, behavior: Callable[..., Any]) -> Callable[..., Any]:
        async def call(request: Any, context: Context) -> Any:
            caller = current_account()
            paced = PacedContext(context, self._reads, self._writes, caller, self._same_turn)
            serving: asyncio.Task[Any] = asyncio.create_task(charged(caller, behavior(request, paced)))
            try:
                await asyncio.wait({serving})
            except asyncio.CancelledError:  # the caller has gone, maybe with many streams: they end a few at a time
                if not self._ends.try_admit(caller):
                    # a second cancellation may come here; without `serving.cancel` the stream would stay for ever
                    with contextlib.suppress(asyncio.CancelledError):
                        await self._ends.turn(caller)
                serving.cancel()
            try:
                return await serving
            finally:
                del serving  # an error refers to this frame, and the task to the error: leave no reference cycle

        return call


def _charging(behavior: Callable[..., Any]) -> Callable[..., Any]:
    async def call(request: Any, context: Context) -> Any:
        return await charged(current_account(), behavior(request, context))

    return call


def _writing(behavior: Callable[..., AsyncIterator[Any]]) -> Callable[..., Any]:
    """A method that writes its responses to its context, when it is the caller's turn, instead of yielding them."""

    async def write_all(request: Any, context: Context) -> None:
        responses, work = behavior(request, context), current_work()
        async with aclosing(responses):  # type: ignore[type-var]
            async for response in responses:
                if work.must_wait:
                    await work.turn()
                work.spend_write()
                await context.write(response)

    return write_all
