"""The code that the servicers of all services share.

It holds the type of contexts, the conversion of errors to statuses, and handlers of unary calls.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine, Generator, Sequence
from contextlib import aclosing
from typing import Any, TypeAlias, TypeVar

import grpc
from google.protobuf.message import Message

from stampede_rt.errors import StampedeError
from stampede_rt.status import abort

# The context that gRPC passes to a method. The types of requests and responses are left open.
Context: TypeAlias = "grpc.aio.ServicerContext[Any, Any]"
Method = TypeVar("Method", bound=Callable[..., Any])


def answer_in_same_turn(context: Context, take: Callable[[bytes | memoryview, Callable[[bytes], None]], bool]) -> None:
    """Let `take` answer messages in the turn of the event loop in which they come, if the transport can do so.

    `take` gets an encoded message for which the method waits in `context.read`, and a function that writes a message.
    It returns False if it has not taken the message, which `read` then returns.
    """
    answer = getattr(context, "answer_in_same_turn", None)
    if answer is not None:
        answer(take)


def write_now(context: Context) -> Callable[[bytes | Sequence[bytes]], None] | None:
    """A function that writes an encoded message, or its parts (`takes_parts`), in this turn of the event loop.

    None if the transport has none, or the caller takes no bytes at present: then await `context.write`.
    """
    write: Callable[[bytes | Sequence[bytes]], None] | None = getattr(context, "write_now", None)
    return write


class StartedCoroutine(Awaitable[None]):
    """A coroutine whose first step has run. Await this object for the rest and for any error, also of the first step.

    `is_done`: there is no rest, and no error. The coroutine must not ask for its task.
    """

    def __init__(self, work: Coroutine[Any, Any, None]) -> None:
        self._work = work
        self._error: Exception | None = None
        self._waits_for: Any = None
        self.is_done = False
        try:
            self._waits_for = work.send(None)
        except StopIteration:
            self.is_done = True
        except Exception as error:  # noqa: BLE001 - `__await__` raises it
            self._error = error

    def close(self) -> None:
        """End the coroutine where it waits. Idempotent."""
        self._work.close()

    def __await__(self) -> Generator[Any, Any, None]:
        if self._error is not None:
            raise self._error
        try:
            while not self.is_done:
                try:
                    value = yield self._waits_for
                except BaseException as error:  # noqa: BLE001 - the coroutine gets it, such as a cancellation
                    self._waits_for = self._work.throw(error)
                else:
                    self._waits_for = self._work.send(value)
        except StopIteration:
            self.is_done = True


def takes_parts(context: Context) -> bool:
    """Whether `context.write` also takes the parts of an encoded message, which must not change any more."""
    return getattr(context, "takes_parts", False) is True


def errors_as_status(method: Method) -> Method:
    """Wraps `method` so that a StampedeError ends the RPC with the status of that error.

    Any other exception is a defect, and gRPC reports it as one. `method` takes (self, request, context), and returns a
    response or yields responses.
    """
    call = _stream_of(method) if inspect.isasyncgenfunction(method) else _call_of(method)
    return functools.wraps(method)(call)  # type: ignore[return-value]


def _call_of(method: Callable[..., Any]) -> Callable[..., Any]:
    async def call(self: Any, request: Any, context: Context) -> Any:
        try:
            return await method(self, request, context)
        except StampedeError as error:
            await abort(context, error)

    return call


def _stream_of(method: Callable[..., Any]) -> Callable[..., Any]:
    async def stream(self: Any, request: Any, context: Context) -> AsyncIterator[Any]:
        try:
            async with aclosing(method(self, request, context)) as responses:
                async for response in responses:
                    yield response
        except StampedeError as error:
            await abort(context, error)

    return stream


def unary(
    method: Callable[[Any, Context], Any], request: type[Message], response: type[Message]
) -> grpc.RpcMethodHandler[Any, Any]:
    """The handler of a call with one request and one response, for services that register their handlers themselves."""
    return grpc.unary_unary_rpc_method_handler(
        method, request_deserializer=request.FromString, response_serializer=response.SerializeToString
    )
