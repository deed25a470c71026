"""Requests that the client frames itself equal the requests that protobuf encodes."""

from __future__ import annotations

from hypothesis import given, strategies

from stampede_rt.v1 import channel_service_pb2 as channel_pb
from stampede_rt.v1 import item_pb2
from stampede_rt.wire.put_frames import put_head, put_request
from stampede_rt.wire.runs import run_parts


@given(
    strategies.integers(1, 2**64 - 1),
    strategies.lists(strategies.binary(max_size=300), min_size=1, max_size=4),
    strategies.none() | strategies.integers(-1, 2**62),
    strategies.booleans(),
    strategies.sampled_from(({}, {"k": "v"})),
)
def test_a_framed_put_is_decoded_as_the_message(
    number: int, payloads: list[bytes], wait: int | None, first: bool, labels: dict[str, str]
) -> None:
    head = put_head(b"c" * 16, 7, 9) if first else b""
    times = list(range(len(payloads)))
    request = channel_pb.PutRequest.FromString(
        put_request(head, number, run_parts(payloads, times=times, attributes=labels), wait)
    )
    run = item_pb2.ItemRun(
        time_unix_nano=times,
        payload_length_bytes=[len(payload) for payload in payloads],
        attributes=labels,
        payloads=b"".join(payloads),
    )
    expected = channel_pb.PutRequest(puts=[channel_pb.PutRun(first_number=number, wait_nanos=wait, run=run)])
    if first:
        expected.channel_id, expected.epoch, expected.producer_id = b"c" * 16, 7, 9
    assert request == expected
