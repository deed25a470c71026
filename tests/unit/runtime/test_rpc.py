"""The status of failed calls, the streams of disconnected callers, and coroutines that begin immediately."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from typing import Any

import grpc
import pytest

from stampede_rt.errors import ChannelNotFound
from stampede_rt_runtime.rpc import Context, StartedCoroutine, errors_as_status


class Aborted(Exception):
    pass


class Call:
    """The context of a call: it remembers the status that the call ended with."""

    status: tuple[grpc.StatusCode, str] | None = None

    async def abort(self, code: grpc.StatusCode, details: str, trailing_metadata: Any) -> None:
        self.status = code, details
        raise Aborted


class Servicer:
    closed = False

    @errors_as_status
    async def answer(self, request: Exception | str, context: Context) -> str:
        return _response_to(request)

    @errors_as_status
    async def stream(self, request: Exception | str, context: Context) -> AsyncIterator[str]:
        try:
            yield "first"
            yield _response_to(request)
        finally:
            self.closed = True


def _response_to(request: Exception | str) -> str:
    if isinstance(request, Exception):
        raise request
    return request


async def all_of(servicer: Servicer, request: Exception | str, call: Any) -> list[str]:
    return [one async for one in servicer.stream(request, call)]


async def test_responses_and_streams_pass_unchanged() -> None:
    call: Any = Call()
    assert await Servicer().answer("hello", call) == "hello"
    assert await all_of(Servicer(), "hello", call) == ["first", "hello"]
    assert call.status is None


@pytest.mark.parametrize("method", [Servicer.answer, all_of])
async def test_an_error_of_the_product_ends_the_call_with_its_status(method: Any) -> None:
    call: Any = Call()
    with pytest.raises(Aborted):
        await method(Servicer(), ChannelNotFound("there is no channel cam"), call)
    assert call.status == (grpc.StatusCode.NOT_FOUND, "there is no channel cam")


@pytest.mark.parametrize("method", [Servicer.answer, all_of])
async def test_an_unexpected_error_passes_unchanged(method: Any) -> None:
    call: Any = Call()
    with pytest.raises(KeyError):
        await method(Servicer(), KeyError("a defect"), call)
    assert call.status is None


async def test_the_stream_of_a_disconnected_caller_is_closed_immediately() -> None:
    servicer, call = Servicer(), Call()
    stream: Any = servicer.stream("hello", call)  # type: ignore[arg-type]
    assert await anext(stream) == "first"
    await stream.aclose()
    assert servicer.closed


async def test_a_started_coroutine_runs_to_its_first_wait_and_the_rest_runs_when_it_is_awaited() -> None:
    steps: list[str] = []
    gate = asyncio.get_running_loop().create_future()

    async def work() -> None:
        steps.append("first")
        await gate
        steps.append("second")
        await asyncio.sleep(0)
        steps.append("third")

    begun = StartedCoroutine(work())
    assert (steps, begun.is_done) == (["first"], False)
    gate.set_result(None)
    await begun
    assert (steps, begun.is_done) == (["first", "second", "third"], True)
    await begun


async def test_a_coroutine_that_need_not_wait_is_done() -> None:
    assert StartedCoroutine(_nothing()).is_done


async def _nothing() -> None:
    pass


async def _fail(gate: asyncio.Future[None] | None) -> None:
    if gate is not None:
        await gate
    raise ValueError


@pytest.mark.parametrize("is_late", [False, True])
async def test_an_error_comes_when_the_rest_is_awaited(is_late: bool) -> None:
    gate = asyncio.get_running_loop().create_future() if is_late else None
    begun = StartedCoroutine(_fail(gate))
    assert not begun.is_done  # also with the error, which an await raises
    if gate is not None:
        gate.set_result(None)
    with pytest.raises(ValueError):
        await begun


async def test_a_cancellation_reaches_the_coroutine() -> None:
    ended: list[str] = []
    gate = asyncio.get_running_loop().create_future()

    async def work() -> None:
        try:
            await gate
        except asyncio.CancelledError:
            ended.append("cancelled")
            raise

    async def rest(begun: StartedCoroutine) -> None:
        await begun

    task = asyncio.create_task(rest(StartedCoroutine(work())))
    await asyncio.sleep(0)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    assert ended == ["cancelled"]
