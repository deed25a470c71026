"""Queues at a channel host, over gRPC with the generated stubs."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator

import grpc
import pytest

from stampede_rt.errors import Unavailable
from stampede_rt.v1 import error_pb2, item_pb2, queue_pb2
from stampede_rt.v1 import queue_service_pb2 as pb
from stampede_rt_channel_host.queues import take_stream
from tests.unit.channel_host.manual_clock import ManualClock
from tests.unit.queues.rig import (
    MS,
    Delivered,
    OpenedQueue,
    QueueRig,
    S,
    TakeCall,
    ack,
    delivered_in,
    extend,
    host_of,
    nack,
    queue_directory,
    run_of,
    running_queue_host,
    term,
)


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
async def test_a_wait_for_room_that_is_over_ends_in_queue_full(rig: QueueRig, wait_nanos: int) -> None:
    queue = rig.open(max_items=1)
    await queue.put(b"a")
    refused = await queue.put(b"b", wait_nanos=wait_nanos)
    assert not refused.HasField("first_seq")
    assert [one.error.reason for one in refused.rejections] == [error_pb2.ERROR_REASON_QUEUE_FULL]
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


async def test_too_much_credit_and_a_second_open_end_the_stream(rig: QueueRig) -> None:
    queue = rig.open()
    greedy = await queue.take(credit=1000).open()
    await greedy.send(credit=25)
    assert await greedy.ended() == grpc.StatusCode.INVALID_ARGUMENT
    twice = await queue.take(credit=1).open()
    await twice.send(open=pb.TakeOpen(queue_id=queue.queue_id, epoch=1, taker_id=1))
    assert await twice.ended() == grpc.StatusCode.INVALID_ARGUMENT
    assert (await queue.status()).waiting_takers == 0


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


async def test_an_item_delivered_too_often_moves_to_the_dead_letter_queue_of_another_host() -> None:
    async with (
        queue_directory() as directory,
        host_of(directory) as rig,
        host_of(directory, host_id=b"the-other-host-1", name="h2") as other,
    ):
        graveyard = other.open("dead")
        queue = rig.open(max_deliveries=2, dead_letter_queue_id=graveyard.queue_id, content_type="image/jpeg")
        await queue.put(b"poison", b"good", attributes={"k": "v"})
        taker = await queue.take(credit=1).open()
        for _ in range(2):
            (item,) = await taker.items(1)
            await taker.settled(nack(item))
            await taker.send(credit=1)
        assert (await taker.items(1))[0].payload == b"good"
        await queue.until(lambda status: status.counters.dead_lettered == 1)
        (dead,) = await (await graveyard.take(credit=1).open()).items(1)
        assert (dead.payload, dead.run.run.content_type, dead.delivery) == (b"poison", "image/jpeg", 1)
        assert dict(dead.run.run.attributes) == {"k": "v"}
        counters = (await queue.status()).counters
        assert (counters.held, counters.expelled, counters.accepted) == (1, 0, 2)


async def test_an_item_stays_until_the_dead_letter_queue_takes_it() -> None:
    async with queue_directory() as directory, host_of(directory) as rig:
        graveyard = rig.open("dead", max_items=1, on_full=queue_pb2.QUEUE_ON_FULL_REJECT)
        queue = rig.open(max_deliveries=1, dead_letter_queue_id=graveyard.queue_id)
        await graveyard.put(b"in the way")
        await queue.put(b"poison")
        taker = await queue.take(credit=1).open()
        await taker.settled(nack((await taker.items(1))[0]))
        await graveyard.until(lambda status: status.counters.rejected_full > 0)
        assert (await queue.status()).counters.held == 1
        clearing = await graveyard.take(credit=2).open()
        await clearing.settled(ack((await clearing.items(1))[0]))
        assert (await clearing.items(1))[0].payload == b"poison"
        await queue.until(lambda status: status.counters.dead_lettered == 1)


async def test_an_item_delivered_too_often_is_expelled_where_no_dead_letter_queue_is_named(rig: QueueRig) -> None:
    queue = rig.open(max_deliveries=1)
    await queue.put(b"poison")
    taker = await queue.take(credit=1).open()
    await taker.settled(nack((await taker.items(1))[0]))
    assert (await queue.status()).counters.expelled == 1


async def test_a_changed_set_up_holds_as_soon_as_the_directory_tells_of_it(rig: QueueRig) -> None:
    queue = rig.open(max_items=1)
    await queue.put(b"a")
    await rig.directory.called("Watch", times=1)
    waiting = asyncio.create_task(queue.put(b"b"))
    await queue.until(lambda status: status.waiting_enqueues == 1)
    queue.record.spec.max_items, queue.record.spec_version = 2, 2
    rig.directory.tell(queue.record)
    assert (await waiting).first_seq == 2


async def test_takers_of_a_deleted_queue_are_told_and_its_items_are_gone(rig: QueueRig) -> None:
    queue = rig.open()
    taker = await queue.take(credit=1).open()
    await rig.directory.called("Watch", times=1)
    await rig.directory.called("ResolveQueue", times=2)  # what may have been missed before the watch began
    del rig.directory.queues[queue.queue_id]
    rig.directory.tell(queue.record)
    assert await taker.ended() == grpc.StatusCode.NOT_FOUND
    assert rig.host.queues.all() == []


async def test_what_a_broken_watch_missed_is_asked_for(rig: QueueRig) -> None:
    queue = rig.open()
    taker = await queue.take(credit=1).open()
    await rig.directory.called("Watch", times=1)
    queue.record.host_id, queue.record.epoch = b"another-host-id!", 2
    rig.directory.break_watches()
    assert await taker.ended() == grpc.StatusCode.FAILED_PRECONDITION


async def test_a_host_that_may_not_serve_ends_its_streams_and_keeps_the_items() -> None:
    async with queue_directory(lease_ttl_nanos=S) as directory, host_of(directory) as rig:
        queue = rig.open()
        await queue.put(b"a")
        taker = await queue.take(credit=2).open()
        (item,) = await taker.items(1)
        directory.refuse["RenewHostLease"] = Unavailable("no majority")
        assert await taker.ended() == grpc.StatusCode.FAILED_PRECONDITION
        (acked,) = await queue.enqueue(run_of(b"x"))
        assert acked.error.reason == error_pb2.ERROR_REASON_NOT_HERE
        directory.refuse.clear()
        again = await _taken_again(queue)
        (result,) = await again.settled(ack(item))
        assert not result.HasField("error")


async def test_what_is_said_of_a_delivery_of_a_former_incarnation_settles_nothing_of_the_next(rig: QueueRig) -> None:
    queue = rig.open()
    await queue.put(b"before")
    (former,) = await (await queue.take(taker_id=5, credit=1).open()).items(1)
    queue.record.epoch, queue.record.incarnation = 2, queue.record.incarnation + 1
    await queue.put(b"after")
    again = await queue.take(taker_id=5, credit=1).open()
    (item,) = await again.items(1)
    assert item.payload == b"after"
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


async def test_a_thousand_waiting_takers_are_served_in_turn(rig: QueueRig) -> None:
    queue = rig.open()
    calls = [await queue.take(taker_id=number, credit=1).open() for number in range(1, 1001)]
    await queue.until(lambda status: status.waiting_takers == 1000)
    await queue.enqueue(*[run_of(*[b"%d" % (part * 250 + place) for place in range(250)]) for part in range(4)])
    found = [(await call.items(1))[0].payload for call in calls]
    assert found == [b"%d" % number for number in range(1000)]
    assert (await queue.status()).waiting_takers == 0


async def test_a_frozen_taker_keeps_an_item_from_live_ones_for_one_lease_only() -> None:
    """Its stream is open, and it has credit for more: every item went to it again."""
    clock = ManualClock()
    async with running_queue_host(clock=clock) as rig:
        queue = rig.open(lease_nanos=10 * S)
        frozen = await queue.take(taker_id=1, credit=100).open()
        await queue.put(b"a")
        await queue.until(lambda status: status.counters.leased == 1)
        live = await queue.take(taker_id=2, credit=100).open()
        await queue.until(lambda status: status.waiting_takers == 2)
        clock.advance(10 * S)
        (item,) = await live.items(1)
        assert (item.payload, item.delivery) == (b"a", 2)
        await live.settled(ack(item))
        assert (await queue.status()).waiting_takers == 1
        for number in range(5):
            await queue.put(b"%d" % number)
            (item,) = await live.items(1)
            await live.settled(ack(item))
        await frozen.items(1)
        assert await frozen.read() == pb.TakeResponse(), "it is asked whether it lives"
        await frozen.call.write(pb.TakeRequest())
        await queue.until(lambda status: status.waiting_takers == 2)
        await queue.put(b"b", b"c")
        assert {(await frozen.items(1))[0].payload, (await live.items(1))[0].payload} == {b"b", b"c"}


async def test_a_taker_that_was_heard_since_its_lease_began_goes_on_being_served() -> None:
    clock = ManualClock()
    async with running_queue_host(clock=clock) as rig:
        queue = rig.open(lease_nanos=10 * S)
        taker = await queue.take(taker_id=1, credit=2).open()
        await queue.put(b"a")
        await taker.items(1)
        clock.advance(5 * S)
        await taker.settled(extend(10**9, S))  # whatever it says
        clock.advance(5 * S)
        assert (await taker.items(1))[0].delivery == 2


async def test_a_terminated_item_leaves_for_the_dead_letter_queue_and_tells_where_it_was() -> None:
    clock = ManualClock()
    async with queue_directory() as directory, host_of(directory, clock=clock) as rig:
        graveyard = rig.open("dead")
        queue = rig.open("jobs", dead_letter_queue_id=graveyard.queue_id)
        accepted = clock.time_unix_nano()
        await queue.put(b"good", b"poison")
        clock.advance(S)
        taker = await queue.take(taker_id=7, credit=2, taker_name="robot").open()
        items = await taker.items(2)
        (result,) = await taker.settled(term(items[1], "no image"))
        assert not result.HasField("error")
        (again,) = await taker.settled(term(items[1], "no image"))
        assert again.error.reason == error_pb2.ERROR_REASON_LEASE_EXPIRED
        (dead,) = await (await graveyard.take(credit=1).open()).items(1)
        assert dead.payload == b"poison"
        assert dead.run.run.origin == item_pb2.DeadLetterOrigin(
            queue_id=queue.queue_id,
            queue_name="jobs",
            seq=2,
            incarnation=queue.record.incarnation,
            enqueued_unix_nano=accepted,
            deliveries=1,
            last_end=item_pb2.DELIVERY_END_TERMINATED,
            reason="no image",
            last_taker_id=7,
            last_taker_name="robot",
        )


async def test_what_is_leased_is_listed_page_by_page(rig: QueueRig) -> None:
    queue = rig.open(lease_nanos=10 * S)
    await queue.put(b"a", b"b", b"c")
    taker = await queue.take(taker_id=7, credit=3, taker_name="robot").open()
    items = await taker.items(3)

    async def page(**asked: int) -> pb.ListPendingResponse:
        request = pb.ListPendingRequest(queue_id=queue.queue_id, epoch=queue.record.epoch, **asked)
        return await rig.stub.ListPending(request)

    whole = await page()
    assert [one.delivery_id for one in whole.deliveries] == [item.delivery_id for item in items]
    assert {(one.taker_id, one.taker_name, one.deliveries) for one in whole.deliveries} == {(7, "robot", 1)}
    assert {one.expires_unix_nano - one.leased_unix_nano for one in whole.deliveries} == {10 * S}
    assert not whole.more
    first = await page(page_size=2)
    assert first.more
    assert (await page(after_delivery_id=first.deliveries[-1].delivery_id)).deliveries == whole.deliveries[2:]
    with pytest.raises(grpc.aio.AioRpcError) as caught:
        await page(page_size=1001)
    assert caught.value.code() == grpc.StatusCode.INVALID_ARGUMENT


async def test_a_message_id_names_one_item_and_has_a_bound(rig: QueueRig) -> None:
    queue = rig.open()
    assert (await queue.put(b"a", b"b", message_id="x")).error.reason == error_pb2.ERROR_REASON_MALFORMED_RUN
    assert (await queue.put(b"a", message_id="x" * 129)).error.reason == error_pb2.ERROR_REASON_MALFORMED_RUN
    first, again = await queue.put(b"a", message_id="x" * 128), await queue.put(b"a", message_id="x" * 128)
    assert (again.first_seq, again.duplicate, first.duplicate) == (first.first_seq, True, False)


async def test_a_producer_cannot_put_an_origin_into_a_run(rig: QueueRig) -> None:
    run = run_of(b"a")
    run.run.origin.seq = 7
    (acked,) = await rig.open().enqueue(run)
    assert acked.error.reason == error_pb2.ERROR_REASON_MALFORMED_RUN


async def test_a_taker_is_shown_a_sign_of_life(rig: QueueRig, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(take_stream, "SIGN_OF_LIFE_SECONDS", 0.01)
    taker = await rig.open().take(credit=1).open()
    assert await taker.read() == pb.TakeResponse()


async def test_the_hosts_memory_bounds_all_queues_together() -> None:
    async with running_queue_host(memory_bytes_max=2**20) as rig:
        first, second = rig.open("a"), rig.open("b")
        await first.put(bytes(2**20 - 4096))
        with pytest.raises(grpc.aio.AioRpcError) as caught:
            await second.put(bytes(8192))
        assert caught.value.code() == grpc.StatusCode.RESOURCE_EXHAUSTED
        assert (await second.status()).counters.accepted == 0


async def test_large_deliveries_come_in_messages_of_a_mebibyte(rig: QueueRig) -> None:
    queue = rig.open()
    await queue.enqueue(*[run_of(bytes(300_000)) for _ in range(10)])
    await queue.enqueue(run_of(bytes(2**21)), run_of(b"last"))
    taker = await queue.take(credit=100).open()
    sizes = []
    taken: list[Delivered] = []
    while len(taken) < 12:
        response = await taker.read()
        taken += delivered_in(response)
        sizes.append(response.ByteSize())
    assert [one.seq for one in taken] == list(range(1, 13))
    assert sorted(sizes)[-2] <= 2**20 < sorted(sizes)[-1]


async def test_a_host_that_stops_says_so_to_takers_and_producers() -> None:
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
