"""The requests of an owner to the replica of a queue: one for each step, and signs of life in times of silence."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import nullcontext
from itertools import pairwise
from types import SimpleNamespace
from typing import Any
from unittest.mock import AsyncMock

import pytest

from stampede_rt.errors import InvalidArgument, Unavailable
from stampede_rt.v1 import migration_service_pb2 as pb
from stampede_rt_channel_host.channels.piece_scheduler import PieceScheduler
from stampede_rt_channel_host.copies.queues import queue_feed
from stampede_rt_channel_host.copies.queues.queue_feed import QueueFeedStream
from stampede_rt_channel_host.copies.queues.queue_puts import read_answer
from stampede_rt_channel_host.copies.queues.queue_steps import STEPS_PER_REQUEST
from stampede_rt_runtime.sockets.dialing import HostStream

LIMIT_S = 20
TO_REPLICA = b"o" * 16, b"h" * 16, "localhost:1", PieceScheduler()


class Rig:
    """A queue whose steps the test adds, and the requests that its replica gets."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, request_seconds: float) -> None:
        monkeypatch.setattr(queue_feed, "step_parts", lambda step, now: [pb.FedQueuePart()])
        monkeypatch.setattr(queue_feed, "REQUEST_SECONDS", request_seconds)
        self._steps: list[Any] = []
        self._requests: asyncio.Queue[pb.FeedQueueRequest] = asyncio.Queue()
        journal = SimpleNamespace(next_step=1, steps_from=lambda first, most: self._steps[first - 1 :])
        hosted: Any = SimpleNamespace(record=SimpleNamespace(message=b""))
        self._journal = journal
        replication: Any = SimpleNamespace(journal=journal)
        self._feed = QueueFeedStream(hosted, replication, lambda: 0, *TO_REPLICA)
        self._sending = asyncio.ensure_future(self._feed._send_steps(self))

    async def write(self, request: pb.FeedQueueRequest) -> None:
        self._requests.put_nowait(request)

    def add_step(self) -> None:
        self._steps.append(SimpleNamespace(number=len(self._steps) + 1))
        self._journal.next_step += 1
        self._feed.wake()

    async def parts(self) -> int:
        """The number of parts of the next request."""
        return len((await asyncio.wait_for(self._requests.get(), LIMIT_S)).parts)

    @property
    def unread_requests(self) -> int:
        return self._requests.qsize()

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


async def test_the_host_serves_other_callers_between_two_requests(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = Rig(monkeypatch, LIMIT_S)
    for _ in range(5 * STEPS_PER_REQUEST):
        rig.add_step()
    requests = [0]
    while requests[-1] < 5:
        await asyncio.sleep(0)
        requests.append(rig.unread_requests)
    assert max(later - earlier for earlier, later in pairwise(requests)) == 1
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
    replication: Any = SimpleNamespace(journal=journal, since_epoch=4, start=10, diverged_host_ids=set())
    hosted: Any = SimpleNamespace(queue=SimpleNamespace(incarnation=5))
    feed = QueueFeedStream(hosted, replication, lambda: 0, b"owner", b"replica", "replica:1", PieceScheduler())
    place = pb.FeedQueueResponse(next_step=next_step, incarnation=incarnation, owner_epoch=owner_epoch)
    assert feed._continues(place) is continues


@pytest.mark.parametrize(("has_changes", "takes_changes", "continues"), [(1, 1, 1), (1, 0, 0), (0, 0, 1)])
async def test_a_replica_of_an_earlier_release_begins_anew_if_it_does_not_understand_the_steps(
    has_changes: bool, takes_changes: bool, continues: bool
) -> None:
    steps = [SimpleNamespace(has_changes=False), SimpleNamespace(has_changes=has_changes)]
    journal = SimpleNamespace(next_step=12, steps_from=lambda first, most: steps, takes_changes=True)
    reports: list[int] = []
    replication: Any = SimpleNamespace(
        journal=journal, since_epoch=4, start=10, report=lambda host, feed, step: reports.append(step),
        begin_anew=AsyncMock(return_value=False), diverged_host_ids=set(),
    )  # fmt: skip
    hosted: Any = SimpleNamespace(queue=SimpleNamespace(incarnation=5))
    feed = QueueFeedStream(hosted, replication, lambda: 0, b"owner", b"replica", "replica:1", PieceScheduler())
    place = pb.FeedQueueResponse(next_step=10, incarnation=5, owner_epoch=4, takes_changes=takes_changes)
    with nullcontext() if continues else pytest.raises(Unavailable, match="begins anew"):
        await feed._begin(None, place)
    assert reports == ([10] if continues else [])
    assert journal.takes_changes == takes_changes


class DamagedReplica:
    """A replica that answers the first requests, and then with damaged bytes."""

    def __init__(self, whole_answers: int) -> None:
        self._whole_answers = whole_answers

    def stream_stream(self, method: str, **named: Any) -> Any:
        return lambda: self

    async def write(self, request: pb.FeedQueueRequest) -> None:
        pass

    async def read(self) -> object:
        self._whole_answers -= 1
        return read_answer(b"" if self._whole_answers >= 0 else b"\xff")

    def cancel(self) -> None:
        pass


@pytest.mark.parametrize("whole_answers", [0, 1])
async def test_damaged_bytes_end_the_feed_with_an_error_after_which_the_keeper_tries_again(whole_answers: int) -> None:
    journal = SimpleNamespace(next_step=1, takes_changes=True)
    replication: Any = SimpleNamespace(
        journal=journal, diverged_host_ids=set(), add=lambda *_: None, discard=lambda *_: None,
        begin_anew=lambda host_id: asyncio.get_running_loop().create_future(),
    )  # fmt: skip
    hosted: Any = SimpleNamespace(record=SimpleNamespace(message=b""))
    feed = QueueFeedStream(hosted, replication, lambda: 0, *TO_REPLICA)
    channel: Any = DamagedReplica(whole_answers)
    with pytest.raises(InvalidArgument, match="localhost:1 sent bytes that are no FeedQueueResponse"):
        await feed.run(channel)


class SameTurnStream(HostStream):
    """A stream over a socket to the replica. It keeps the requests. The test gives the answers."""

    def __init__(self) -> None:
        self.sent: list[pb.FeedQueueRequest] = []
        self.take: Callable[[Any], bool] | None = None
        self._first: asyncio.Queue[pb.FeedQueueResponse] = asyncio.Queue()

    @property
    def write_now(self) -> Callable[[Any], None]:
        return self.sent.append

    def answer_in_same_turn(self, take: Callable[[Any], bool]) -> None:
        self.take = take

    async def read(self) -> object:
        return await self._first.get()

    async def write(self, request: Any) -> None:
        self.sent.append(request)

    async def begin(self, next_step: int) -> None:
        """Let the feed read the first answer, and wait for a change."""
        self._first.put_nowait(pb.FeedQueueResponse(next_step=next_step))
        for _ in range(10):
            await asyncio.sleep(0)


class SameTurnRig:
    """A feed over a socket, whose journal has small steps."""

    def __init__(self) -> None:
        self.steps = 0
        self.reports: list[int] = []
        journal = SimpleNamespace(next_step=1, steps_from=self._steps_from)
        replication: Any = SimpleNamespace(journal=journal, report=lambda host, feed, step: self.reports.append(step))
        hosted: Any = SimpleNamespace(record=SimpleNamespace(message=b""))
        self.feed = QueueFeedStream(hosted, replication, lambda: 0, *TO_REPLICA)
        self.call = SameTurnStream()
        self.tasks = [
            asyncio.ensure_future(one) for one in (self.feed._send_steps(self.call), self.feed._read(self.call))
        ]

    def _steps_from(self, first: int, most: int) -> list[Any]:
        return [SimpleNamespace(number=number, size_bytes=1) for number in range(first, self.steps + 1)]

    def add_step(self) -> int:
        """Add a step. Returns the number of requests that go out in this turn of the event loop."""
        self.steps += 1
        before = len(self.call.sent)
        self.feed.wake()
        return len(self.call.sent) - before

    async def end(self) -> None:
        for task in self.tasks:
            task.cancel()
        await asyncio.wait(self.tasks)


@pytest.fixture
def small_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(queue_feed, "step_parts", lambda step, now: [pb.FedQueuePart(next_step=step.number + 1)])


@pytest.mark.usefixtures("small_steps")
async def test_a_step_goes_out_in_the_turn_in_which_the_queue_makes_it() -> None:
    rig = SameTurnRig()
    await rig.call.begin(1)
    assert rig.add_step() == 1
    assert rig.add_step() == 0, "the replica has not reported the last step"
    for _ in range(5):
        await asyncio.sleep(0)
    assert rig.feed.next_step == 3, "the task of the feed has sent it"
    assert rig.call.take is not None
    assert rig.call.take(pb.FeedQueueResponse(next_step=3))
    assert rig.reports[-1] == 3
    assert rig.add_step() == 1
    await rig.end()


@pytest.mark.usefixtures("small_steps")
async def test_an_error_while_a_step_is_sent_ends_the_feed_and_not_the_call(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = SameTurnRig()
    await rig.call.begin(1)

    def fail(*_: object, **__: object) -> Any:
        raise RuntimeError("no request")

    monkeypatch.setattr(QueueFeedStream, "_request", fail)
    assert rig.add_step() == 0
    with pytest.raises(RuntimeError, match="no request"):
        await asyncio.wait_for(rig.tasks[0], LIMIT_S)
    await rig.end()


@pytest.mark.usefixtures("small_steps")
async def test_the_feed_of_a_silent_replica_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(queue_feed, "ANSWER_SECONDS_MAX", 0.05)
    monkeypatch.setattr(queue_feed, "REQUEST_SECONDS", 0.01)
    rig = SameTurnRig()
    with pytest.raises(TimeoutError):
        await asyncio.wait_for(rig.tasks[0], LIMIT_S)
    await rig.end()
