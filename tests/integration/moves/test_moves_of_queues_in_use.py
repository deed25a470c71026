"""A queue moves while callers use it: the source holds the queue only when the other host has a copy."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncIterator, Callable
from typing import Any
from unittest.mock import AsyncMock

import grpc
import pytest

from stampede_rt.errors import QueueNotFound, StaleBinding, StampedeError, Unavailable
from stampede_rt.v1 import migration_service_pb2 as pb
from stampede_rt.v1.migration_service_pb2_grpc import MigrationServiceStub
from stampede_rt_channel_host.copies.queues import queue_arrivals
from stampede_rt_channel_host.copies.queues.queue_arrivals import QueueArrivals
from stampede_rt_channel_host.copies.queues.queue_handover import QueueHandovers
from stampede_rt_channel_host.copies.queues.queue_messages import PART_BYTES, ArrivingQueue
from stampede_rt_channel_host.core.queue import QueueCore
from stampede_rt_channel_host.queues import refusals
from stampede_rt_channel_host.queues.hosted_queue import HostedQueue
from tests.support.channel_host.queue_rig import OTHER_ID, OpenedQueue, QueueRig, ack, two_queue_hosts
from tests.support.waiting import pause

MESSAGES = 250


class MoveInUse:
    """A move whose destination waits before it restores the queue, until `go_on`. Meanwhile the source serves."""

    def __init__(self, source: QueueRig, other: QueueRig, queue: OpenedQueue) -> None:
        self.source, self.other, self.queue = source, other, queue
        self.has_parts, self.may_restore = asyncio.Event(), threading.Event()
        self.task: asyncio.Task[pb.MoveHereResponse] | None = None
        self.restored: list[QueueCore] = []

    async def begin(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """Begin the move, and wait until the destination has the copy of one moment."""
        loop, restored = asyncio.get_running_loop(), QueueArrivals._restored

        def wait(*arguments: Any) -> Any:
            loop.call_soon_threadsafe(self.has_parts.set)
            assert self.may_restore.wait(30)
            self.restored.append(restored(*arguments))
            return self.restored[-1]

        monkeypatch.setattr(QueueArrivals, "_restored", wait)
        await self.allow()
        stub = MigrationServiceStub(self.other.connection)
        self.task = asyncio.ensure_future(stub.MoveHere(pb.MoveHereRequest(queue_id=self.queue.queue_id)))
        await self.has_parts.wait()

    async def allow(self) -> None:
        allowed = pb.AllowMoveRequest(queue_id=self.queue.queue_id, to_host_id=OTHER_ID)
        await MigrationServiceStub(self.source.connection).AllowMove(allowed)

    async def end(self) -> pb.MoveHereResponse:
        """Let the destination restore the queue, and wait for the end of the move."""
        self.may_restore.set()
        assert self.task is not None
        return await self.task

    async def opened(self, *, takes_steps: bool) -> Any:
        """A call to the source, as the destination makes it."""
        call = MigrationServiceStub(self.source.connection).HandOverQueue()
        opening = pb.HandOverQueueOpen(queue_id=self.queue.queue_id, epoch=1, host_id=OTHER_ID, takes_steps=takes_steps)
        await call.write(pb.HandOverQueueRequest(open=opening))
        return call

    def at(self, rig: QueueRig) -> OpenedQueue:
        """The queue, for calls to a host."""
        return OpenedQueue(rig, self.source.directory.queues[self.queue.queue_id])


@pytest.fixture
async def move() -> AsyncIterator[MoveInUse]:
    async with two_queue_hosts() as (source, other, queue):
        made = MoveInUse(source, other, queue)
        try:
            yield made
        finally:
            made.may_restore.set()


async def test_the_source_serves_a_queue_whose_copy_is_on_its_way_and_loses_no_change(
    move: MoveInUse, monkeypatch: pytest.MonkeyPatch
) -> None:
    taker = move.queue.take(taker_id=5, credit=MESSAGES)
    await move.queue.put(*[b"m"] * MESSAGES, number=1000)
    leased = await taker.deliveries(MESSAGES)
    await move.begin(monkeypatch)
    await taker.settled(ack(leased[0]), ack(leased[-1]))
    await taker.send(credit=2)
    await taker.deliveries(2)
    await move.queue.put(b"new", number=9000)
    before = (await move.queue.status()).counters
    moved = await move.end()
    assert moved.held == MESSAGES + 3 + 1 - 2  # three are from the fixture, one is new, two have been acknowledged
    after = (await move.at(move.other).status()).counters
    assert after == before
    (result,) = await move.at(move.other).settle(ack(leased[1]), taker_id=5)
    assert not result.HasField("error"), "the lease has moved"
    (repeated,) = await move.at(move.other).settle(ack(leased[0]), taker_id=5)
    assert not repeated.HasField("error"), "the new owner knows an acknowledgement that came after the snapshot"


async def test_callers_that_come_during_the_copy_may_go_on_with_the_same_stream_until_the_hold(
    move: MoveInUse, monkeypatch: pytest.MonkeyPatch
) -> None:
    taker = await move.queue.take(taker_id=5).open()
    await move.begin(monkeypatch)
    await taker.send(credit=1)
    await taker.deliveries(1)
    await move.end()
    assert await taker.ended() is grpc.StatusCode.FAILED_PRECONDITION


async def test_a_second_move_during_the_copy_is_refused_and_the_first_one_goes_on(
    move: MoveInUse, monkeypatch: pytest.MonkeyPatch
) -> None:
    await move.begin(monkeypatch)
    for takes_steps in (True, False):
        second = await move.opened(takes_steps=takes_steps)
        with pytest.raises(grpc.aio.AioRpcError, match="is moving to another host"):
            await second.read()
    assert (await move.end()).held == 3


def _delete(move: MoveInUse) -> None:
    queues = move.source.host.queues
    queues.forget(move.queue.queue_id, QueueNotFound("deleted"))
    del move.source.directory.queues[move.queue.queue_id]


def _fence(move: MoveInUse) -> None:
    move.source.host.queues._lease_held = lambda: False  # type: ignore[method-assign]


def _begin_replicas(move: MoveInUse) -> None:
    """Another journal notes the changes from now on."""
    hosted = move.source.host.queues.known(move.queue.queue_id)
    assert hosted is not None
    hosted.queue.journal()


@pytest.mark.parametrize("happens", [_delete, _fence, _begin_replicas])
async def test_a_queue_that_is_lost_or_changes_its_journal_during_the_copy_does_not_move(
    move: MoveInUse, monkeypatch: pytest.MonkeyPatch, happens: Callable[[MoveInUse], None]
) -> None:
    hosted = move.source.host.queues.known(move.queue.queue_id)
    assert hosted is not None
    await move.begin(monkeypatch)
    happens(move)
    with pytest.raises(grpc.aio.AioRpcError):
        await move.end()
    while hosted.copying is not None:
        await pause()
    assert hosted.moving is None, "the source has not held the queue"
    assert move.other.host.queues.known(move.queue.queue_id) is None
    await _emptied(move.restored[0])


async def _emptied(core: QueueCore) -> None:
    """Wait until the destination has freed a queue that has not moved. `QueueCore.emptying` does this in pieces."""
    while core.latest_counters().held:
        await pause()


async def test_a_destination_frees_the_queue_whose_commit_is_refused(
    move: MoveInUse, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In an earlier version, the queue stayed in memory until the next collection of all objects, for ten minutes."""
    monkeypatch.setattr(queue_arrivals, "until_known", AsyncMock(side_effect=StaleBinding("refused")))
    await move.begin(monkeypatch)
    with pytest.raises(grpc.aio.AioRpcError, match="refused"):
        await move.end()
    await _emptied(move.restored[0])
    assert (await move.at(move.source).status()).counters.held == 3


async def test_a_destination_without_memory_frees_the_parts_that_have_come(
    move: MoveInUse, monkeypatch: pytest.MonkeyPatch
) -> None:
    for number in range(8):
        await move.queue.put(bytes(PART_BYTES // 2), number=10 + number)
    made, init = list[ArrivingQueue](), ArrivingQueue.__init__

    def arriving(self: ArrivingQueue) -> None:
        made.append(self)
        init(self)

    monkeypatch.setattr(ArrivingQueue, "__init__", arriving)
    memory = move.other.host.queues.memory
    memory.bytes_max = memory.used_bytes + 3 * PART_BYTES
    await move.allow()
    with pytest.raises(grpc.aio.AioRpcError) as refused:
        await MigrationServiceStub(move.other.connection).MoveHere(pb.MoveHereRequest(queue_id=move.queue.queue_id))
    assert refused.value.code() is grpc.StatusCode.RESOURCE_EXHAUSTED
    assert made[0].size_bytes > 2 * PART_BYTES
    while made[0]._parts:
        await pause()
    assert memory.used_bytes == 0
    assert (await move.at(move.source).status()).counters.held == 3 + 8


async def test_the_source_holds_the_queue_after_it_has_sent_all_long_steps_that_were_made_during_the_copy(
    move: MoveInUse, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In an earlier version, callers waited until the source had sent the steps of one long message each."""
    hold, left = HostedQueue.hold, list[int]()

    async def held(self: HostedQueue, error: StampedeError) -> None:
        assert self.copying is not None
        left.append(len(self.copying.steps))
        await hold(self, error)

    monkeypatch.setattr(HostedQueue, "hold", held)
    await move.begin(monkeypatch)
    for number in range(8):
        await move.queue.put(bytes(PART_BYTES), number=10 + number)
    assert (await move.end()).held == 3 + 8
    assert left == [0]


async def test_the_destination_waits_longer_for_the_first_part_which_comes_after_the_whole_queue_is_copied(
    move: MoveInUse, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A busy host copies a queue with very many messages for more than 10 s."""
    part, waits = QueueArrivals._part, list[tuple[float, ...]]()

    async def noted(self: Any, call: Any, *seconds: float) -> pb.HandOverQueueResponse:
        waits.append(seconds)
        return await part(self, call, *seconds)

    monkeypatch.setattr(QueueArrivals, "_part", noted)
    await move.begin(monkeypatch)
    await move.end()
    assert waits[0] == (queue_arrivals.COPY_SECONDS_MAX,)
    assert {*waits[1:]} == {()}


async def test_a_queue_makes_no_steps_after_the_destination_of_its_copy_has_gone_and_can_move_later(
    move: MoveInUse,
) -> None:
    await move.allow()
    call = await move.opened(takes_steps=True)
    while not (await call.read()).ends:
        pass
    hosted = move.source.host.queues.known(move.queue.queue_id)
    assert hosted is not None
    assert hosted.copying is not None
    call.cancel()
    while hosted.copying is not None:
        await pause()
    await move.queue.put(b"new", number=500)
    assert hosted.queue._queue_items.changes is None
    stub = MigrationServiceStub(move.other.connection)
    assert (await stub.MoveHere(pb.MoveHereRequest(queue_id=move.queue.queue_id))).held == 4


async def test_a_source_of_an_earlier_release_holds_the_queue_and_sends_it_whole(
    move: MoveInUse, monkeypatch: pytest.MonkeyPatch
) -> None:
    copy_and_hold = QueueHandovers._copy_and_hold

    async def without_steps(self: Any, hosted: Any, copying: Any, opening: Any, context: Any) -> None:
        await copy_and_hold(self, hosted, copying, pb.HandOverQueueOpen(host_id=opening.host_id), context)

    monkeypatch.setattr(QueueHandovers, "_copy_and_hold", without_steps)
    taker = move.queue.take(taker_id=5, credit=1)
    (leased,) = await taker.deliveries(1)
    move.may_restore.set()
    await move.begin(monkeypatch)
    assert (await move.end()).held == 3
    (result,) = await move.at(move.other).settle(ack(leased), taker_id=5)
    assert not result.HasField("error")


async def test_a_copy_that_lacks_steps_is_not_handed_over(move: MoveInUse) -> None:
    hosted = await move.source.host.queues.use(move.queue.queue_id, 1)
    copying = hosted.begin_copying()
    with pytest.raises(StaleBinding):
        hosted.begin_copying()
    scheduler = move.source.host.queues.scheduler
    await scheduler.do(hosted.copied(copying))
    copying.steps._bytes_max = 1
    await move.queue.put(b"new", number=500)
    with pytest.raises(Unavailable, match="changes faster"):
        hosted.check_copying(copying)
    scheduler.begin(hosted.end_copying())
    error: StampedeError = refusals.deleted(hosted.record)
    second = hosted.begin_copying()
    move.source.host.queues.forget(move.queue.queue_id, error)
    with pytest.raises(StaleBinding):
        hosted.check_copying(second)
