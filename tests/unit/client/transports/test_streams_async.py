"""Streams of responses on asyncio: an ended stream, and a task that is cancelled in the same turn of the event loop."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from typing import Any

import pytest

from stampede_rt.transports.streams_async import ServerStream


class SilentCall:
    """A call without responses. Like a call of grpc.aio, it raises CancelledError after `cancel`."""

    def __init__(self) -> None:
        self._ended = asyncio.get_running_loop().create_future()

    async def __aiter__(self) -> AsyncIterator[Any]:
        await self._ended
        raise asyncio.CancelledError
        yield

    def cancel(self) -> None:
        if not self._ended.done():
            self._ended.set_result(None)


async def _read(stream: ServerStream[Any]) -> str:
    async for _ in stream:
        pass
    return "the stream has ended"


async def _reading() -> tuple[ServerStream[Any], asyncio.Task[str]]:
    stream = ServerStream[Any](SilentCall(), "localhost:1")
    task = asyncio.create_task(_read(stream))
    await asyncio.sleep(0)
    return stream, task


async def test_a_cancelled_stream_ends_the_iteration() -> None:
    stream, task = await _reading()
    stream.cancel()
    assert await task == "the stream has ended"


@pytest.mark.parametrize("is_first", [True, False])
async def test_the_end_of_a_stream_hides_no_cancellation_of_the_task_that_reads_it(is_first: bool) -> None:
    stream, task = await _reading()
    steps: list[Callable[[], Any]] = [stream.cancel, task.cancel]
    for step in steps if is_first else reversed(steps):
        step()
    await asyncio.wait({task})
    assert task.cancelled()
