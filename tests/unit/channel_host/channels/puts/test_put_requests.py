"""The host decodes requests without copying their runs, with the same result as protobuf."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from hypothesis import given, strategies

from stampede_rt.errors import InvalidArgument, MalformedRun
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.v1 import item_pb2
from stampede_rt.v1 import queue_service_pb2 as queue_pb
from stampede_rt.wire.put_frames import put_head, put_pieces
from stampede_rt.wire.request_pieces import MESSAGE_BYTES_MAX
from stampede_rt.wire.runs import parse_run, run_parts
from stampede_rt_channel_host.channels.puts import long_requests, put_requests
from stampede_rt_channel_host.channels.puts.long_requests import SHORT_BYTES
from stampede_rt_channel_host.channels.puts.put_requests import Put, PutRequest, read_request
from stampede_rt_channel_host.channels.requests import parse
from stampede_rt_channel_host.queues import incoming
from stampede_rt_channel_host.queues.incoming import read_request as read_enqueues

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
    strategies.lists(
        strategies.tuples(strategies.integers(1, 2**64 - 1), strategies.none() | strategies.integers(-1, 2**62)),
        max_size=4,
    ),
    strategies.booleans(),
    strategies.sampled_from([b"", b"short", LONG]),
)
def test_a_request_of_several_runs_is_decoded_as_by_protobuf(
    puts: list[tuple[int, int | None]], first: bool, payload: bytes
) -> None:
    run = run_parts([b"x", payload], times=[1, 2], attributes={"k": "v"})
    pieces = [put_head(b"c" * 16, 7, 9)] if first else []
    for number, wait in puts:
        pieces += put_pieces(b"", number, run, wait)
    raw = b"".join(pieces)
    assert as_read(read_request(raw)) == as_protobuf(raw)


@given(strategies.binary(max_size=40), strategies.integers(0, 40))
def test_a_changed_request_is_decoded_as_by_protobuf_or_refused(garbage: bytes, at: int) -> None:
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


def test_a_long_request_in_an_unusual_form_is_decoded_by_protobuf() -> None:
    usual = b"".join(put_pieces(b"", 3, run_parts([LONG], times=None)))
    head_behind = usual + put_head(b"c" * 16, 7, 9)
    assert as_read(read_request(head_behind)) == as_protobuf(head_behind)


def test_the_runs_of_a_long_request_are_not_copied() -> None:
    raw = b"".join(put_pieces(b"", 3, run_parts([LONG], times=None)))
    (put,) = read_request(raw).puts
    assert isinstance(put.run, memoryview)
    assert put.run.obj is raw
    assert put.kept().run is put.run  # the run is nearly the whole request
    several = b"".join(put_pieces(b"", 3, run_parts([LONG], times=None))) * 8
    assert [type(put.kept().run) for put in read_request(several).puts] == [bytes] * 8


def enqueue_of_runs(*payloads: bytes) -> bytes:
    """The request with runs that have message ids after their payloads."""
    runs = [
        queue_pb.EnqueueRun(
            first_number=number,
            wait_nanos=5,
            message_id=f"m{number}",
            run=item_pb2.ItemRun(payload_length_bytes=[len(one)], payloads=one),
        )
        for number, one in enumerate(payloads, start=1)
    ]
    return queue_pb.EnqueueRequest(queue_id=b"q" * 16, epoch=3, producer_id=4, runs=runs).SerializeToString()


@pytest.mark.parametrize("payloads", [(b"short",), (LONG,), (LONG, b"", LONG)])
def test_a_request_of_enqueues_is_decoded_as_by_protobuf(payloads: tuple[bytes, ...]) -> None:
    raw = enqueue_of_runs(*payloads)
    known, found = queue_pb.EnqueueRequest.FromString(raw), read_enqueues(raw)
    assert (found.queue_id, found.epoch, found.producer_id) == (known.queue_id, known.epoch, known.producer_id)
    for one, expected in zip(found.runs, known.runs, strict=True):
        assert (one.first_number, one.wait_nanos, one.message_id) == (expected.first_number, 5, expected.message_id)
        assert item_pb2.ItemRun.FromString(bytes(one.run)) == expected.run
        assert isinstance(one.run, memoryview) == (payloads == (LONG,))


UNUSUAL = put_head(b"c" * 16, 7, 9)


@pytest.mark.parametrize("read", [read_request, read_enqueues])
def test_a_request_in_pieces_of_an_unusual_form_is_refused_and_not_copied(
    read: Callable[[bytes], object], monkeypatch: pytest.MonkeyPatch
) -> None:
    usual = b"".join(put_pieces(b"", 3, run_parts([bytes(MESSAGE_BYTES_MAX)], times=None)))
    copied_bytes: list[int] = []

    def counting(kind: object, raw: bytes, name: str) -> object:
        copied_bytes.append(len(raw))
        return parse(kind, raw, name)  # type: ignore[type-var]

    for module in (long_requests, put_requests, incoming):
        monkeypatch.setattr(module, "parse", counting)
    unknown = bytes((9 << 3 | 2, 1, 0))
    for raw in (usual + UNUSUAL, unknown + usual, usual[:-1], usual + unknown):
        with pytest.raises(InvalidArgument, match=r"not a valid .* message whose fields come in the order"):
            read(raw)
    read(UNUSUAL + usual)
    assert max(copied_bytes) < 100


@pytest.mark.parametrize("cut", [1, SHORT_BYTES // 2])
def test_a_request_that_is_cut_off_is_refused(cut: int) -> None:
    raw = b"".join(put_pieces(b"", 3, run_parts([LONG, LONG], times=None)))
    with pytest.raises(InvalidArgument, match="not a valid PutRequest"):
        read_request(raw[:-cut])
    assert len(raw) > SHORT_BYTES


@pytest.mark.parametrize(("run", "items"), [
    (b"".join(run_parts((b"a", b"b"), times=[1, 2])), 2), (b"".join(run_parts((b"a",) * 200, times=[1] * 200)), 200),
    (b"".join(run_parts((b"a", b"b"), times=None)), 0), (b"", 0), (b"\x0a", 0), (b"\x0a\xff", 0),
])  # fmt: skip
def test_a_put_counts_the_times_of_its_run(run: bytes, items: int) -> None:
    assert Put(1, None, run).timed_items == items
