"""The watch of the directory, and the parts of the host that follow it."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from contextlib import suppress
from typing import Any

from stampede_rt.errors import Unavailable
from stampede_rt.v1 import directory_pb2, directory_service_pb2, queue_pb2
from stampede_rt_channel_host.cluster.directory_watch import CHANGES_PER_TURN, watch_forever
from stampede_rt_channel_host.core.records import RecordedChange


class Follower:
    """`changes`: the changes so far. `at_turns`: their numbers at each turn of the event loop."""

    def __init__(self) -> None:
        self.in_use = asyncio.Event()
        self.in_use.set()
        self.changes: list[RecordedChange] = []
        self.at_turns: list[int] = []

    async def missed(self) -> None: ...

    def changed_in_directory(self, change: RecordedChange) -> None:
        self.changes.append(change)

    async def note_turns(self) -> None:
        while True:
            self.at_turns.append(len(self.changes))
            await asyncio.sleep(0)


async def test_other_work_runs_between_many_changes_of_one_response() -> None:
    follower, is_over = Follower(), asyncio.Event()
    change = directory_pb2.DirectoryChange(queue=queue_pb2.QueueRecord(queue_id=b"q" * 16))

    async def stream(method: str, request: Any) -> AsyncGenerator[directory_service_pb2.WatchResponse, None]:
        yield directory_service_pb2.WatchResponse()
        yield directory_service_pb2.WatchResponse(changes=[change] * (3 * CHANGES_PER_TURN))
        is_over.set()
        raise Unavailable("the supernode stops")

    supernodes: Any = Follower()
    supernodes.stream = stream
    tasks = [
        asyncio.create_task(follower.note_turns()),
        asyncio.create_task(watch_forever(supernodes, directory_service_pb2.WatchRequest(), follower)),
    ]
    await is_over.wait()
    for task in tasks:
        task.cancel()
        with suppress(asyncio.CancelledError):
            await task
    assert len(follower.changes) == 3 * CHANGES_PER_TURN
    assert {CHANGES_PER_TURN, 2 * CHANGES_PER_TURN} <= {*follower.at_turns}
