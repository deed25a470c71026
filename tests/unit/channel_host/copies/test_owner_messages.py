"""The facts that only the owner knows, encoded and decoded again."""

from __future__ import annotations

import pytest

from stampede_rt.errors import ChannelFull, InvalidArgument
from stampede_rt.v1 import replica_service_pb2 as pb
from stampede_rt_channel_host.copies.owner_messages import owner_of, owner_to, put_of, put_to
from stampede_rt_channel_host.core.channel import ConsumerPlace, Counters, FedPlaces, GrowingCounts, OwnerPart
from stampede_rt_channel_host.core.dedup import KeptRun
from stampede_rt_channel_host.core.run_outcome import ItemRefusal, RunOutcome, RunPart

COUNTERS = Counters(
    accepted=9,
    held=4,
    collected={"age": 1, "count": 2, "bytes": 1, "consumption": 1},
    rejected={
        "TOO_OLD": 1, "IN_FUTURE": 2, "ITEM_TOO_LARGE": 3, "CHANNEL_FULL": 4, "MALFORMED_RUN": 5, "OVERLOADED": 6,
    },
    accepted_bytes=90,
    held_bytes=40,
    late=2,
)  # fmt: skip
PLACES = FedPlaces(True, (ConsumerPlace(7, 50, 3, ((5, 6), (8, 12)), "ann"), ConsumerPlace(8, 0, 1, ())), ends=False)


def test_the_facts_of_an_owner_are_converted_to_the_clock_of_the_copy() -> None:
    refused = ItemRefusal(1, ChannelFull("full"))
    outcome = RunOutcome(6, 5, (RunPart(0, 20, 2, None), RunPart(3, 24, 2, 95)), (refused,), 90)
    whole = RunOutcome(2, 2, (RunPart(0, 22, 2, None),), (), 95)
    part = OwnerPart((KeptRun(1, 4, outcome, "ann"), KeptRun(2**63 + 5, 1, whole)), PLACES, COUNTERS, 100)
    back = owner_of(pb.OwnerFacts.FromString(owner_to(part, 100).SerializeToString()), 1000)
    assert back.runs[0].outcome.refusals[0].error.reason == "CHANNEL_FULL"
    moved = back.runs[0]._replace(outcome=back.runs[0].outcome._replace(refusals=(refused,)))
    assert moved == KeptRun(1, 4, outcome._replace(time=990), "ann")
    assert back.runs[1] == KeptRun(2**63 + 5, 1, whole._replace(time=995))
    assert (back.places, back.counters, back.complete_before) == (PLACES, COUNTERS, 100)


@pytest.mark.parametrize("stamp", [None, 95])
def test_a_put_is_converted_to_the_clock_of_the_copy(stamp: int | None) -> None:
    outcome = RunOutcome(2, 2, (RunPart(0, 22, 2, stamp),), (), 95)
    part = OwnerPart((KeptRun(2**63 + 5, 4, outcome, "ann"),), None, GrowingCounts(24, 900), 100)
    back = put_of(pb.FedPut.FromString(put_to(part, 100).SerializeToString()), 1000)
    assert back == part._replace(runs=(KeptRun(2**63 + 5, 4, outcome._replace(time=995), "ann"),))


def test_a_put_without_items_is_refused() -> None:
    with pytest.raises(InvalidArgument, match="without a producer or items"):
        put_of(pb.FedPut(producer_id=1, first_seq=1), 0)


def test_unchanged_consumer_places_are_left_out() -> None:
    back = owner_of(owner_to(OwnerPart((), None, COUNTERS, None), 0), 0)
    assert (back.runs, back.places, back.complete_before) == ((), None, None)


def test_a_run_whose_items_are_not_judged_is_refused() -> None:
    run = pb.FedRun(first_number=1, items=2, judged_items=2, parts=[pb.FedRunPart(first_seq=1, items=1)])
    with pytest.raises(InvalidArgument, match="without a valid judgement"):
        owner_of(pb.OwnerFacts(producers=[pb.FedProducer(producer_id=1, runs=[run])]), 0)
