"""The puts that the owner of a queue sends ahead, and the answers to them, each with fields at fixed offsets.

Protobuf reads these bytes in the same way.
"""

from __future__ import annotations

from contextlib import suppress

import pytest
from google.protobuf.message import DecodeError
from hypothesis import given, strategies

from stampede_rt.errors import InvalidArgument
from stampede_rt.v1 import migration_service_pb2 as pb
from stampede_rt_channel_host.copies.queues.queue_puts import (
    encode_answer,
    encode_put,
    encode_request,
    read_answer,
    read_put,
)
from stampede_rt_channel_host.core.queue import AheadPut

counts = strategies.integers(1, 2**64 - 1)
bodies = strategies.builds(bytes, strategies.sampled_from([13, 200, 100_000]))
names = strategies.sampled_from(["", "client cam", "Müller", "n" * 200])
stamps = strategies.none() | strategies.integers(-(2**63), 2**63 - 1)
puts = strategies.builds(
    AheadPut, counts, counts, counts, counts, strategies.integers(0, 2**32 - 1), stamps, names, bodies
)


def message_of(put: AheadPut) -> pb.FeedQueueRequest:
    return pb.FeedQueueRequest(put=pb.FedQueuePut(
        step=put.number, seq=put.seq, producer_id=put.producer_id, first_number=put.first_number,
        stamped_unix_nano=put.stamped_time or 0, payload_length_bytes=put.length,
        is_stamped=put.stamped_time is not None, owner=put.caller_name, run=put.body,
    ))  # fmt: skip


@given(puts)
def test_protobuf_reads_the_same_put(put: AheadPut) -> None:
    encoded = encode_put(put)
    assert pb.FeedQueueRequest.FromString(encoded) == message_of(put)
    assert read_put(encoded) == read_put(memoryview(encoded)) == put


@given(puts)
def test_a_put_whose_fields_protobuf_has_encoded_is_read_too(put: AheadPut) -> None:
    assert read_put(message_of(put).SerializeToString()) == put


@given(puts, strategies.integers(1, 150), strategies.integers(1, 255))
def test_a_damaged_put_is_refused_or_read_without_another_error(put: AheadPut, at: int, flipped: int) -> None:
    raw = bytearray(encode_put(put))
    raw[at % len(raw)] ^= flipped
    for damaged in (bytes(raw), bytes(raw[: at % len(raw)])):
        with suppress(InvalidArgument):
            read_put(damaged)


@pytest.mark.parametrize("field", ["step", "seq", "producer_id", "run"])
def test_a_put_without_a_fact_that_it_needs_is_refused(field: str) -> None:
    message = message_of(AheadPut(1, 1, 1, 1, 8, None, "", b"run"))
    message.put.ClearField(field)  # type: ignore[arg-type]
    with pytest.raises(InvalidArgument, match="without a step, seq, producer or run"):
        read_put(message.SerializeToString())


@given(counts)
def test_an_answer_is_a_response_with_one_field(next_step: int) -> None:
    encoded = encode_answer(next_step)
    assert pb.FeedQueueResponse.FromString(encoded) == pb.FeedQueueResponse(put_next_step=next_step)
    assert read_answer(encoded) == read_answer(memoryview(encoded)) == next_step


def test_other_responses_are_no_answers_to_puts() -> None:
    for other in (pb.FeedQueueResponse(next_step=5), pb.FeedQueueResponse(incarnation=5), pb.FeedQueueResponse()):
        assert read_answer(other.SerializeToString()) == other
    with pytest.raises(DecodeError):
        read_answer(b"\xff")


def test_other_requests_are_encoded_by_protobuf() -> None:
    request = pb.FeedQueueRequest(owner_host_id=b"o" * 16)
    assert encode_request(request) == request.SerializeToString()
