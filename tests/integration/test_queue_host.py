"""Queues at a channel host, over gRPC with the generated stubs."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator

import grpc
import pytest

from stampede_rt.v1 import error_pb2, item_pb2
from stampede_rt.v1 import queue_service_pb2 as pb
from tests.unit.channel_host.manual_clock import ManualClock
from tests.unit.queues.rig import MS, QueueRig, S, ack, extend, nack, run_of, running_queue_host


@pytest.fixture
async def rig() -> AsyncIterator[QueueRig]:
    async with running_queue_host() as rig:
        yield rig


async def test_what_is_put_is_taken_in_order_and_used_up_by_acknowledging(rig: QueueRig) -> None:
    queue = rig.open()
    acked = await queue.put(b"one", b"two", b"three", content_type="text/plain")
    assert (acked.first_seq, acked.items, acked.incarnation) == (1, 3, queue.record.incarnation)
    taker = await queue.take(credit=10).open()
    assert taker.incarnation == queue.record.incarnation
    items = await taker.items(3)
    assert [(one.payload, one.seq, one.delivery) for one in items] == [(b"one", 1, 1), (b"two", 2, 1), (b"three", 3, 1)]
    assert items[0].run.run.content_type == "text/plain"
    assert items[0].run.run.time_unix_nano[0] == acked.stamped_unix_nano
    assert 0 < items[0].run.lease_nanos <= 30 * S
    results = await taker.settled(*map(ack, items))
    assert [(one.delivery_id, one.HasField("error")) for one in results] == [(it.delivery_id, False) for it in items]
    counters = (await queue.status()).counters
    assert (counters.accepted, counters.consumed, counters.held, counters.leased) == (3, 3, 0, 0)


async def test_a_taker_that_waits_is_given_what_comes(rig: QueueRig) -> None:
    queue = rig.open()
    taker = await queue.take(credit=1).open()
    await queue.until(lambda status: status.waiting_takers == 1)
    await queue.put(b"x")
    (item,) = await taker.items(1)
    assert item.payload == b"x"


async def test_a_given_back_item_comes_again_at_its_place_and_is_counted(rig: QueueRig) -> None:
    queue = rig.open()
    await queue.put(b"a", b"b", b"c")
    taker = await queue.take(credit=1).open()
    (first,) = await taker.items(1)
    await taker.settled(nack(first))
    await taker.send(credit=2)
    again, second = await taker.items(2)
    assert [(again.payload, again.delivery), (second.payload, second.delivery)] == [(b"a", 2), (b"b", 1)]
    assert again.delivery_id != first.delivery_id


async def test_a_killed_takers_items_come_again_when_its_lease_ends() -> None:
    clock = ManualClock()
    async with running_queue_host(clock=clock) as rig:
        queue = rig.open(lease_nanos=10 * S)
        await queue.put(b"a", b"b")
        killed = await queue.take(taker_id=1, credit=2).open()
        await killed.items(2)
        killed.call.cancel()
        other = await queue.take(taker_id=2, credit=2).open()
        await queue.until(lambda status: status.waiting_takers == 1)
        assert (await queue.status()).counters.leased == 2
        clock.advance(10 * S)
        items = await other.items(2)
        assert [(one.payload, one.delivery) for one in items] == [(b"a", 2), (b"b", 2)]
        assert (await queue.status()).counters.leases_expired == 2


async def test_a_taker_that_comes_back_settles_by_id_and_a_repeated_ack_succeeds(rig: QueueRig) -> None:
    queue = rig.open()
    await queue.put(b"a", b"b")
    taker = await queue.take(taker_id=7, credit=2).open()
    one, two = await taker.items(2)
    taker.call.cancel()
    assert not (await queue.settle(ack(one), taker_id=7))[0].HasField("error")
    assert not (await queue.settle(ack(one), taker_id=7))[0].HasField("error")
    (others,) = await queue.settle(ack(one), taker_id=8)
    assert others.error.reason == error_pb2.ERROR_REASON_LEASE_EXPIRED
    again = await queue.take(taker_id=7).open()
    (extended,) = await again.settled(extend(two, 60 * S))
    assert extended.lease_nanos == 60 * S
    (stale,) = await again.settled(ack(12345))
    assert stale.error.reason == error_pb2.ERROR_REASON_LEASE_EXPIRED


async def test_an_enqueue_on_a_full_queue_waits_until_a_taker_made_room(rig: QueueRig) -> None:
    queue = rig.open(max_items=1)
    await queue.put(b"a")
    waiting = asyncio.create_task(queue.put(b"b"))
    await queue.until(lambda status: status.waiting_enqueues == 1)
    taker = await queue.take(credit=2).open()
    (item,) = await taker.items(1)
    await taker.settled(ack(item))
    assert (await waiting).first_seq == 2
    assert (await taker.items(1))[0].payload == b"b"


@pytest.mark.parametrize("wait_nanos", [0, 20 * MS])
async def test_a_wait_for_room_that_is_over_ends_in_channel_full(rig: QueueRig, wait_nanos: int) -> None:
    queue = rig.open(max_items=1)
    await queue.put(b"a")
    refused = await queue.put(b"b", wait_nanos=wait_nanos)
    assert not refused.HasField("first_seq")
    assert [one.error.reason for one in refused.rejections] == [error_pb2.ERROR_REASON_CHANNEL_FULL]
    status = await queue.status()
    assert (status.counters.rejected_full, status.waiting_enqueues) == (1, 0)


async def test_a_cancelled_enqueue_leaves_nothing_behind(rig: QueueRig) -> None:
    queue = rig.open(max_items=1)
    await queue.put(b"a")
    call = rig.stub.Enqueue(iter((queue.enqueue_request(run_of(b"b"), producer_id=5),)))
    await queue.until(lambda status: status.waiting_enqueues == 1)
    call.cancel()
    await queue.until(lambda status: status.waiting_enqueues == 0)
    assert (await queue.status()).counters.accepted == 1


async def test_a_retried_enqueue_is_recognised_after_a_broken_stream(rig: QueueRig) -> None:
    queue = rig.open()
    call = rig.stub.Enqueue()
    await call.write(queue.enqueue_request(run_of(b"a", b"b", number=1), producer_id=9))
    first = (await call.read()).acks[0]
    call.cancel()
    (again,) = await queue.enqueue(run_of(b"a", b"b", number=1), producer_id=9)
    assert (again.first_seq, again.stamped_unix_nano) == (first.first_seq, first.stamped_unix_nano)
    assert (await queue.status()).counters.accepted == 2


async def test_a_malformed_run_and_one_too_large_are_refused_and_counted_and_the_stream_goes_on(rig: QueueRig) -> None:
    queue = rig.open(max_item_bytes=4)
    broken = pb.EnqueueRun(first_number=1, run=item_pb2.ItemRun(payload_length_bytes=[3], payloads=b"four"))
    bad, large, good = await queue.enqueue(broken, run_of(b"12345"), run_of(b"1234"))
    assert bad.error.reason == error_pb2.ERROR_REASON_MALFORMED_RUN
    assert large.rejections[0].error.reason == error_pb2.ERROR_REASON_ITEM_TOO_LARGE
    assert good.first_seq == 1
    counters = (await queue.status()).counters
    assert (counters.rejected_malformed, counters.rejected_too_large, counters.accepted) == (1, 1, 1)


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


async def test_a_queue_of_another_host_has_moved_and_one_of_nobody_is_not_found(rig: QueueRig) -> None:
    queue = rig.open()
    queue.record.host_id = b"another-host-id!"
    (acked,) = await queue.enqueue(run_of(b"x"))
    assert acked.error.reason == error_pb2.ERROR_REASON_MOVED
    assert acked.error.metadata["host_id"] == b"another-host-id!".hex()
    queue.queue_id = b"no-such-queue-id"
    (acked,) = await queue.enqueue(run_of(b"x"))
    assert acked.error.reason == error_pb2.ERROR_REASON_QUEUE_NOT_FOUND


async def test_drain_voids_the_credit_and_is_answered(rig: QueueRig) -> None:
    queue = rig.open()
    taker = await queue.take(credit=5).open()
    await taker.send(drain=True)
    while not taker.drained:
        await taker.read()
    await queue.put(b"x")
    status = await queue.status()
    assert (status.waiting_takers, status.counters.delivered) == (0, 0)


async def test_a_stream_whose_caller_has_closed_its_side_ends_when_its_credit_is_used_up(rig: QueueRig) -> None:
    queue = rig.open()
    taker = await queue.take(credit=1).open()
    await taker.call.done_writing()
    await queue.put(b"x")
    assert (await taker.items(1))[0].payload == b"x"
    assert await taker.ended() == grpc.StatusCode.OK
