"""Wraps the method of a gRPC server, of any of gRPC's four kinds.

gRPC gives an interceptor neither the caller's certificate nor the end of a call. Only a running call has them, so this
module wraps the handler.
"""

from __future__ import annotations

import contextlib
import inspect
from collections.abc import AsyncIterator, Callable
from typing import Any

import grpc

from stampede_rt_runtime.rpc import Context

# Entered with the call's context before the method runs, and left when the method has ended. It may end the call.
Guard = Callable[[Any], contextlib.AbstractAsyncContextManager[None]]


def is_stream(handler: Any) -> bool:
    """Whether a handler's calls may stay open, because either side sends a stream of messages."""
    return bool(handler.request_streaming or handler.response_streaming)


def guarded(handler: Any, guard: Guard) -> Any:
    """A handler of the same kind. Each of its calls runs inside `guard`."""
    behavior = behavior_of(handler)
    around = _around_iterator if inspect.isasyncgenfunction(behavior) else _around_call
    return with_behavior(handler, around(behavior, guard))


def with_behavior(handler: Any, behavior: Callable[..., Any]) -> Any:
    """A handler of the same kind that runs `behavior`."""
    make, _ = _kind(handler)
    return make(
        behavior,
        request_deserializer=handler.request_deserializer,
        response_serializer=handler.response_serializer,
    )


def behavior_of(handler: Any) -> Callable[..., Any]:
    """The function that a handler runs for each call."""
    behavior: Callable[..., Any] = _kind(handler)[1]
    return behavior


def _around_call(behavior: Callable[..., Any], guard: Guard) -> Callable[..., Any]:
    async def call(request: Any, context: Context) -> Any:
        async with guard(context):
            return await behavior(request, context)

    return call


def _around_iterator(behavior: Callable[..., AsyncIterator[Any]], guard: Guard) -> Callable[..., AsyncIterator[Any]]:
    async def call(request: Any, context: Context) -> AsyncIterator[Any]:
        async with guard(context):
            responses: Any = behavior(request, context)
            async with contextlib.aclosing(responses):
                async for response in responses:
                    yield response

    return call


def _kind(handler: Any) -> tuple[Callable[..., Any], Any]:
    """The constructor of handlers of this kind, and the function of this handler."""
    if handler.request_streaming:
        if handler.response_streaming:
            return grpc.stream_stream_rpc_method_handler, handler.stream_stream
        return grpc.stream_unary_rpc_method_handler, handler.stream_unary
    if handler.response_streaming:
        return grpc.unary_stream_rpc_method_handler, handler.unary_stream
    return grpc.unary_unary_rpc_method_handler, handler.unary_unary
