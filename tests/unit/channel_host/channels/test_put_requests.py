"""Requests whose runs stay in place read as protobuf reads them."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as some

from stampede_rt.errors import InvalidArgument, MalformedRun
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.v1 import item_pb2
from stampede_rt.wire.put_frames import put_head, put_pieces
from stampede_rt.wire.runs import parse_run, run_parts
from stampede_rt_channel_host.channels import put_requests
from stampede_rt_channel_host.channels.put_requests import SHORT_BYTES, PutRequest, read_request

LONG = bytes(SHORT_BYTES + 1)


def as_protobuf(raw: bytes) -> tuple[object, ...]:
    request = pb.PutRequest.FromString(raw)
    puts = [(put.first_number, put.wait_nanos if put.HasField("wait_nanos") else None) for put in request.puts]
    runs = [put.run for put in request.puts]
    return request.channel_id, request.epoch, request.producer_id, puts, runs


def as_read(request: PutRequest) -> tuple[object, ...]:
    puts = [(put.first_number, put.wait_nanos) for put in request.puts]
    runs = [item_pb2.ItemRun.FromString(bytes(put.run)) for put in request.puts]
    return request.channel_id, request.epoch, request.producer_id, puts, runs


@given(
    some.lists(some.tuples(some.integers(1, 2**64 - 1), some.none() | some.integers(-1, 2**62)), max_size=4),
    some.booleans(),
    some.sampled_from([b"", b"short", LONG]),
)
def test_a_request_of_several_runs_reads_as_protobuf_reads_it(
    puts: list[tuple[int, int | None]], first: bool, payload: bytes
) -> None:
    run = run_parts([b"x", payload], times=[1, 2], attributes={"k": "v"})
    pieces = [put_head(b"c" * 16, 7, 9)] if first else []
    for number, wait in puts:
        pieces += put_pieces(b"", number, run, wait)
    raw = b"".join(pieces)
    assert as_read(read_request(raw)) == as_protobuf(raw)


@given(some.binary(max_size=40), some.integers(0, 40))
def test_changed_requests_read_as_protobuf_reads_them_or_are_refused(garbage: bytes, at: int) -> None:
    raw = b"".join(put_pieces(put_head(b"c" * 16, 7, 9), 3, run_parts([LONG], times=None), 5))
    changed = raw[:at] + garbage + raw[at + len(garbage) :]
    try:
        expected = as_protobuf(changed)
    except Exception:  # noqa: BLE001 - protobuf refuses the request, or the run in it
        with pytest.raises((InvalidArgument, MalformedRun)):
            _read_and_judge(changed)
        return
    assert as_read(read_request(changed)) == expected


def _read_and_judge(raw: bytes) -> None:
    for put in read_request(raw).puts:
        parse_run(put.run)


def test_a_long_request_in_an_unusual_form_is_read_whole() -> None:
    usual = b"".join(put_pieces(b"", 3, run_parts([LONG], times=None)))
    head_behind = usual + put_head(b"c" * 16, 7, 9)
    assert as_read(read_request(head_behind)) == as_protobuf(head_behind)


def test_the_runs_of_a_long_request_are_not_copied() -> None:
    raw = b"".join(put_pieces(b"", 3, run_parts([LONG], times=None)))
    (put,) = read_request(raw).puts
    assert isinstance(put.run, memoryview)
    assert put.run.obj is raw
    assert type(put.kept().run) is bytes


@pytest.mark.parametrize("cut", [1, SHORT_BYTES // 2])
def test_a_request_that_is_cut_off_is_refused(cut: int) -> None:
    raw = b"".join(put_pieces(b"", 3, run_parts([LONG, LONG], times=None)))
    with pytest.raises(InvalidArgument, match="no valid PutRequest"):
        read_request(raw[:-cut])
    assert len(raw) > put_requests.SHORT_BYTES
