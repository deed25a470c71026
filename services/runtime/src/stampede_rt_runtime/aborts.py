"""Frees the objects of an aborted call as soon as the call ends.

gRPC keeps the error of an aborted call in the call's state. The error's traceback refers to the frames of all functions
that it passed. These frames refer to the call's context, and the context to the state. Without this module the requests
and everything else in those frames would stay until a run of Python's garbage collector, which looks at older objects
seldom (decision 0119).
"""

from __future__ import annotations

import inspect
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import Any

import grpc
from grpc.aio import AbortError

from stampede_rt_runtime.error_frames import drop_frames
from stampede_rt_runtime.handlers import behavior_of, with_behavior
from stampede_rt_runtime.rpc import Context


class AbortInterceptor(grpc.aio.ServerInterceptor):  # type: ignore[misc, unused-ignore]
    """Removes all frames but its own from the error of an aborted call. This interceptor must be the outermost one."""

    async def intercept_service(
        self,
        continuation: Callable[[grpc.HandlerCallDetails], Awaitable[Any]],
        handler_call_details: grpc.HandlerCallDetails,
    ) -> Any:
        """The method's handler, wrapped."""
        handler = await continuation(handler_call_details)
        if handler is None:
            return None
        behavior = behavior_of(handler)
        around = _stream_of if inspect.isasyncgenfunction(behavior) else _call_of
        return with_behavior(handler, around(behavior))


def _call_of(behavior: Callable[..., Any]) -> Callable[..., Any]:
    async def call(request: Any, context: Context) -> Any:
        try:
            return await behavior(request, context)
        except AbortError as error:
            request = context = None  # type: ignore[assignment]
            raise _without_frames(error)  # noqa: B904 - it is the same error

    return call


def _stream_of(behavior: Callable[..., AsyncIterator[Any]]) -> Callable[..., AsyncIterator[Any]]:
    async def stream(request: Any, context: Context) -> AsyncIterator[Any]:
        responses: Any = behavior(request, context)
        try:
            async for response in responses:
                yield response
        except AbortError as error:
            request = context = responses = None  # type: ignore[assignment]
            raise _without_frames(error)  # noqa: B904 - it is the same error
        finally:
            if responses is not None:
                await responses.aclose()

    return stream


def _without_frames(error: AbortError) -> AbortError:
    """Remove the frames of the error, and the frames of the errors that led to it.

    If a local variable refers to an error, the error and the frame of this variable refer to each other.
    """
    drop_frames(error)
    error.__cause__ = error.__context__ = None
    return error
