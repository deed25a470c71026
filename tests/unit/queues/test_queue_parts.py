"""What a queue is made of: deadlines, acknowledged deliveries, set-ups, and messages framed by hand."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import pytest

from stampede_rt.errors import InvalidArgument
from stampede_rt.v1 import item_pb2, queue_pb2
from stampede_rt.v1 import queue_service_pb2 as pb
from stampede_rt.wire.queues import queue_policy_from_spec
from stampede_rt_channel_host.core.deadlines import Deadlines
from stampede_rt_channel_host.core.queue import Batch, LeasedSlice, QueuedRun, QueueLimits
from stampede_rt_channel_host.core.queue.acknowledged import KEPT_NANOS, AcknowledgedDeliveries
from stampede_rt_channel_host.queues.dead_letters import producer_id_of
from stampede_rt_channel_host.queues.frames import take_response
from stampede_rt_channel_host.queues.requests import settlements_of, taker_of


@dataclass(eq=False)
class Thing:
    order: int
    due: int | None = None


def test_things_are_due_in_order_and_only_at_their_last_deadline() -> None:
    deadlines, one, two, three = Deadlines[Thing](), Thing(1), Thing(2), Thing(3)
    deadlines.arm(one, 5)
    deadlines.arm(two, 5)
    deadlines.arm(three, 1)
    deadlines.arm(three, 9)
    assert (deadlines.next(), deadlines.pop(4)) == (5, None)
    assert [deadlines.pop(9) for _ in range(4)] == [one, two, three, None]
    assert deadlines.next() is None


def test_what_is_disarmed_is_not_due() -> None:
    deadlines, one = Deadlines[Thing](), Thing(1)
    deadlines.arm(one, 5)
    deadlines.disarm(one)
    deadlines.disarm(one)
    assert deadlines.pop(10) is None


def test_a_deadline_that_is_put_off_again_and_again_takes_no_more_room() -> None:
    deadlines, one = Deadlines[Thing](), Thing(1)
    for due in range(10_000):
        deadlines.arm(one, due)
    assert len(deadlines._heap) < 200
    assert deadlines.pop(9_999) is one


def test_acknowledged_deliveries_are_known_to_their_taker_for_ten_minutes() -> None:
    known = AcknowledgedDeliveries()
    known.record(7, 1, 100)
    known.record(300, 2, 200)
    assert known.knows(7, 1, 100 + KEPT_NANOS - 1)
    assert not known.knows(7, 1, 100 + KEPT_NANOS)
    assert not known.knows(7, 2, 100)
    assert [(one.delivery_id, one.taker_id, one.time) for one in known.all(300)] == [(7, 1, 100), (300, 2, 200)]


def test_acknowledged_deliveries_are_bounded_and_forgotten() -> None:
    known = AcknowledgedDeliveries(chunks_max=2)
    for delivery_id in range(1, 1025):
        known.record(delivery_id, 1, delivery_id)
    assert not known.knows(1, 1, 1024)
    assert known.knows(1024, 1, 1024)
    assert known.footprint_bytes <= 3 * 4096
    known.record(5000, 1, 10**15)
    assert known.footprint_bytes == 4096


def test_what_was_never_stated_of_a_queue_has_its_default() -> None:
    limits = QueueLimits.of(queue_policy_from_spec(queue_pb2.QueueSpec()))
    assert (limits.max_items, limits.max_bytes, limits.copies) == (None, 256 * 2**20, 1)
    assert (limits.lease_nanos, limits.on_full, limits.max_deliveries) == (30 * 10**9, "block", None)
    spec = queue_pb2.QueueSpec(max_items=5, on_full=queue_pb2.QUEUE_ON_FULL_REJECT, dead_letter_queue_id=b"x" * 16)
    stated = QueueLimits.of(queue_policy_from_spec(spec))
    assert (stated.max_items, stated.on_full, stated.dead_letters) == (5, "reject", True)


def stored(first_seq: int, *payloads: bytes) -> QueuedRun:
    body = item_pb2.ItemRun(
        time_unix_nano=[1] * len(payloads),
        payload_length_bytes=[len(payload) for payload in payloads],
        payloads=b"".join(payloads),
        first_seq=first_seq,
    )
    return QueuedRun(first_seq, tuple(map(len, payloads)), 0, body.SerializeToString())


def test_a_framed_response_is_what_the_generated_message_would_be() -> None:
    whole, cut = stored(1, b"a", b"bb"), stored(3, b"c" * 200, b"d", b"e")
    batch = Batch([LeasedSlice(whole, 0, 2, [7, 8], [1, 1]), LeasedSlice(cut, 1, 3, [9, 10], [1, 4])], 500)
    results = [queue_pb2.SettlementResult(delivery_id=5)]
    found = pb.TakeResponse.FromString(take_response(batch, results, 100, incarnation=3, drained=True))
    first, second = found.runs
    assert (list(first.delivery_ids), list(first.deliveries), first.lease_nanos) == ([7, 8], [], 400)
    assert first.run.SerializeToString() == whole.body
    assert (list(second.delivery_ids), list(second.deliveries)) == ([9, 10], [1, 4])
    assert (second.run.payloads, second.run.first_seq) == (b"de", 4)
    assert (found.incarnation, found.drained, list(found.results)) == (3, True, results)


@pytest.mark.parametrize(
    ("settlement", "why"),
    [
        (queue_pb2.Settlement(acknowledge=queue_pb2.Acknowledge()), "delivery_id"),
        (queue_pb2.Settlement(delivery_id=1), "verdict"),
        (queue_pb2.Settlement(delivery_id=1, give_back=queue_pb2.GiveBack(delay_nanos=-1)), "delay_nanos is -1"),
        (queue_pb2.Settlement(delivery_id=1, extend_lease=queue_pb2.ExtendLease()), "lease_nanos is 0"),
        (queue_pb2.Settlement(delivery_id=1, extend_lease=queue_pb2.ExtendLease(lease_nanos=10**13)), "at most"),
    ],
)
def test_a_settlement_that_says_nothing_sensible_is_refused(settlement: queue_pb2.Settlement, why: str) -> None:
    with pytest.raises(InvalidArgument, match=why):
        settlements_of([settlement])


def test_at_most_1024_settlements_come_at_once() -> None:
    one = queue_pb2.Settlement(delivery_id=1, acknowledge=queue_pb2.Acknowledge())
    assert len(settlements_of(itertools.repeat(one, 1024))) == 1024
    with pytest.raises(InvalidArgument, match="1025 settlements"):
        settlements_of(itertools.repeat(one, 1025))


def test_a_taker_without_an_id_or_with_a_lease_of_a_day_is_refused() -> None:
    with pytest.raises(InvalidArgument, match="taker_id"):
        taker_of(pb.TakeOpen(queue_id=b"x" * 16, epoch=1))
    with pytest.raises(InvalidArgument, match="lease_nanos"):
        taker_of(pb.TakeOpen(queue_id=b"x" * 16, epoch=1, taker_id=1, lease_nanos=86_400 * 10**9))
    with pytest.raises(InvalidArgument, match="queue_id has 3 bytes"):
        taker_of(pb.TakeOpen(queue_id=b"abc", epoch=1, taker_id=1))


def test_a_queue_puts_its_dead_letters_as_the_same_producer_at_every_host() -> None:
    record = queue_pb2.QueueRecord(queue_id=b"x" * 16, incarnation=5, epoch=1, host_id=b"a" * 16)
    elsewhere = queue_pb2.QueueRecord(queue_id=b"x" * 16, incarnation=5, epoch=2, host_id=b"b" * 16)
    assert producer_id_of(record) == producer_id_of(elsewhere) != 0
    assert producer_id_of(queue_pb2.QueueRecord(queue_id=b"x" * 16, incarnation=6)) != producer_id_of(record)
