"""The client's tools for asyncio: the result of a call that another thread performs."""

from __future__ import annotations

import asyncio
from concurrent.futures import Future

import pytest

from stampede_rt.transports.concurrency_async import result_of


async def _waiting(future: Future[int]) -> asyncio.Task[int]:
    task = asyncio.create_task(result_of(future, 60))
    await asyncio.sleep(0)
    return task


async def test_a_result_hides_no_cancellation_of_its_caller_in_the_same_turn() -> None:
    future = Future[int]()
    task = await _waiting(future)
    future.set_result(1)  # the next turn of the loop notes the result, and then cancels the caller
    asyncio.get_running_loop().call_soon(task.cancel)
    await asyncio.wait({task})
    assert task.cancelled()


async def test_a_cancelled_caller_cancels_the_call() -> None:
    future = Future[int]()
    task = await _waiting(future)
    task.cancel()
    await asyncio.wait({task})
    assert future.cancelled()


async def test_a_call_without_a_result_is_cancelled_after_the_timeout() -> None:
    future = Future[int]()
    with pytest.raises(TimeoutError):
        await result_of(future, 0)
    assert future.cancelled()
