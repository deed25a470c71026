"""The items of a feed, and the answers to them: fixed bytes, which protobuf reads in the same way."""

from __future__ import annotations

from contextlib import suppress

import pytest
from google.protobuf.message import DecodeError
from hypothesis import given, strategies

from stampede_rt.errors import InvalidArgument
from stampede_rt.v1 import replica_service_pb2 as pb
from stampede_rt_channel_host.copies.fed_items import encode_answer, encode_item, read_answer
from stampede_rt_channel_host.copies.fed_responses import read_response
from stampede_rt_channel_host.core.channel import FedItem, NewFloor, NewItem

instants, counts = strategies.integers(-(2**63), 2**63 - 1), strategies.integers(1, 2**64 - 1)
# A stored run has at least a length and a seq.
bodies = strategies.builds(bytes, strategies.sampled_from([13, 200, 100_000]))
items = strategies.builds(NewItem, counts, strategies.just(0) | counts, counts, instants, instants,
                    strategies.integers(0, 2**32 - 1), strategies.booleans(), instants, bodies, strategies.just(""),
                    strategies.sampled_from([1, 2, 256, 2**32 - 1]))  # fmt: skip
floors = strategies.builds(NewFloor, strategies.tuples(instants, counts), instants, instants)
parts = strategies.builds(FedItem, items, strategies.none() | floors)


def message_of(fed: FedItem) -> pb.FeedResponse:
    item, new = fed.item, fed.collected
    message = pb.FedItem(
        seq=item.seq, producer_id=item.producer_id, first_number=item.first_number, time_unix_nano=item.time,
        duration_nanos=item.duration, payload_length_bytes=item.length, is_stamped=item.is_stamped,
        judged_unix_nano=item.judged_at, run=bytes(item.body), items=0 if item.items == 1 else item.items,
    )  # fmt: skip
    if new is not None:
        message.floor_time_unix_nano, message.floor_seq = new.floor
        message.newest_collected_unix_nano, message.collected_end_unix_nano = new.newest_collected, new.collected_end
    return pb.FeedResponse(item=message)


@given(parts)
def test_protobuf_reads_the_same_item(fed: FedItem) -> None:
    encoded = encode_item(fed)
    assert pb.FeedResponse.FromString(encoded) == message_of(fed)
    assert read_response(encoded) == read_response(memoryview(encoded)) == fed


@given(parts)
def test_an_item_whose_fields_protobuf_has_encoded_is_read_too(fed: FedItem) -> None:
    assert read_response(message_of(fed).SerializeToString()) == fed


@given(parts, strategies.integers(1, 150), strategies.integers(1, 255))
def test_a_damaged_item_is_refused_or_read_without_another_error(fed: FedItem, at: int, flipped: int) -> None:
    raw = bytearray(encode_item(fed))
    raw[at % len(raw)] ^= flipped
    for damaged in (bytes(raw), bytes(raw[: at % len(raw)])):
        with suppress(DecodeError, InvalidArgument):
            read_response(damaged)


def test_the_end_of_a_span_beyond_all_instants_is_the_last_instant() -> None:
    item = NewItem(1, 1, 1, 0, -1, 0, True, 0, bytes(13))
    found = read_response(encode_item(FedItem(item, NewFloor((1, 1), 1, 2**63 + 5))))
    assert found == FedItem(item, NewFloor((1, 1), 1, 2**63 - 1))


def test_an_item_without_a_run_is_refused() -> None:
    with pytest.raises(InvalidArgument, match="without a seq or run"):
        read_response(pb.FeedResponse(item=pb.FedItem(seq=1, producer_id=1)).SerializeToString())


@given(counts)
def test_an_answer_is_a_request_with_one_field(next_seq: int) -> None:
    encoded = encode_answer(next_seq)
    assert pb.FeedRequest.FromString(encoded) == pb.FeedRequest(item_next_seq=next_seq)
    assert read_answer(encoded) == read_answer(memoryview(encoded)) == next_seq


def test_other_requests_are_no_answers() -> None:
    for other in (pb.FeedRequest(sent_nanos=1), pb.FeedRequest(held_next_seq=5), pb.FeedRequest()):
        assert read_answer(other.SerializeToString()) == 0
