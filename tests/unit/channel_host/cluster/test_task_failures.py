"""The failure of a group of tasks."""

from __future__ import annotations

import asyncio

import pytest

from stampede_rt.errors import Unavailable
from stampede_rt_channel_host.cluster.task_failures import first_failure


async def work(broken: asyncio.Event) -> None:
    """Wait until another task of the same group fails. That task fails when `broken` is set."""

    async def fail() -> None:
        await broken.wait()
        raise Unavailable("the stream is broken")

    try:
        async with asyncio.TaskGroup() as group:
            group.create_task(fail())
            await asyncio.Event().wait()
    except BaseExceptionGroup as failures:
        raise first_failure(failures) from failures


async def test_the_first_failure_of_a_group_is_its_error() -> None:
    broken = asyncio.Event()
    broken.set()
    with pytest.raises(Unavailable, match="the stream is broken"):
        await work(broken)


async def test_a_task_that_is_cancelled_in_the_turn_in_which_its_group_fails_is_cancelled() -> None:
    broken = asyncio.Event()
    task = asyncio.create_task(work(broken))
    for _ in range(3):
        await asyncio.sleep(0)
    broken.set()
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
