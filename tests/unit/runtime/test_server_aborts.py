"""The objects of a call are freed with the call, also after a refusal. Nothing is left to the garbage collector.

A stream that its service ends during its first write tells its caller the reason.
"""

from __future__ import annotations

import asyncio
import contextlib
import gc
import weakref
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import Any

import grpc
import pytest

from stampede_rt.errors import InvalidArgument
from stampede_rt.v1 import directory_service_pb2 as pb
from stampede_rt_runtime import stream_headers
from stampede_rt_runtime.access.open_call import OpenCall
from stampede_rt_runtime.dial import dial
from stampede_rt_runtime.error_frames import drop_frames, failure_of
from stampede_rt_runtime.server import serving
from stampede_rt_runtime.stream_headers import send_headers

LIST = "/stampede_rt.v1.DirectoryService/ListChannels"
WATCH = "/stampede_rt.v1.DirectoryService/Watch"
RESOLVE = "/stampede_rt.v1.DirectoryService/ResolveChannel"
LIMIT_S = 20.0
SERVED = {"RPCState", "_ServicerContext", "CallerWork", "_ChargedCoroutine"}  # the objects that a server has for a call
UPDATE = "/stampede_rt.v1.DirectoryService/UpdateChannel"


class HeldObject:
    """Stands for an object that a method holds when it refuses."""


class RefusingServicer(grpc.GenericRpcHandler):
    """A single call and a stream that hold something and then raise."""

    def __init__(self) -> None:
        self.held: list[weakref.ref[HeldObject]] = []
        self.begun = asyncio.Event()

    def service(self, details: grpc.HandlerCallDetails) -> Any:
        if details.method == LIST:
            return grpc.unary_unary_rpc_method_handler(self._list, pb.ListChannelsRequest.FromString)
        if details.method == RESOLVE:
            return grpc.unary_unary_rpc_method_handler(self._resolve, pb.ListChannelsRequest.FromString)
        if details.method == UPDATE:
            return grpc.unary_unary_rpc_method_handler(self._update, pb.ListChannelsRequest.FromString)
        return grpc.unary_stream_rpc_method_handler(self._watch, pb.ListChannelsRequest.FromString)

    async def _list(self, _request: pb.ListChannelsRequest, _context: Any) -> bytes:
        held = HeldObject()
        self.held.append(weakref.ref(held))
        failure = InvalidArgument("refused")  # the frame and the error now refer to each other
        raise failure

    async def _resolve(self, _request: pb.ListChannelsRequest, _context: Any) -> bytes:
        return b""

    async def _update(self, _request: pb.ListChannelsRequest, _context: Any) -> None:
        """Waits until it is cancelled."""
        self.begun.set()
        await asyncio.Event().wait()

    async def _watch(self, _request: pb.ListChannelsRequest, _context: Any) -> AsyncIterator[bytes]:
        held = HeldObject()
        self.held.append(weakref.ref(held))
        yield b""
        raise InvalidArgument("refused")


@pytest.mark.parametrize("method", [LIST, WATCH])
async def test_the_memory_of_a_refused_call_is_freed_without_the_collector(method: str) -> None:
    handler = RefusingServicer()
    gc.collect()
    gc.disable()
    try:
        async with serving(lambda server: server.add_generic_rpc_handlers((handler,))) as server:
            channel = dial(server.address, secret=None)
            call = channel.unary_stream(method, pb.ListChannelsRequest.SerializeToString)(pb.ListChannelsRequest())
            with pytest.raises(grpc.aio.AioRpcError) as refused:
                async for _ in call:
                    pass
            await channel.close()
        assert refused.value.code() == grpc.StatusCode.INVALID_ARGUMENT
        assert [one() for one in handler.held] == [None]
    finally:
        gc.enable()


@pytest.mark.parametrize("method", [RESOLVE, LIST, WATCH, UPDATE])
async def test_the_task_of_a_call_is_freed_without_the_collector(method: str) -> None:
    """In an earlier version, after each call its task, its context and the objects that gRPC kept for it stayed in
    memory.

    These were 14 objects, 77 if the call was refused, and 89 if its caller cancelled it.
    """
    handler = RefusingServicer()
    async with serving(lambda server: server.add_generic_rpc_handlers((handler,))) as server:
        channel = dial(server.address, secret=None)
        gc.collect()
        gc.set_debug(gc.DEBUG_SAVEALL)
        try:
            call = channel.unary_stream(method, pb.ListChannelsRequest.SerializeToString)(pb.ListChannelsRequest())
            if method == UPDATE:
                await handler.begun.wait()
                call.cancel()
            with contextlib.suppress(grpc.aio.AioRpcError, asyncio.CancelledError):
                async for _ in call:
                    pass
            async with asyncio.timeout(20):
                while any("HandleExceptions" in one.get_name() for one in asyncio.all_tasks()):  # noqa: ASYNC110
                    await asyncio.sleep(0)
            del call
            gc.collect()
            kept = [one for one in gc.garbage if isinstance(one, OpenCall) or type(one).__name__ in SERVED]
        finally:
            gc.set_debug(0)
            gc.garbage.clear()
            await channel.close()
    assert kept == []


async def ended_during(context: Any, step: Callable[[], Awaitable[Any]]) -> None:
    """Cancel the step once it waits, as the end of a stream does, and end the call with a status."""
    task = asyncio.current_task()
    assert task is not None
    asyncio.get_running_loop().call_soon(task.cancel)
    try:
        await step()
    except asyncio.CancelledError:
        task.uncancel()
        await context.abort(grpc.StatusCode.FAILED_PRECONDITION, "the service ended it")


async def code_of(behavior: Callable[[Any, Any], Any]) -> grpc.StatusCode:
    """The status of a stream of `behavior` at a real server."""

    def register(server: grpc.aio.Server) -> None:
        handlers = {"Stream": grpc.stream_stream_rpc_method_handler(behavior)}
        server.add_generic_rpc_handlers((grpc.method_handlers_generic_handler("test.Streams", handlers),))

    async with serving(register) as server, dial(server.address, secret=None) as channel:
        call: Any = channel.stream_stream("/test.Streams/Stream")(timeout=LIMIT_S)
        await call.write(b"request")
        with pytest.raises(grpc.aio.AioRpcError) as ended:
            async for _ in call:
                pass
        return ended.value.code()


@pytest.mark.parametrize("earlier_writes", [0, 1])
async def test_a_stream_that_is_ended_during_a_write_gets_its_status(earlier_writes: int) -> None:
    """In an earlier version, a stream that ended during its first write had no status, and its caller waited for
    ever.
    """

    async def behavior(requests: Any, context: Any) -> None:
        await anext(requests)  # the caller has sent its request: an end before it would fail the caller's write
        for _ in range(earlier_writes):
            await context.write(b"earlier")
        await ended_during(context, lambda: context.write(b"message"))

    assert await code_of(behavior) is grpc.StatusCode.FAILED_PRECONDITION


async def test_unread_headers_delay_the_end_of_a_stream_for_a_limited_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(stream_headers, "HEADERS_SECONDS_MAX", 0.01)

    class Stuck:
        def send_initial_metadata(self, _: Any) -> Any:
            return asyncio.Event().wait()

    sending = asyncio.create_task(send_headers(Stuck()))  # type: ignore[arg-type]
    await asyncio.sleep(0)
    sending.cancel()
    async with asyncio.timeout(LIMIT_S):
        with pytest.raises(asyncio.CancelledError):
            await sending


class Owner:
    """Keeps its task, whose frame refers to it."""

    def __init__(self, work: Callable[[], object]) -> None:
        self.task = asyncio.create_task(self._run(work))

    async def _run(self, work: Callable[[], object]) -> None:
        await asyncio.sleep(0)
        work()
        await asyncio.Event().wait()


def fail() -> None:
    try:
        raise KeyError("first")
    except KeyError as error:
        kept = ValueError("then")
        raise kept from error


@pytest.mark.parametrize("work", [fail, lambda: None])
async def test_the_owner_of_an_ended_task_is_freed_without_the_garbage_collector(work: Callable[[], object]) -> None:
    gc.collect()
    gc.disable()
    try:
        owner = Owner(work)
        for _ in range(3):
            await asyncio.sleep(0)
        owner.task.cancel()  # without effect if it has failed
        await asyncio.wait([owner.task])
        failure = failure_of(owner.task)
        assert (failure is None) == (work is not fail)
        if failure is not None:
            drop_frames(failure)
            assert isinstance(failure.__cause__, KeyError)
        ended = weakref.ref(owner)
        del owner, failure
        assert ended() is None
    finally:
        gc.enable()
