"""The responses of a feed: a long one gives the same fields and runs as protobuf, without a copy of its runs."""

from __future__ import annotations

from contextlib import suppress

import pytest
from google.protobuf.message import DecodeError
from hypothesis import given, strategies

from stampede_rt.v1 import item_pb2, raw_run_pb2
from stampede_rt.v1 import replica_service_pb2 as pb
from stampede_rt_channel_host.copies.fed_responses import LONG_BYTES, read_response

sizes = strategies.lists(strategies.sampled_from([0, 1, 200, LONG_BYTES - 40, LONG_BYTES]), max_size=4)


def response_of(payloads: list[int]) -> bytes:
    """An encoded response with a run for each payload."""
    response = pb.FeedResponse(
        opened=pb.FeedOpened(begins_anew=True),
        state=pb.FeedState(first_seq=3, next_seq=9, heard_nanos=5),
        move_over=True,
    )
    for seq, size in enumerate(payloads, start=3):
        run = item_pb2.ItemRun(first_seq=seq, time_unix_nano=[seq], payload_length_bytes=[size], payloads=bytes(size))
        response.runs.append(item_pb2.DeliveredRun(run=run, next_time_unix_nano=seq if seq % 2 else None))
    return response.SerializeToString()


@given(sizes)
def test_a_response_has_the_fields_and_runs_that_protobuf_reads(payloads: list[int]) -> None:
    raw = response_of(payloads)
    wanted = raw_run_pb2.RawFeedResponse.FromString(raw)
    found = read_response(memoryview(raw))
    assert [bytes(one) for one in found.runs] == [one.run for one in wanted.runs]
    del wanted.runs[:]
    del found.fields.runs[:]
    assert found.fields == wanted


def test_the_runs_of_a_long_response_are_views_of_its_bytes() -> None:
    raw = bytearray(response_of([LONG_BYTES]))
    found = read_response(memoryview(raw))
    assert not found.fields.runs
    [run] = found.runs
    assert isinstance(run, memoryview)
    assert run.obj is raw


@given(strategies.integers(3, 200), strategies.integers(0, 200))
def test_a_damaged_long_response_is_refused_or_has_other_bytes(end: int, flipped: int) -> None:
    raw = bytearray(response_of([LONG_BYTES]))
    with pytest.raises(DecodeError):
        read_response(bytes(raw[:-end]))
    raw[flipped] ^= 0xFF
    with suppress(DecodeError):
        read_response(bytes(raw))
