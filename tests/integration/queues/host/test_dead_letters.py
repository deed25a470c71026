"""Messages of queues that no taker can process, over gRPC with the generated stubs."""

from __future__ import annotations

from stampede_rt.v1 import error_pb2, item_pb2, queue_pb2
from tests.support.channel_host.queue_rig import (
    QueueRig,
    S,
    ack,
    host_of,
    nack,
    queue_directory,
    term,
)
from tests.support.clock import ManualClock


async def test_a_message_delivered_too_often_moves_to_the_dead_letter_queue_of_another_host() -> None:
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
            (delivery,) = await taker.deliveries(1)
            await taker.settled(nack(delivery))
            await taker.send(credit=1)
        assert (await taker.deliveries(1))[0].payload == b"good"
        await queue.until(lambda status: status.counters.dead_lettered == 1)
        (dead,) = await (await graveyard.take(credit=1).open()).deliveries(1)
        assert (dead.payload, dead.run.run.content_type, dead.delivery) == (b"poison", "image/jpeg", 1)
        assert dict(dead.run.run.attributes) == {"k": "v"}
        counters = (await queue.status()).counters
        assert (counters.held, counters.expelled, counters.accepted) == (1, 0, 2)


async def test_a_message_stays_until_the_dead_letter_queue_takes_it() -> None:
    async with queue_directory() as directory, host_of(directory) as rig:
        graveyard = rig.open("dead", max_items=1, on_full=queue_pb2.QUEUE_ON_FULL_REJECT)
        queue = rig.open(max_deliveries=1, dead_letter_queue_id=graveyard.queue_id)
        await graveyard.put(b"in the way")
        await queue.put(b"poison")
        taker = await queue.take(credit=1).open()
        await taker.settled(nack((await taker.deliveries(1))[0]))
        await graveyard.until(lambda status: status.counters.rejected_full > 0)
        assert (await queue.status()).counters.held == 1
        clearing = await graveyard.take(credit=2).open()
        await clearing.settled(ack((await clearing.deliveries(1))[0]))
        assert (await clearing.deliveries(1))[0].payload == b"poison"
        await queue.until(lambda status: status.counters.dead_lettered == 1)


async def test_a_message_delivered_too_often_is_expelled_without_a_dead_letter_queue(rig: QueueRig) -> None:
    queue = rig.open(max_deliveries=1)
    await queue.put(b"poison")
    taker = await queue.take(credit=1).open()
    await taker.settled(nack((await taker.deliveries(1))[0]))
    assert (await queue.status()).counters.expelled == 1


async def test_a_terminated_message_moves_to_the_dead_letter_queue_with_its_origin() -> None:
    clock = ManualClock()
    async with queue_directory() as directory, host_of(directory, clock=clock) as rig:
        graveyard = rig.open("dead")
        queue = rig.open("jobs", dead_letter_queue_id=graveyard.queue_id)
        accepted = clock.time_unix_nano()
        await queue.put(b"good", b"poison")
        clock.advance(S)
        taker = await queue.take(taker_id=7, credit=2, taker_name="robot").open()
        deliveries = await taker.deliveries(2)
        (result,) = await taker.settled(term(deliveries[1], "no image"))
        assert not result.HasField("error")
        (repeated,) = await taker.settled(term(deliveries[1], "no image"))
        assert repeated.error.reason == error_pb2.ERROR_REASON_LEASE_EXPIRED
        (dead,) = await (await graveyard.take(credit=1).open()).deliveries(1)
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
