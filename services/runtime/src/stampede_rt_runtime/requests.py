"""Reads the requests of a call after the caller is admitted, within a time limit, and refuses invalid ones.

gRPC itself reads and parses the request of a unary call before any interceptor sees the call. So a caller without a
credential could make the service buffer large requests, keep calls open with unfinished requests, and fill the log with
failed parses.
"""

from __future__ import annotations

import asyncio
import contextlib
import inspect
from collections.abc import AsyncIterator, Callable
from typing import Any
from weakref import WeakKeyDictionary

import grpc

from stampede_rt.errors import DeadlineExceeded, InvalidArgument, StampedeError
from stampede_rt.status import abort
from stampede_rt_runtime.access.control import current_account, current_work
from stampede_rt_runtime.handlers import behavior_of
from stampede_rt_runtime.pacing import TurnGate
from stampede_rt_runtime.quotas.accounts import Account, unlimited
from stampede_rt_runtime.rpc import Context

REQUEST_SECONDS_MAX = 10.0
READS_MAX = 32
"""The most single requests of one caller that gRPC reads at the same time. Further calls of the caller wait.

gRPC keeps each request in memory until it is complete, up to 4 MiB at a supernode, and no quota counts this memory.
"""

Parse = Callable[[bytes], Any]


_turns: WeakKeyDictionary[Account, asyncio.Semaphore] = WeakKeyDictionary()


def _turn_to_read() -> contextlib.AbstractAsyncContextManager[Any]:
    """A context in which the present caller reads one request. Services of the cluster and operators never wait."""
    account = current_account()
    if account is unlimited():
        return contextlib.nullcontext()
    turn = _turns.get(account)
    if turn is None:
        turn = _turns[account] = asyncio.Semaphore(READS_MAX)
    return turn


def reading_late(method: str, handler: Any, gate: TurnGate) -> Any:
    """A handler for the same `method` that runs before a request is read. On the wire it is of the same kind.

    `gate` admits the calls whose single request has come.
    """
    parse = _parser(method, handler.request_deserializer)
    make = grpc.stream_stream_rpc_method_handler if handler.response_streaming else grpc.stream_unary_rpc_method_handler
    behavior = behavior_of(handler)
    if handler.request_streaming:
        return make(_refusing(behavior), parse, handler.response_serializer)
    return make(_refusing(_with_one_request(method, behavior, parse, gate)), None, handler.response_serializer)


def _parser(method: str, deserializer: Parse | None) -> Parse | None:
    """Wraps `deserializer` so that it raises InvalidArgument for bytes that are no request of the method."""
    if deserializer is None:
        return None

    def parse(raw: bytes) -> Any:
        try:
            return deserializer(raw)
        except Exception as error:  # any error of a generated parser comes from the caller's bytes
            raise InvalidArgument(
                f"the {len(raw)} bytes that were sent are no request of {method}; generate the caller's stubs from the "
                "same proto/ files"
            ) from error

    return parse


def _with_one_request(
    method: str, behavior: Callable[..., Any], parse: Parse | None, gate: TurnGate
) -> Callable[..., Any]:
    """Wraps `behavior`, which takes one request, for a call whose requests come as a stream."""

    async def read(context: Context) -> Any:
        try:
            async with asyncio.timeout(REQUEST_SECONDS_MAX), _turn_to_read():
                raw = await context.read()
                current_work().received(raw)
        except TimeoutError:
            raise DeadlineExceeded(
                f"no whole request of {method} came within {REQUEST_SECONDS_MAX:g} s; send it when the call begins"
            ) from None
        account = current_account()
        if not gate.try_admit(account):
            await gate.turn(account)
        if raw is grpc.aio.EOF:
            raise InvalidArgument(f"{method} was called without a request; send one")
        return raw if parse is None else parse(raw)

    if inspect.isasyncgenfunction(behavior):

        async def stream(_requests: Any, context: Context) -> AsyncIterator[Any]:
            async with contextlib.aclosing(behavior(await read(context), context)) as responses:
                async for response in responses:
                    yield response

        return stream

    async def call(_requests: Any, context: Context) -> Any:
        return await behavior(await read(context), context)

    return call


def _refusing(behavior: Callable[..., Any]) -> Callable[..., Any]:
    """Wraps `behavior` so that a StampedeError from it ends the call with that error."""
    if inspect.isasyncgenfunction(behavior):

        async def stream(requests: Any, context: Context) -> AsyncIterator[Any]:
            async with _aborting(context), contextlib.aclosing(behavior(requests, context)) as responses:
                async for response in responses:
                    yield response

        return stream

    async def call(requests: Any, context: Context) -> Any:
        async with _aborting(context):
            return await behavior(requests, context)

    return call


@contextlib.asynccontextmanager
async def _aborting(context: Context) -> AsyncIterator[None]:
    """A context that ends the call with a StampedeError raised inside it."""
    try:
        yield
    except StampedeError as error:
        await abort(context, error)
    except BaseExceptionGroup as group:  # the errors of the tasks that serve a stream
        errors = group.subgroup(StampedeError)
        if errors is None:
            raise
        await abort(context, _first(errors))


def _first(group: BaseExceptionGroup[Any]) -> StampedeError:
    error: Any = group
    while isinstance(error, BaseExceptionGroup):
        error = error.exceptions[0]
    assert isinstance(error, StampedeError), "every error of the group is a StampedeError"
    return error
