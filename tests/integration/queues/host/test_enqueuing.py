"""Producers at a channel host, over gRPC with the generated stubs: accepted messages, and waiting ones."""

from __future__ import annotations

import asyncio

import grpc
import pytest

from stampede_rt.v1 import error_pb2, item_pb2
from stampede_rt.v1 import queue_service_pb2 as pb
from tests.support.channel_host.queue_rig import (
    MS,
    QueueRig,
    ack,
    run_of,
    running_queue_host,
)


async def test_an_enqueue_on_a_full_queue_waits_until_a_taker_made_room(rig: QueueRig) -> None:
    queue = rig.open(max_items=1)
    await queue.put(b"a")
    waiting = asyncio.create_task(queue.put(b"b"))
    await queue.until(lambda status: status.waiting_enqueues == 1)
    taker = await queue.take(credit=2).open()
    (delivery,) = await taker.deliveries(1)
    await taker.settled(ack(delivery))
    assert (await waiting).first_seq == 2
    assert (await taker.deliveries(1))[0].payload == b"b"


@pytest.mark.parametrize("wait_nanos", [0, 20 * MS])
async def test_an_enqueue_fails_with_queue_full_at_its_timeout(rig: QueueRig, wait_nanos: int) -> None:
    queue = rig.open(max_items=1)
    await queue.put(b"a")
    refused = await queue.put(b"b", wait_nanos=wait_nanos)
    assert not refused.HasField("first_seq")
    assert [one.error.reason for one in refused.rejections] == [error_pb2.ERROR_REASON_QUEUE_FULL]
    status = await queue.status()
    assert (status.counters.rejected_full, status.waiting_enqueues) == (1, 0)


async def test_a_cancelled_enqueue_is_not_counted_as_waiting(rig: QueueRig) -> None:
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
    (repeated,) = await queue.enqueue(run_of(b"a", b"b", number=1), producer_id=9)
    assert (repeated.first_seq, repeated.stamped_unix_nano) == (first.first_seq, first.stamped_unix_nano)
    assert (await queue.status()).counters.accepted == 2


async def test_a_malformed_or_too_large_run_is_refused_and_counted_and_the_stream_continues(rig: QueueRig) -> None:
    queue = rig.open(max_item_bytes=4)
    broken = pb.EnqueueRun(first_number=1, run=item_pb2.ItemRun(payload_length_bytes=[3], payloads=b"four"))
    bad, large, good = await queue.enqueue(broken, run_of(b"12345"), run_of(b"1234"))
    assert bad.error.reason == error_pb2.ERROR_REASON_MALFORMED_RUN
    assert large.rejections[0].error.reason == error_pb2.ERROR_REASON_ITEM_TOO_LARGE
    assert good.first_seq == 1
    counters = (await queue.status()).counters
    assert (counters.rejected_malformed, counters.rejected_too_large, counters.accepted) == (1, 1, 1)


async def test_a_request_with_many_runs_for_a_queue_elsewhere_asks_the_directory_once(rig: QueueRig) -> None:
    queue = rig.open()
    queue.record.host_id = b"another-host-id!"
    acks = await queue.enqueue(*[run_of(b"x", number=number) for number in range(1, 51)])
    assert {one.error.reason for one in acks} == {error_pb2.ERROR_REASON_MOVED}
    assert rig.directory.calls["ResolveQueue"] == 1


async def test_an_enqueue_that_names_no_queue_or_does_not_count_ends_its_stream(rig: QueueRig) -> None:
    queue = rig.open()
    nameless = rig.stub.Enqueue(iter((pb.EnqueueRequest(runs=[run_of(b"x")]),)))
    uncounted = rig.stub.Enqueue(iter((queue.enqueue_request(run_of(b"x", number=0), producer_id=5),)))
    for call in (nameless, uncounted):
        assert await call.code() == grpc.StatusCode.INVALID_ARGUMENT
    assert (await queue.status()).counters.accepted == 0


async def test_a_message_id_names_one_message_and_has_a_bound(rig: QueueRig) -> None:
    queue = rig.open()
    assert (await queue.put(b"a", b"b", message_id="x")).error.reason == error_pb2.ERROR_REASON_MALFORMED_RUN
    assert (await queue.put(b"a", message_id="x" * 129)).error.reason == error_pb2.ERROR_REASON_MALFORMED_RUN
    first, repeated = await queue.put(b"a", message_id="x" * 128), await queue.put(b"a", message_id="x" * 128)
    assert (repeated.first_seq, repeated.duplicate, first.duplicate) == (first.first_seq, True, False)


async def test_a_producer_cannot_put_an_origin_into_a_run(rig: QueueRig) -> None:
    run = run_of(b"a")
    run.run.origin.seq = 7
    (acked,) = await rig.open().enqueue(run)
    assert acked.error.reason == error_pb2.ERROR_REASON_MALFORMED_RUN


async def test_the_hosts_memory_bounds_all_queues_together() -> None:
    async with running_queue_host(memory_bytes_max=2**20) as rig:
        first, second = rig.open("a"), rig.open("b")
        await first.put(bytes(2**20 - 4096))
        with pytest.raises(grpc.aio.AioRpcError) as caught:
            await second.put(bytes(8192))
        assert caught.value.code() == grpc.StatusCode.RESOURCE_EXHAUSTED
        assert (await second.status()).counters.accepted == 0
