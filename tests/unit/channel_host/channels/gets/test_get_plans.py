"""The host parses equal gets once, and each get still has its own answer."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stampede_rt.errors import InvalidArgument
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt_channel_host.channels.gets.get_plans import PLANS_MAX, GetPlans
from tests.support.channel_host.rig import between


def request(call_id: int, **fields: object) -> bytes:
    return pb.GetRequest(
        **{"call_id": call_id, "channel_id": b"c" * 16, "epoch": 3, "interval": between(1, 2), **fields}  # type: ignore[arg-type]
    ).SerializeToString()


@given(st.lists(st.tuples(st.integers(0, 2**64 - 1), st.integers(1, 3)), min_size=1, max_size=20))
def test_each_request_is_read_as_if_it_were_the_first(requests: list[tuple[int, int]]) -> None:
    plans = GetPlans()
    for call_id, limit in requests:
        call = plans.read(request(call_id, limit=limit))
        assert call == GetPlans().read(request(call_id, limit=limit))
        assert call.call_id == call_id
        assert call.plan is not None
        assert (call.plan.query.limit, call.plan.epoch) == (limit, 3)


def test_the_plan_of_a_repeated_get_is_made_once() -> None:
    plans = GetPlans()
    assert plans.read(request(1)).plan is plans.read(request(2**63)).plan is plans.read(request(0)).plan


def test_an_id_at_an_unusual_position_of_the_message_is_found() -> None:
    plans = GetPlans()
    late = request(0) + pb.GetRequest(call_id=5).SerializeToString()
    assert [plans.read(late).call_id for _ in range(2)] == [5, 5]
    twice = request(4) + pb.GetRequest(call_id=5).SerializeToString()
    assert [plans.read(twice).call_id for _ in range(2)] == [5, 5]


def test_cancellations_and_refusals_keep_their_ids() -> None:
    plans = GetPlans()
    for call_id in (7, 8):
        assert plans.read(pb.GetRequest(call_id=call_id, cancel=True).SerializeToString()).call_id == call_id
        refused = plans.read(request(call_id, wait_nanos=-5))
        assert (refused.call_id, refused.plan) == (call_id, None)
        assert isinstance(refused.refusal, InvalidArgument)


def test_a_stream_remembers_a_bounded_number_of_different_requests() -> None:
    plans = GetPlans()
    first = plans.read(request(1)).plan
    for limit in range(1, PLANS_MAX + 1):
        plans.read(request(1, limit=limit))
    assert plans.read(request(1)).plan is not first


@pytest.mark.parametrize("garbage", [b"\xff\xff", b"\x08", b"\x08" + b"\xff" * 12])
def test_a_request_of_random_bytes_is_refused(garbage: bytes) -> None:
    with pytest.raises(InvalidArgument, match="not a valid GetRequest"):
        GetPlans().read(garbage)
