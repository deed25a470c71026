"""The requests of an owner to the replica of a queue: one for each step, and signs of life in times of silence."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any

import pytest

from stampede_rt.v1 import migration_service_pb2 as pb
from stampede_rt_channel_host.copies import queue_feed
from stampede_rt_channel_host.copies.queue_feed import QueueFeedStream

LIMIT_S = 20


class Rig:
    """A queue whose steps the test adds, and the requests that its replica gets."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, request_seconds: float) -> None:
        monkeypatch.setattr(queue_feed, "step_parts", lambda step, now: [pb.FedQueuePart()])
        monkeypatch.setattr(queue_feed, "REQUEST_SECONDS", request_seconds)
        self._steps: list[Any] = []
        self._requests: asyncio.Queue[pb.FeedQueueRequest] = asyncio.Queue()
        journal = SimpleNamespace(next_step=1, steps_from=lambda first, most: self._steps[first - 1 :])
        hosted: Any = SimpleNamespace(record=SimpleNamespace(message=b""))
        replication: Any = SimpleNamespace(journal=journal)
        self._feed = QueueFeedStream(hosted, replication, lambda: 0, b"o" * 16, b"h" * 16, "localhost:1")
        self._sending = asyncio.ensure_future(self._feed._send_steps(self))

    async def write(self, request: pb.FeedQueueRequest) -> None:
        self._requests.put_nowait(request)

    def add_step(self) -> None:
        self._steps.append(SimpleNamespace(number=len(self._steps) + 1))
        self._feed.wake()

    async def parts(self) -> int:
        """The number of parts of the next request."""
        return len((await asyncio.wait_for(self._requests.get(), LIMIT_S)).parts)

    async def end(self) -> None:
        self._sending.cancel()
        await asyncio.wait([self._sending])


async def test_each_step_is_one_request(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = Rig(monkeypatch, LIMIT_S)
    assert await rig.parts() == 0, "the first request says that the owner is there"
    for _ in range(3):
        rig.add_step()
        assert await rig.parts() == 1
    await rig.end()


async def test_while_nothing_changes_there_are_signs_of_life(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = Rig(monkeypatch, 0.01)
    assert [await rig.parts() for _ in range(3)] == [0, 0, 0]
    await rig.end()
