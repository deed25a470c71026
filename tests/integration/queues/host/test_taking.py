"""Takers at a channel host, over gRPC with the generated stubs: their deliveries and settlements."""

from __future__ import annotations

import grpc
import pytest

from stampede_rt.v1 import error_pb2
from stampede_rt.v1 import queue_service_pb2 as pb
from stampede_rt_channel_host.queues import take_stream
from tests.support.channel_host.queue_rig import (
    QueueRig,
    RigDelivery,
    S,
    ack,
    delivered_in,
    extend,
    nack,
    run_of,
    running_queue_host,
)
from tests.support.clock import ManualClock


async def test_messages_are_taken_in_order_and_consumed_by_acknowledging(rig: QueueRig) -> None:
    queue = rig.open()
    acked = await queue.put(b"one", b"two", b"three", content_type="text/plain")
    assert (acked.first_seq, acked.items, acked.incarnation) == (1, 3, queue.record.incarnation)
    taker = await queue.take(credit=10).open()
    assert taker.incarnation == queue.record.incarnation
    deliveries = await taker.deliveries(3)
    assert [(one.payload, one.seq, one.delivery) for one in deliveries] == [
        (b"one", 1, 1),
        (b"two", 2, 1),
        (b"three", 3, 1),
    ]
    assert deliveries[0].run.run.content_type == "text/plain"
    assert deliveries[0].run.run.time_unix_nano[0] == acked.stamped_unix_nano
    assert 0 < deliveries[0].run.lease_nanos <= 30 * S
    results = await taker.settled(*map(ack, deliveries))
    assert [(one.delivery_id, one.HasField("error")) for one in results] == [
        (one.delivery_id, False) for one in deliveries
    ]
    counters = (await queue.status()).counters
    assert (counters.accepted, counters.consumed, counters.held, counters.leased) == (3, 3, 0, 0)


async def test_a_waiting_taker_gets_new_messages(rig: QueueRig) -> None:
    queue = rig.open()
    taker = await queue.take(credit=1).open()
    await queue.until(lambda status: status.waiting_takers == 1)
    await queue.put(b"x")
    (delivery,) = await taker.deliveries(1)
    assert delivery.payload == b"x"


async def test_a_nacked_message_is_delivered_again_before_later_messages_and_counted(rig: QueueRig) -> None:
    queue = rig.open()
    await queue.put(b"a", b"b", b"c")
    taker = await queue.take(credit=1).open()
    (first,) = await taker.deliveries(1)
    await taker.settled(nack(first))
    await taker.send(credit=2)
    redelivered, second = await taker.deliveries(2)
    assert [(redelivered.payload, redelivered.delivery), (second.payload, second.delivery)] == [(b"a", 2), (b"b", 1)]
    assert redelivered.delivery_id != first.delivery_id


async def test_the_messages_of_a_killed_taker_are_delivered_again_when_its_lease_ends() -> None:
    clock = ManualClock()
    async with running_queue_host(clock=clock) as rig:
        queue = rig.open(lease_nanos=10 * S)
        await queue.put(b"a", b"b")
        killed = await queue.take(taker_id=1, credit=2).open()
        await killed.deliveries(2)
        killed.call.cancel()
        other = await queue.take(taker_id=2, credit=2).open()
        await queue.until(lambda status: status.waiting_takers == 1)
        assert (await queue.status()).counters.leased == 2
        clock.advance(10 * S)
        deliveries = await other.deliveries(2)
        assert [(one.payload, one.delivery) for one in deliveries] == [(b"a", 2), (b"b", 2)]
        assert (await queue.status()).counters.leases_expired == 2


async def test_a_taker_with_a_new_stream_settles_by_id_and_may_repeat_an_ack(rig: QueueRig) -> None:
    queue = rig.open()
    await queue.put(b"a", b"b")
    taker = await queue.take(taker_id=7, credit=2).open()
    one, two = await taker.deliveries(2)
    taker.call.cancel()
    assert not (await queue.settle(ack(one), taker_id=7))[0].HasField("error")
    assert not (await queue.settle(ack(one), taker_id=7))[0].HasField("error")
    (others,) = await queue.settle(ack(one), taker_id=8)
    assert others.error.reason == error_pb2.ERROR_REASON_LEASE_EXPIRED
    next_taker = await queue.take(taker_id=7).open()
    (extended,) = await next_taker.settled(extend(two, 60 * S))
    assert extended.lease_nanos == 60 * S
    (stale,) = await next_taker.settled(ack(12345))
    assert stale.error.reason == error_pb2.ERROR_REASON_LEASE_EXPIRED


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
    assert (await taker.deliveries(1))[0].payload == b"x"
    assert await taker.ended() == grpc.StatusCode.OK


async def test_hundreds_of_waiting_takers_are_served_in_turn(rig: QueueRig) -> None:
    queue = rig.open()
    calls = [await queue.take(taker_id=number, credit=1).open() for number in range(1, 301)]
    await queue.until(lambda status: status.waiting_takers == 300)
    await queue.enqueue(*[run_of(*[b"%d" % (part * 100 + place) for place in range(100)]) for part in range(3)])
    found = [(await call.deliveries(1))[0].payload for call in calls]
    assert found == [b"%d" % number for number in range(300)]
    assert (await queue.status()).waiting_takers == 0


async def test_a_frozen_taker_delays_a_message_for_one_lease_only() -> None:
    """The frozen taker has an open stream and credit.

    In an earlier version, the host leased every message to the frozen taker again and again.
    """
    clock = ManualClock()
    async with running_queue_host(clock=clock) as rig:
        queue = rig.open(lease_nanos=10 * S)
        frozen = await queue.take(taker_id=1, credit=100).open()
        await queue.put(b"a")
        await queue.until(lambda status: status.counters.leased == 1)
        live = await queue.take(taker_id=2, credit=100).open()
        await queue.until(lambda status: status.waiting_takers == 2)
        clock.advance(10 * S)
        (delivery,) = await live.deliveries(1)
        assert (delivery.payload, delivery.delivery) == (b"a", 2)
        await live.settled(ack(delivery))
        assert (await queue.status()).waiting_takers == 1
        for number in range(5):
            await queue.put(b"%d" % number)
            (delivery,) = await live.deliveries(1)
            await live.settled(ack(delivery))
        await frozen.deliveries(1)
        assert await frozen.read() == pb.TakeResponse(), "the host asks the taker whether it lives"
        await frozen.call.write(pb.TakeRequest())
        await queue.until(lambda status: status.waiting_takers == 2)
        await queue.put(b"b", b"c")
        assert {(await frozen.deliveries(1))[0].payload, (await live.deliveries(1))[0].payload} == {b"b", b"c"}


async def test_a_taker_that_has_sent_a_request_since_its_lease_began_gets_further_messages() -> None:
    clock = ManualClock()
    async with running_queue_host(clock=clock) as rig:
        queue = rig.open(lease_nanos=10 * S)
        taker = await queue.take(taker_id=1, credit=2).open()
        await queue.put(b"a")
        await taker.deliveries(1)
        clock.advance(5 * S)
        await taker.settled(extend(10**9, S))  # the host learns of the taker; the kind of message does not matter
        clock.advance(5 * S)
        assert (await taker.deliveries(1))[0].delivery == 2


async def test_leased_messages_are_listed_page_by_page(rig: QueueRig) -> None:
    queue = rig.open(lease_nanos=10 * S)
    await queue.put(b"a", b"b", b"c")
    taker = await queue.take(taker_id=7, credit=3, taker_name="robot").open()
    deliveries = await taker.deliveries(3)

    async def page(**fields: int) -> pb.ListPendingResponse:
        request = pb.ListPendingRequest(queue_id=queue.queue_id, epoch=queue.record.epoch, **fields)
        return await rig.stub.ListPending(request)

    whole = await page()
    assert [one.delivery_id for one in whole.deliveries] == [delivery.delivery_id for delivery in deliveries]
    assert {(one.taker_id, one.taker_name, one.deliveries) for one in whole.deliveries} == {(7, "robot", 1)}
    assert {one.expires_unix_nano - one.leased_unix_nano for one in whole.deliveries} == {10 * S}
    assert not whole.more
    first = await page(page_size=2)
    assert first.more
    assert (await page(after_delivery_id=first.deliveries[-1].delivery_id)).deliveries == whole.deliveries[2:]
    with pytest.raises(grpc.aio.AioRpcError) as caught:
        await page(page_size=1001)
    assert caught.value.code() == grpc.StatusCode.INVALID_ARGUMENT


async def test_the_stream_of_a_waiting_taker_has_signs_of_life(rig: QueueRig, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(take_stream, "SIGN_OF_LIFE_SECONDS", 0.01)
    taker = await rig.open().take(credit=1).open()
    assert await taker.read() == pb.TakeResponse()


async def test_large_deliveries_come_in_messages_of_a_mebibyte(rig: QueueRig) -> None:
    queue = rig.open()
    await queue.enqueue(*[run_of(bytes(300_000)) for _ in range(10)])
    await queue.enqueue(run_of(bytes(2**21)), run_of(b"last"))
    taker = await queue.take(credit=100).open()
    sizes = []
    taken: list[RigDelivery] = []
    while len(taken) < 12:
        response = await taker.read()
        taken += delivered_in(response)
        sizes.append(response.ByteSize())
    assert [one.seq for one in taken] == list(range(1, 13))
    assert sorted(sizes)[-2] <= 2**20 < sorted(sizes)[-1]
