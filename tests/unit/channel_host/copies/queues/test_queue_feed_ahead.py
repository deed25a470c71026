"""The feed of a queue's replica sends a put before the owner stores the message. The replica answers immediately."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, nullcontext
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from stampede_rt.errors import InvalidArgument, Unavailable
from stampede_rt.v1 import migration_service_pb2 as pb
from stampede_rt.v1 import queue_pb2
from stampede_rt.values.queueing import QueuePolicy
from stampede_rt_channel_host.channels.limits.memory import MemoryBudget
from stampede_rt_channel_host.channels.piece_scheduler import PieceScheduler
from stampede_rt_channel_host.copies.queues.queue_feed import QueueFeedStream
from stampede_rt_channel_host.copies.queues.queue_feed_servicer import QueueFeeds, _Feed
from stampede_rt_channel_host.copies.queues.queue_messages import PART_BYTES
from stampede_rt_channel_host.copies.queues.queue_puts import encode_request, read_answer
from stampede_rt_channel_host.core.deadlines import Deadlines
from stampede_rt_channel_host.core.queue import AheadPut, Enqueue, QueueCore, QueueLimits
from stampede_rt_channel_host.core.queue.queue_items import QueueItems
from stampede_rt_channel_host.core.records import RecordedQueue
from stampede_rt_channel_host.core.replication import KnownReplica
from stampede_rt_channel_host.queues.hosted_queue import HostedQueue
from stampede_rt_channel_host.queues.queue_copies import QueueCopies
from tests.unit.channel_host.copies.queues.test_queue_feed import SameTurnStream

REPLICA, OWNER = b"r" * 16, b"o" * 16
LIMIT_S = 20
RECORD = RecordedQueue(
    queue_id=b"q" * 16, name="jobs", host_id=OWNER, epoch=4, incarnation=5, spec_version=1,
    policy=QueuePolicy(replicas=1, ack="replica"), message=b"",
)  # fmt: skip


class Replica:
    """The host of the replica. `events`: its answers and its steps."""

    def __init__(self, next_step: int) -> None:
        memory = MemoryBudget(2**30)
        self.copies = QueueCopies(memory, lambda: 0, lambda: True, PieceScheduler())
        self.copies.begin(RECORD, QueueCore(QueueLimits(), incarnation=5), next_step)
        queues: Any = SimpleNamespace(
            copies=self.copies,
            memory=memory,
            known=lambda queue_id: None,
            check_may_serve=lambda: None,
            in_use=asyncio.Event(),
        )
        self.feed = _Feed(queues, RECORD)
        nobody: Any = None
        self.feeds = QueueFeeds(nobody, queues, nobody, nobody)
        self.feeds._latest[RECORD.queue_id] = self.feed
        self.answers: list[tuple[Any, int]] = []

    @property
    def seqs(self) -> int:
        """The number of messages."""
        return self.core.latest_counters().held

    @property
    def core(self) -> QueueCore:
        copy = self.copies.of(RECORD.queue_id)
        assert copy is not None
        return copy.core

    def take(self, request: Any) -> bool:
        return self.feeds._take_in_same_turn(self.feed, encode_request(request), self._write)

    def _write(self, raw: bytes) -> None:
        self.answers.append((read_answer(raw), self.seqs))


class Both:
    """The owner of a queue, the feed of its replica, and the replica. The test carries the messages."""

    def __init__(self, *, takes_puts: bool = True) -> None:
        self.hosted = HostedQueue(RECORD, MemoryBudget(2**30), lambda: 0, lambda hosted: None, Deadlines())
        assert self.hosted.replication is not None
        self.replication = self.hosted.replication
        self.replication.know([KnownReplica(REPLICA, 1, True)])
        self.call = SameTurnStream()
        about = lambda: 0, OWNER, REPLICA, "replica:1", PieceScheduler()
        self.feed = QueueFeedStream(self.hosted, self.replication, *about)
        self.replica = Replica(self.feed.next_step)
        self._takes_puts = takes_puts
        self.tasks: list[asyncio.Task[None]] = []
        self.number = 1

    async def begin(self) -> None:
        place = self.replica.feed.place()
        place.takes_puts &= self._takes_puts
        self.replication.add(REPLICA, self.feed)
        await self.feed._begin(self.call, place)
        sides = self.feed._send_steps(self.call), self.feed._read(self.call)
        self.tasks = [asyncio.ensure_future(side) for side in sides]
        await self.call.begin(place.next_step)

    def put(self, length: int = 3, producer_id: int = 7) -> Any:
        """Put a message. Returns the request that goes out in this turn of the event loop; None if there is none."""
        before = len(self.call.sent)
        run = Enqueue((length,), lambda *_: bytes(length + 20), producer_id=producer_id, first_number=self.number)
        self.number += 1
        with pytest.raises(StopIteration):
            self.hosted.enqueue(run, nullcontext).send(None)
        new: list[Any] = self.call.sent[before:]
        assert len(new) < 2
        return new[0] if new else None

    def answer(self) -> None:
        """Carry the last answer to the owner."""
        assert self.call.take is not None
        assert self.call.take(self.replica.answers[-1][0])

    @property
    def waiting(self) -> int:
        """The number of steps that the replica has not reported."""
        return self.replication.journal.next_step - self.replication.replicated_next


@asynccontextmanager
async def fed(**options: Any) -> AsyncIterator[Both]:
    both = Both(**options)
    await both.begin()
    try:
        yield both
    finally:
        for task in both.tasks:
            task.cancel()
        await asyncio.gather(*both.tasks, return_exceptions=True)


async def test_a_replica_answers_a_put_before_it_repeats_the_step() -> None:
    async with fed() as both:
        for count in (1, 2, 3):
            put = both.put()
            assert isinstance(put, AheadPut)
            assert (put.number, put.seq, both.waiting) == (both.feed.next_step - 1, count, 1)
            assert both.replica.take(put)
            assert both.replica.answers[-1] == (put.number + 1, count - 1)
            assert both.replica.seqs == count
            both.answer()
            assert both.waiting == 0
        assert both.replica.core.latest_counters() == both.hosted.queue.latest_counters()
        assert both.replication.journal.size_bytes == 0, "no replica needs a step"


async def test_a_put_without_an_answer_lets_the_next_one_wait() -> None:
    async with fed() as both:
        assert isinstance(both.put(), AheadPut)
        assert both.put() is None
        for _ in range(5):
            await asyncio.sleep(0)
        assert isinstance(both.call.sent[-1], pb.FeedQueueRequest), "the task of the feed has sent the step"
        for request in both.call.sent[-2:]:
            assert both.replica.take(request)
        both.answer()
        assert (both.waiting, both.replica.seqs) == (0, 2)
        assert isinstance(both.put(), AheadPut)


@pytest.mark.parametrize("reason", ["an earlier release", "a long message", "a new record", "no producer"])
async def test_other_puts_go_to_the_replica_as_steps(reason: str) -> None:
    async with fed(takes_puts=reason != "an earlier release") as both:
        if reason == "a new record":
            message = queue_pb2.QueueRecord(queue_id=RECORD.queue_id).SerializeToString()
            both.hosted.update(replace(RECORD, message=message))
        request = both.put(
            PART_BYTES if reason == "a long message" else 3, producer_id=0 if reason == "no producer" else 7
        )
        assert isinstance(request, pb.FeedQueueRequest)
        assert request.HasField("queue") == (reason == "a new record")
        assert len(request.parts) >= 1


async def test_a_replica_that_got_a_message_which_the_owner_could_not_store_begins_anew(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async with fed() as both:

        def fail(*_: object) -> None:
            raise RuntimeError("a defect")

        run = Enqueue((3,), lambda *_: b"run", producer_id=7, first_number=1)
        with monkeypatch.context() as patch:
            patch.setattr(QueueItems, "set_body", fail)
            with pytest.raises(RuntimeError, match="a defect"):
                both.hosted.enqueue(run, nullcontext).send(None)
        put = both.call.sent[-1]
        assert isinstance(put, AheadPut)
        assert both.replica.take(put)
        before = both.replication.replicated_next
        both.answer()
        assert both.replication.replicated_next == before, "no report of the replica counts any more"
        assert not both.replication.is_fed(REPLICA)
        with pytest.raises(Unavailable, match="begin anew"):
            await asyncio.wait_for(both.tasks[0], LIMIT_S)
        feed = QueueFeedStream(both.hosted, both.replication, lambda: 0, OWNER, REPLICA, "replica:1", PieceScheduler())
        assert not feed._continues(both.replica.feed.place())
        both.replication.add(REPLICA, feed)
        both.replication.report(REPLICA, feed, feed.next_step)
        assert both.replication.diverged_host_ids == set()


async def test_an_error_while_a_put_is_sent_ends_the_feed_and_not_the_call(monkeypatch: pytest.MonkeyPatch) -> None:
    async with fed() as both:

        def fail(self: object) -> Any:
            raise RuntimeError("no socket")

        monkeypatch.setattr(SameTurnStream, "write_now", property(fail))
        assert both.put() is None
        with pytest.raises(RuntimeError, match="no socket"):
            await asyncio.wait_for(both.tasks[0], LIMIT_S)
        assert both.replication.diverged_host_ids == set()


async def test_a_put_that_comes_in_the_task_of_the_feed_has_the_same_effect() -> None:
    """Over gRPC, a host takes no message in the turn of the event loop in which it comes."""
    async with fed() as both:
        request = pb.FeedQueueRequest.FromString(encode_request(both.put()))
        await both.replica.feed.take(request, lambda: True)
        assert both.replica.feed.place().next_step == both.feed.next_step
        assert both.replica.core.latest_counters() == both.hosted.queue.latest_counters()
        await both.replica.feed.take(request, lambda: True)
        assert both.replica.seqs == 1, "the copy has repeated this step before"


async def test_a_replica_takes_no_put_after_a_missing_step() -> None:
    async with fed() as both:
        put: AheadPut = both.put()
        later = put._replace(number=put.number + 1)
        assert not both.replica.take(later)
        with pytest.raises(InvalidArgument, match="is missing"):
            await both.replica.feed.take(pb.FeedQueueRequest.FromString(encode_request(later)), lambda: True)
        both.replica.copies.drop(RECORD.queue_id)
        assert not both.replica.take(put)
        await both.replica.feed.take(pb.FeedQueueRequest.FromString(encode_request(put)), lambda: True)
        assert both.replica.feed.place().next_step == 0
        assert both.replica.answers == []
