"""The responses of subscriptions: the decoder of long ones gives the same items as protobuf, and damaged
ones give errors.
"""

from __future__ import annotations

from contextlib import suppress

import pytest
from google.protobuf.message import DecodeError
from hypothesis import given, strategies

from stampede_rt.errors import StampedeError
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.v1 import item_pb2
from stampede_rt.values.model import Item
from stampede_rt.wire.decoding import ItemDecoder
from stampede_rt.wire.long_answers import LONG_BYTES, LongRun, read_answer
from stampede_rt.wire.runs import encode_run, seal_run

DECODER = ItemDecoder(incarnation=7, content_type="text/plain", payloads=True)
runs_of_items = strategies.lists(
    strategies.tuples(
        strategies.lists(
            strategies.tuples(strategies.integers(0, 50), strategies.integers(-1, 20), strategies.binary(max_size=30)),
            min_size=1,
        ),
        strategies.booleans(),
        strategies.sampled_from([None, {"lens": "wide", "k": ""}]),
        strategies.sampled_from(["", "image/raw"]),
        strategies.one_of(strategies.none(), strategies.integers(0, 100)),
    ),
    min_size=1,
    max_size=4,
)


def response_of(runs: object, first_seq: int = 5) -> pb.SubscribeResponse:
    """A response of LONG_BYTES or more with these runs. Each run gets one more item, which is long."""
    response = pb.SubscribeResponse(cursor=pb.SubscriptionCursor(incarnation=7, next_seq=9), repair_next_seq=3)
    for columns, stamped, attributes, content_type, next_time in runs:  # type: ignore[attr-defined]
        times, durations, payloads = zip(*columns, (60, -1, bytes(LONG_BYTES)), strict=True)
        labels = {"attributes": attributes, "content_type": content_type}
        raw = encode_run(payloads, times=None if stamped else times, durations=durations, **labels)
        run = item_pb2.ItemRun.FromString(seal_run(raw, first_seq, times if stamped else None))
        response.runs.append(item_pb2.DeliveredRun(run=run, next_time_unix_nano=next_time))
    return response


def items_in(raw: bytes | memoryview) -> list[Item]:
    fields, runs = read_answer(raw)
    decoded = DECODER.decode_long(runs) if runs else DECODER.decode_each(fields.runs)
    return [item for run in decoded for item in run]


@given(runs_of_items)
def test_a_long_response_gives_the_items_that_protobuf_gives(runs: object) -> None:
    response = response_of(runs)
    raw = response.SerializeToString()
    fields, found = read_answer(memoryview(raw))
    assert len(found) == len(response.runs)
    assert [[*map(tuple, run)] for run in DECODER.decode_long(found)] == [
        [*map(tuple, run)] for run in DECODER.decode_each(response.runs)
    ]
    response.ClearField("runs")
    assert fields == response


def test_items_keep_their_payloads_when_the_memory_of_the_response_is_used_again() -> None:
    raw = response_of([([(1, -1, b"first"), (2, -1, b"second")], False, None, "", None)]).SerializeToString()
    buffer = bytearray(raw)
    items = items_in(memoryview(buffer))
    buffer[:] = bytes(len(buffer))
    buffer.append(0)  # possible only if no item has a view of the buffer
    assert [item.payload for item in items] == [b"first", b"second", bytes(LONG_BYTES)]
    assert all(type(item.payload) is bytes for item in items)


@given(runs_of_items, strategies.data())
def test_a_damaged_response_gives_an_error_or_other_items_and_no_defect(
    runs: object, data: strategies.DataObject
) -> None:
    raw = bytearray(response_of(runs).SerializeToString())
    if data.draw(strategies.booleans()):
        del raw[data.draw(strategies.integers(0, len(raw) - 1)) :]
    for _ in range(3):
        if raw:
            raw[data.draw(strategies.integers(0, min(200, len(raw) - 1)))] = data.draw(strategies.integers(0, 255))
    with suppress(DecodeError, StampedeError):
        items_in(bytes(raw))


def test_a_run_in_another_order_or_in_parts_gives_its_items_too() -> None:
    run = item_pb2.ItemRun.FromString(seal_run(encode_run([b"a" * 5000, b"b"], times=[1, 2]), 5))
    encoded = run.SerializeToString()
    halves = item_pb2.ItemRun(time_unix_nano=[1]).SerializeToString(), item_pb2.ItemRun(time_unix_nano=[2])
    run.ClearField("time_unix_nano")
    parts = halves[0] + run.SerializeToString() + halves[1].SerializeToString()
    next_time_first = b"\x11" + (9).to_bytes(8, "little")
    for one, behind in ((encoded, b""), (parts, b""), (encoded, next_time_first)):
        delivered = behind + b"\x0a" + _length(len(one)) + one
        raw = b"\x1a" + _length(len(delivered)) + delivered
        items = items_in(raw)
        assert [(item.time, item.seq, item.payload) for item in items] == [(1, 5, b"a" * 5000), (2, 6, b"b")]
        assert items[-1].end == (9 if behind else None)


def test_columns_that_disagree_are_refused() -> None:
    short = item_pb2.ItemRun(time_unix_nano=[1, 2], payload_length_bytes=[5, 6], payloads=b"only ten b", first_seq=5)
    for run in (short, item_pb2.ItemRun(first_seq=5), item_pb2.ItemRun(payload_length_bytes=[0], first_seq=5)):
        with pytest.raises(StampedeError, match="defective"):
            DECODER.decode_long([LongRun(memoryview(run.SerializeToString()), None)])


def _length(value: int) -> bytes:
    return bytes((value & 0x7F | 0x80, value >> 7)) if value > 0x7F else bytes((value,))
