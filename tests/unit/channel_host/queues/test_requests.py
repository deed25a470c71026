"""Requests about queues that the host refuses before it does anything."""

from __future__ import annotations

import itertools

import pytest

from stampede_rt.errors import InvalidArgument
from stampede_rt.v1 import queue_pb2
from stampede_rt.v1 import queue_service_pb2 as pb
from stampede_rt_channel_host.queues.requests import settlements_of, taker_of


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
def test_an_invalid_settlement_is_refused(settlement: queue_pb2.Settlement, why: str) -> None:
    with pytest.raises(InvalidArgument, match=why):
        settlements_of([settlement])


def test_a_request_has_at_most_1024_settlements() -> None:
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
