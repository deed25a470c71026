"""Reads the responses of subscriptions. The payloads of a long response stay where they are until items are made.

Protobuf copies the payloads of a response twice before a program has them. Here each item copies its own payload once.
"""

from __future__ import annotations

import struct
from typing import NamedTuple

from google.protobuf.message import DecodeError

from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.v1 import item_pb2
from stampede_rt.wire.varints import decode_varint

LONG_BYTES = 4096
"""Protobuf decodes shorter responses, because it is faster for them."""
_RUNS_TAG = 3 << 3 | 2  # SubscribeResponse.runs and FeedResponse.runs
_RUN_TAG = 1 << 3 | 2  # DeliveredRun.run
_NEXT_TIME = struct.Struct("<Bq")
_NEXT_TIME_TAG = 2 << 3 | 1  # DeliveredRun.next_time_unix_nano
_VARINT, _BYTES = 0, 2  # wire types
_FIXED_BYTES = {1: 8, 5: 4}


class LongRun(NamedTuple):
    """A delivered run, not decoded. `next_time`: see `DecodedRun`."""

    encoded: memoryview
    next_time: int | None


class SubscribeAnswer(NamedTuple):
    """A response of a subscription. Its runs are in `fields`, or in `runs` if the response is long."""

    fields: pb.SubscribeResponse
    runs: list[LongRun]


def read_answer(raw: bytes | memoryview) -> SubscribeAnswer:
    """Decode a response. The runs of a long one are views of `raw`. Raises DecodeError."""
    if len(raw) < LONG_BYTES:
        return SubscribeAnswer(pb.SubscribeResponse.FromString(raw), [])  # type: ignore[arg-type]
    others, runs = split_runs(raw)
    return SubscribeAnswer(pb.SubscribeResponse.FromString(others), runs)


def split_runs(raw: bytes | memoryview) -> tuple[bytes, list[LongRun]]:
    """The other fields of a SubscribeResponse or FeedResponse, and its runs, which are views of `raw`. Raises
    DecodeError.
    """
    view, at, others_at = memoryview(raw), 0, 0
    others, runs = list[memoryview](), list[LongRun]()
    try:
        while at < len(view):
            begin, (value, end) = at, _field_at(view, at)
            at = end
            if view[begin] == _RUNS_TAG:
                runs.append(_long_run(view[value:end]))
                others.append(view[others_at:begin])
                others_at = end
    except (IndexError, struct.error) as error:
        raise DecodeError("the response ends within a field") from error
    if at != len(view):
        raise DecodeError("a field is longer than the response")
    return b"".join((*others, view[others_at:])), runs


def _field_at(view: memoryview, at: int) -> tuple[int, int]:
    """Return where the value of a field begins, and where it ends."""
    tag, value = decode_varint(view, at)
    kind = tag & 7
    if kind == _BYTES:
        length, value = decode_varint(view, value)
        return value, value + length
    if kind == _VARINT:
        return value, decode_varint(view, value)[1]
    if kind not in _FIXED_BYTES:
        raise DecodeError(f"a field has the wire type {kind}")
    return value, value + _FIXED_BYTES[kind]


def _long_run(view: memoryview) -> LongRun:
    """Return a delivered run. A run is encoded anew if its fields do not come in the order of their numbers."""
    if view[0] == _RUN_TAG:
        length, begin = decode_varint(view, 1)
        rest = view[begin + length :]
        if begin + length == len(view):
            return LongRun(view[begin:], None)
        if len(rest) == _NEXT_TIME.size and rest[0] == _NEXT_TIME_TAG:
            return LongRun(view[begin : begin + length], _NEXT_TIME.unpack(rest)[1])
    one = item_pb2.DeliveredRun.FromString(bytes(view))
    next_time = one.next_time_unix_nano if one.HasField("next_time_unix_nano") else None
    return LongRun(memoryview(one.run.SerializeToString()), next_time)
