"""A plain run has one item, without attributes and content type. Its bytes are the bytes that protobuf would encode.

The reader of plain runs refuses all other runs.
"""

from __future__ import annotations

import pytest
from hypothesis import given, strategies

from stampede_rt.v1 import item_pb2
from stampede_rt.wire.plain_runs import plain_run_parts, read_plain_run, read_sealed_run, sealed_payload_at
from stampede_rt.wire.run_slices import sealed_columns
from stampede_rt.wire.runs import encode_run, parse_run, seal_run

instants = strategies.integers(-(2**63), 2**63 - 1)


@given(strategies.binary(max_size=300), strategies.none() | instants, strategies.none() | instants)
def test_a_plain_run_has_the_bytes_that_protobuf_encodes(
    payload: bytes, time: int | None, duration: int | None
) -> None:
    made = b"".join(plain_run_parts(payload, time, duration))
    expected = item_pb2.ItemRun(
        time_unix_nano=() if time is None else (time,),
        duration_nanos=() if duration is None else (duration,),
        payload_length_bytes=(len(payload),),
        payloads=payload,
    )
    assert item_pb2.ItemRun.FromString(made) == expected
    if payload:  # protobuf leaves out an empty field
        assert made == expected.SerializeToString()
    assert read_plain_run(made) == read_plain_run(memoryview(made)) == (time, duration, len(payload))


@given(strategies.binary(max_size=40), strategies.data())
def test_a_cut_run_is_not_plain(payload: bytes, data: strategies.DataObject) -> None:
    made = b"".join(plain_run_parts(payload, 5, 6))
    assert read_plain_run(made[: data.draw(strategies.integers(0, len(made) - 1))]) is None


@pytest.mark.parametrize("time", [None, 5])
@pytest.mark.parametrize("duration", [None, 6])
@pytest.mark.parametrize("payload", [b"", b"payload", bytes(200)])
def test_damaged_bytes_read_as_plain_are_a_run_of_these_columns(
    time: int | None, duration: int | None, payload: bytes
) -> None:
    made, plain = b"".join(plain_run_parts(payload, time, duration)), 0
    for at in range(len(made)):
        for flipped in range(1, 256):
            raw = made[:at] + bytes((made[at] ^ flipped,)) + made[at + 1 :]
            found = read_plain_run(raw)
            if found is not None:
                plain += 1
                run = item_pb2.ItemRun.FromString(raw)
                assert [*run.time_unix_nano] == ([] if found.time is None else [found.time])
                assert [*run.duration_nanos] == ([] if found.duration is None else [found.duration])
                assert ([*run.payload_length_bytes], len(run.payloads)) == ([found.length], found.length)
    assert plain >= 255 * (8 * ((time is not None) + (duration is not None)) + len(payload))


def test_other_runs_are_not_plain() -> None:
    for raw in (
        b"",
        encode_run((b"a", b"b"), times=(1, 2)),
        encode_run((b"a",), times=(1,), content_type="text/plain"),
        encode_run((b"a",), times=(1,), attributes={"k": "v"}),
        seal_run(encode_run((b"a",), times=(1,)), 7),
        encode_run((b"a",), times=(1,)) + b"\x32\x01b",
        b"\x1a\x04\x02\x00\x00\x00\x32\x01a",
    ):
        assert read_plain_run(raw) is None


def test_a_plain_run_has_the_columns_of_any_other_run() -> None:
    found = parse_run(encode_run((b"abc",), times=(5,), durations=(7,)))
    assert (found.times, found.durations, found.lengths) == ((5,), (7,), (3,))
    found = parse_run(encode_run((b"",), times=None))
    assert (found.times, found.durations, found.lengths) == (None, None, (0,))


@pytest.mark.parametrize("time", [None, 5])
@pytest.mark.parametrize("duration", [None, 7])
def test_a_sealed_run_of_one_item_reads_as_its_columns_and_its_seq(time: int | None, duration: int | None) -> None:
    plain = b"".join(plain_run_parts(b"abc", time, duration))
    sealed = seal_run(plain, 9, None if time is not None else (6,))
    assert read_sealed_run(sealed) == (9, (6 if time is None else time, duration, 3))
    assert sealed[sealed_payload_at(sealed, 3) :].startswith(b"abc")
    columns = sealed_columns(sealed)
    assert columns is not None
    assert (columns.first_seq, [*columns.times], [*columns.lengths]) == (9, [6 if time is None else time], [3])


def test_the_payload_of_a_run_with_labels_or_in_another_order_is_not_found() -> None:
    times, lengths, payload = b"\x0a\x08" + bytes(8), b"\x1a\x04\x03\x00\x00\x00", b"\x32\x03abc"
    label = b"\x22\x08a/bcdefg"  # as long as a column
    for raw in (
        times + label + lengths + payload,
        label + times + lengths + payload,
        times + lengths + label + payload,
        times + lengths + payload + label,
        lengths + label + payload + times,
        payload + times + lengths,
        times + payload + lengths,
    ):
        assert sealed_payload_at(seal_run(raw, 7), 3) == 0
    assert sealed_payload_at(seal_run(times + lengths + payload, 7), 4) == 0
    for raw in (label + lengths + payload, lengths + payload + label):
        assert sealed_payload_at(seal_run(raw, 7, (6,)), 3) == 0


def test_other_sealed_runs_are_not_plain() -> None:
    for raw in (
        b"",
        encode_run((b"a",), times=(1,)),
        seal_run(encode_run((b"a",), times=None), 7),
        seal_run(encode_run((b"a", b"b"), times=(1, 2)), 7),
        seal_run(encode_run((b"a",), times=(1,), attributes={"k": "v"}), 7),
        seal_run(encode_run((b"a",), times=(1,)), 7, (2,)),
    ):
        assert read_sealed_run(raw) is None
