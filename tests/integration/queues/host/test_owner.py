"""The host that serves a queue, over gRPC with the generated stubs."""

from __future__ import annotations

import asyncio

import grpc
import pytest

from stampede_rt.errors import Unavailable
from stampede_rt.v1 import error_pb2
from stampede_rt.v1 import queue_service_pb2 as pb
from tests.support.channel_host.queue_rig import (
    OpenedQueue,
    QueueRig,
    S,
    TakeCall,
    ack,
    host_of,
    queue_directory,
    run_of,
    running_queue_host,
)


async def test_a_wrong_epoch_is_refused_everywhere(rig: QueueRig) -> None:
    queue = rig.open()
    await queue.put(b"a")
    (acked,) = await queue.enqueue(run_of(b"x"), epoch=7)
    assert acked.error.reason == error_pb2.ERROR_REASON_WRONG_EPOCH
    taker = queue.take(credit=1, epoch=7)
    await taker.send()
    assert await taker.ended() == grpc.StatusCode.FAILED_PRECONDITION
    with pytest.raises(grpc.aio.AioRpcError) as caught:
        await queue.settle(ack(1), epoch=7)
    assert caught.value.code() == grpc.StatusCode.FAILED_PRECONDITION


async def test_a_queue_of_another_host_has_moved_and_an_unknown_queue_is_not_found(rig: QueueRig) -> None:
    queue = rig.open()
    queue.record.host_id = b"another-host-id!"
    (acked,) = await queue.enqueue(run_of(b"x"))
    assert acked.error.reason == error_pb2.ERROR_REASON_MOVED
    assert acked.error.metadata["host_id"] == b"another-host-id!".hex()
    queue.queue_id = b"no-such-queue-id"
    (acked,) = await queue.enqueue(run_of(b"x"))
    assert acked.error.reason == error_pb2.ERROR_REASON_QUEUE_NOT_FOUND


async def test_a_changed_policy_applies_when_the_directory_reports_it(rig: QueueRig) -> None:
    queue = rig.open(max_items=1)
    await queue.put(b"a")
    await rig.directory.called("Watch", times=1)
    waiting = asyncio.create_task(queue.put(b"b"))
    await queue.until(lambda status: status.waiting_enqueues == 1)
    queue.record.spec.max_items, queue.record.spec_version = 2, 2
    rig.directory.report(queue.record)
    assert (await waiting).first_seq == 2


async def test_takers_of_a_deleted_queue_get_an_error_and_its_messages_are_deleted(rig: QueueRig) -> None:
    queue = rig.open()
    taker = await queue.take(credit=1).open()
    await rig.directory.called("Watch", times=1)
    await rig.directory.called("ResolveQueue", times=2)  # the change may have come before the watch began
    del rig.directory.queues[queue.queue_id]
    rig.directory.report(queue.record)
    assert await taker.ended() == grpc.StatusCode.NOT_FOUND
    assert rig.host.queues.all() == []


async def test_the_host_asks_for_the_changes_that_a_broken_watch_missed(rig: QueueRig) -> None:
    queue = rig.open()
    taker = await queue.take(credit=1).open()
    await rig.directory.called("Watch", times=1)
    queue.record.host_id, queue.record.epoch = b"another-host-id!", 2
    rig.directory.break_watches()
    assert await taker.ended() == grpc.StatusCode.FAILED_PRECONDITION


async def test_a_host_that_may_not_serve_ends_its_streams_and_keeps_the_messages() -> None:
    async with queue_directory(lease_ttl_nanos=2 * S) as directory, host_of(directory) as rig:
        queue = rig.open()
        await queue.put(b"a")
        taker = await queue.take(credit=2).open()
        (delivery,) = await taker.deliveries(1)
        directory.refuse["RenewHostLease"] = Unavailable("no majority")
        assert await taker.ended() == grpc.StatusCode.FAILED_PRECONDITION
        (acked,) = await queue.enqueue(run_of(b"x"))
        assert acked.error.reason == error_pb2.ERROR_REASON_NOT_HERE
        directory.lease_ttl_nanos = 600 * S  # so long that even a busy machine keeps the next lease
        directory.refuse.clear()
        next_taker = await _taken_again(queue)
        (result,) = await next_taker.settled(ack(delivery))
        assert not result.HasField("error")


async def test_an_ack_of_a_former_incarnation_settles_no_delivery_of_the_next(rig: QueueRig) -> None:
    queue = rig.open()
    await queue.put(b"before")
    (former,) = await (await queue.take(taker_id=5, credit=1).open()).deliveries(1)
    queue.record.epoch, queue.record.incarnation = 2, queue.record.incarnation + 1
    await queue.put(b"after")
    next_taker = await queue.take(taker_id=5, credit=1).open()
    (delivery,) = await next_taker.deliveries(1)
    assert delivery.payload == b"after"
    (result,) = await queue.settle(ack(former), taker_id=5)
    assert result.error.reason == error_pb2.ERROR_REASON_LEASE_EXPIRED
    assert (await queue.status()).counters.held == 1


async def test_another_incarnation_begins_with_an_empty_queue(rig: QueueRig) -> None:
    queue = rig.open()
    await queue.put(b"lost")
    taker = await queue.take(credit=1).open()
    queue.record.epoch, queue.record.incarnation = 2, queue.record.incarnation + 1
    status = await queue.rig.stub.GetQueueStatus(pb.GetQueueStatusRequest(queue_id=queue.queue_id, epoch=2))
    assert status.status.counters.accepted == 0
    assert await taker.ended() == grpc.StatusCode.FAILED_PRECONDITION


async def test_a_stopping_host_ends_the_streams_of_takers_and_producers_with_a_reason() -> None:
    async with running_queue_host() as rig:
        queue = rig.open(max_items=1)
        taker = await queue.take().open()
        await queue.put(b"a")
        waiting = asyncio.create_task(queue.put(b"b"))
        await queue.until(lambda status: status.waiting_enqueues == 1)
        leaving = asyncio.create_task(rig.host.leave())
        assert await taker.ended() == grpc.StatusCode.UNAVAILABLE
        with pytest.raises(grpc.aio.AioRpcError) as caught:
            await waiting
        assert caught.value.code() == grpc.StatusCode.UNAVAILABLE
        await leaving


async def _taken_again(queue: OpenedQueue) -> TakeCall:
    """A stream, opened as soon as the host may serve again."""
    async with asyncio.timeout(20):
        while True:
            try:
                return await queue.take().open()
            except (AssertionError, grpc.aio.AioRpcError):
                continue
