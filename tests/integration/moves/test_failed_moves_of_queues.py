"""Moves of queues that fail at one step: one host serves the queue afterwards, with all its messages."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from typing import Any, NamedTuple

import grpc
import pytest

from stampede_rt.v1 import migration_service_pb2 as pb
from stampede_rt.v1 import migration_service_pb2_grpc
from stampede_rt_channel_host.copies.queues import queue_arrivals, queue_handover
from stampede_rt_channel_host.queues import queue_content
from tests.support.channel_host.queue_rig import OTHER_ID, OpenedQueue, QueueRig, ack, two_queue_hosts


class Pair(NamedTuple):
    """Two hosts of one directory. The queue is at `source`."""

    source: QueueRig
    other: QueueRig
    queue: OpenedQueue

    def begin_move(self) -> Any:
        """Begin the move of the queue to the other host. Returns a task."""
        return asyncio.ensure_future(self._move())

    async def allow(self) -> None:
        """Tell the source that the other host may ask for the queue."""
        source = migration_service_pb2_grpc.MigrationServiceStub(self.source.connection)
        await source.AllowMove(pb.AllowMoveRequest(queue_id=self.queue.queue_id, to_host_id=OTHER_ID))

    async def _move(self) -> pb.MoveHereResponse:
        queue_id = self.queue.queue_id
        await self.allow()
        stub = migration_service_pb2_grpc.MigrationServiceStub(self.other.connection)
        answer: pb.MoveHereResponse = await stub.MoveHere(pb.MoveHereRequest(queue_id=queue_id))
        return answer

    def at_source(self) -> OpenedQueue:
        """The queue, for calls to the host that had it first."""
        return OpenedQueue(self.source, self.source.directory.queues[self.queue.queue_id])

    def at_other(self) -> OpenedQueue:
        """The queue, for calls to the other host."""
        return OpenedQueue(self.other, self.source.directory.queues[self.queue.queue_id])


@pytest.fixture
async def pair() -> AsyncIterator[Pair]:
    async with two_queue_hosts() as (source, other, queue):
        yield Pair(source, other, queue)


async def payloads(queue: OpenedQueue) -> list[bytes]:
    """All messages that a new taker gets."""
    taker = queue.take(taker_id=9, credit=10)
    held = (await queue.status()).counters.held
    found = [one.payload for one in await taker.deliveries(held)]
    taker.call.cancel()
    return found


async def test_a_taker_whose_stream_ends_settles_at_the_new_host(pair: Pair) -> None:
    taker = pair.queue.take(taker_id=5, credit=1)
    (first,) = await taker.deliveries(1)
    await pair.begin_move()
    assert await taker.ended() is grpc.StatusCode.FAILED_PRECONDITION
    (result,) = await pair.at_other().settle(ack(first), taker_id=5)
    assert not result.HasField("error")
    assert await payloads(pair.at_other()) == [b"b", b"c"]
    assert pair.source.host.queues.known(pair.queue.queue_id) is None


async def test_a_move_that_is_cut_before_the_commit_leaves_the_queue_where_it_was(
    pair: Pair, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: Any) -> Any:
        raise queue_arrivals.Unavailable("the other host has a defect")

    monkeypatch.setattr(queue_arrivals.QueueArrivals, "_take_over", fail)
    with pytest.raises(grpc.aio.AioRpcError, match="has a defect"):
        await pair.begin_move()
    status = await pair.queue.status()  # waits for the end of the move
    assert (status.counters.held, pair.at_source().record.epoch) == (3, 2)
    assert await payloads(pair.at_source()) == [
        b"a",
        b"b",
        b"c",
    ]


async def test_a_move_that_fails_while_the_queue_is_copied_changes_nothing(
    pair: Pair, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The source holds the queue only when the other host has a copy of it."""

    def fail(*_: Any) -> Any:
        raise queue_arrivals.Unavailable("the other host has a defect")

    monkeypatch.setattr(queue_arrivals.QueueArrivals, "_restored", fail)
    taker = await pair.queue.take(taker_id=5).open()
    with pytest.raises(grpc.aio.AioRpcError, match="has a defect"):
        await pair.begin_move()
    await taker.send(credit=1)
    assert [one.payload for one in await taker.deliveries(1)] == [b"a"]
    assert pair.at_source().record.epoch == 1
    taker.call.cancel()


async def test_a_host_without_an_answer_to_its_commit_asks_the_directory(
    pair: Pair, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The host may not take the queue back, because the other host serves the queue."""
    served = queue_handover.QueueHandovers._hand_over

    async def lose_answer(*arguments: Any) -> bool:
        await served(*arguments)
        return False

    monkeypatch.setattr(queue_handover.QueueHandovers, "_hand_over", lose_answer)
    await pair.begin_move()
    assert await payloads(pair.at_other()) == [b"a", b"b", b"c"]
    with pytest.raises(grpc.aio.AioRpcError, match="is at host"):
        await pair.queue.status()


async def test_calls_wait_for_the_move_and_are_refused_after_a_while(
    pair: Pair, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(queue_content, "HELD_SECONDS_MAX", 0.05)
    reached, may_continue = asyncio.Event(), asyncio.Event()
    taken_over = queue_arrivals.QueueArrivals._take_over

    async def wait(self: Any, record: Any, core: Any, permit: bytes) -> Any:
        reached.set()
        await may_continue.wait()
        return await taken_over(self, record, core, permit)

    monkeypatch.setattr(queue_arrivals.QueueArrivals, "_take_over", wait)
    move = pair.begin_move()
    await reached.wait()
    with pytest.raises(grpc.aio.AioRpcError, match="takes too long"):
        await pair.queue.status()
    may_continue.set()
    await move
    assert await payloads(pair.at_other()) == [b"a", b"b", b"c"]


async def test_a_second_handover_of_a_moving_queue_gets_no_message(pair: Pair) -> None:
    stub = migration_service_pb2_grpc.MigrationServiceStub(pair.source.connection)
    await pair.allow()
    first, second = stub.HandOverQueue(), stub.HandOverQueue()
    opening = pb.HandOverQueueOpen(queue_id=pair.queue.queue_id, epoch=1, host_id=OTHER_ID)
    await first.write(pb.HandOverQueueRequest(open=opening))
    assert (await first.read()).facts.next_seq == 4
    await second.write(pb.HandOverQueueRequest(open=opening))
    first.cancel()
    with pytest.raises(grpc.aio.AioRpcError, match="epoch 2"):  # the second call waited until the first move had failed
        await second.read()
    assert (await pair.queue.status()).counters.held == 3


async def test_a_host_that_no_move_names_gets_no_message_and_no_pause(pair: Pair) -> None:
    stub = migration_service_pb2_grpc.MigrationServiceStub(pair.source.connection)
    call = stub.HandOverQueue()
    opening = pb.HandOverQueueOpen(queue_id=pair.queue.queue_id, epoch=1, host_id=OTHER_ID)
    await call.write(pb.HandOverQueueRequest(open=opening))
    with pytest.raises(grpc.aio.AioRpcError, match="no caller has asked this host"):
        await call.read()
    assert pair.at_source().record.epoch == 1
    assert await payloads(pair.at_source()) == [b"a", b"b", b"c"]
