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


async def test_an_owner_sends_signs_of_life_while_nothing_changes(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = Rig(monkeypatch, 0.01)
    assert [await rig.parts() for _ in range(3)] == [0, 0, 0]
    await rig.end()


@pytest.mark.parametrize(
    ("next_step", "incarnation", "owner_epoch", "continues"),
    [(11, 5, 4, True), (10, 5, 3, True), (11, 5, 3, False), (9, 5, 2, False), (10, 6, 3, False), (7, 5, 4, False)],
    ids=[
        "steps of this owner", "steps that this owner has inherited", "a step of the former owner that is lost",
        "two owners ago", "another incarnation", "steps that the journal has dropped",
    ],
)  # fmt: skip
def test_a_copy_continues_only_if_its_owner_has_all_steps_of_the_copy(
    next_step: int, incarnation: int, owner_epoch: int, continues: bool
) -> None:
    """This owner began at step 10 in epoch 4, and has the steps from 8 on."""
    journal = SimpleNamespace(next_step=12, steps_from=lambda first, most: [] if 8 <= first <= 12 else None)
    replication: Any = SimpleNamespace(journal=journal, since_epoch=4, start=10)
    hosted: Any = SimpleNamespace(queue=SimpleNamespace(incarnation=5))
    feed = QueueFeedStream(hosted, replication, lambda: 0, b"owner", b"replica", "replica:1")
    place = pb.FeedQueueResponse(next_step=next_step, incarnation=incarnation, owner_epoch=owner_epoch)
    assert feed._continues(place) is continues
