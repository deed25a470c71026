"""Each part of a feed is the same after encoding and decoding."""

from __future__ import annotations

import pytest

from stampede_rt.errors import InvalidArgument
from stampede_rt.v1 import replica_service_pb2 as pb
from stampede_rt.wire.runs import encode_run, seal_run
from stampede_rt_channel_host.copies.messages import (
    advance_of,
    cleared_of,
    collection_of,
    place_of,
    place_to,
    run_of,
    state_to,
)
from stampede_rt_channel_host.core.channel import FIRST_KEY, CollectionFacts, FeedPart, FeedPlace
from stampede_rt_channel_host.core.channel.held_items import ARCHIVE, COLLECTED_FOR

FULL = CollectionFacts((5, 7), 3, "bytes", 4, 2**63 + 5, "age", 2, 9)
EMPTY = CollectionFacts(FIRST_KEY, 0, "age", None, None, "age", None, None)


@pytest.mark.parametrize("collection", [FULL, EMPTY])
def test_a_decoded_feed_state_has_the_encoded_collection(collection: CollectionFacts) -> None:
    state = state_to(FeedPart(2, (1, 2), (), 8, collection, 6), 0)
    clamped = collection._replace(collected_end=None if collection.collected_end is None else 2**63 - 1)
    assert collection_of(pb.FeedState.FromString(state.SerializeToString())) == clamped
    assert (cleared_of(state), advance_of(state), state.first_seq, state.next_seq) == ((1, 2), 6, 2, 8)


@pytest.mark.parametrize("cause", [*COLLECTED_FOR, ARCHIVE])
def test_each_cause_can_go_to_another_host(cause: str) -> None:
    """In an earlier version, a recorded channel that had started again, and had lost no item since, could not move."""
    collection = EMPTY._replace(collected_by=cause)
    assert collection_of(state_to(FeedPart(2, None, (), 8, collection, 6), 0)) == collection


def test_a_feed_state_leaves_out_unchanged_fields() -> None:
    state = state_to(FeedPart(2, None, (), 2, None, None), 0)
    assert (cleared_of(state), collection_of(state), advance_of(state)) == (None, None, None)


def test_a_position_is_decoded_as_it_was_encoded_and_needs_a_seq() -> None:
    place = FeedPlace(11, 12, 13, 14)
    assert place_of(place_to(place, 3), 3) == place
    with pytest.raises(InvalidArgument, match="no next_seq"):
        place_of(pb.FeedPlace(incarnation=11), 3)


def test_the_times_of_a_former_owners_clock_are_left_out_for_the_next_owner() -> None:
    assert place_of(place_to(FeedPlace(11, 12, 13, 14), 3), 4) == FeedPlace(11, 12, 13)


def test_a_run_is_stored_with_the_received_bytes() -> None:
    body = seal_run(encode_run([b"a", b"bc"], times=[3, 1], durations=[-1, 4]), 20)
    run = run_of(body)
    assert run.body == body
    assert ([*run.times], [*(run.durations or ())], [*run.lengths]) == ([3, 1], [-1, 4], [1, 2])
    assert run.first_seq == 20


def test_a_source_that_sends_nonsense_is_refused() -> None:
    with pytest.raises(InvalidArgument, match="columns disagree"):
        run_of(encode_run([b"a"], times=None))
    with pytest.raises(InvalidArgument, match="cause 0"):
        collection_of(pb.FeedState(collection=pb.FeedCollection()))
