"""Encodes the messages that carry runs, without the generated classes.

The host copies the stored bytes of a whole run once, into the message, and does not parse them. The result equals the
serialized messages of `raw_run.proto`. The tests compare the two.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.v1 import error_pb2
from stampede_rt.wire.run_slices import RunSlicer
from stampede_rt_channel_host.core.channel import ColumnRun, DeliveredSlice, ReadAnswer, Slice, drained

MESSAGE_BYTES_MAX = 2**20  # of runs in one message; a message with a single run may be larger
MESSAGE_RUNS_MAX = 512  # a limit, so that a message of many small runs is made within two milliseconds

_LENGTH_DELIMITED = 2
_RUN = bytes((1 << 3 | _LENGTH_DELIMITED,))  # RawDeliveredRun.run
_NEXT_TIME = struct.Struct("<Bq")
_NEXT_TIME_TAG = 2 << 3 | 1  # RawDeliveredRun.next_time_unix_nano, sfixed64
_CALL_ID = bytes((1 << 3,))  # RawGetResponse.call_id, varint
_GET_RUNS = bytes((2 << 3 | _LENGTH_DELIMITED,))
_GET_SUMMARY = bytes((3 << 3 | _LENGTH_DELIMITED,))
_GET_ERROR = bytes((4 << 3 | _LENGTH_DELIMITED,))
_SUBSCRIBE_RUNS = bytes((3 << 3 | _LENGTH_DELIMITED,))


class EncodedMessage(NamedTuple):
    """One message of an answer, and the number of payload bytes in it. `is_last`: the answer has no further message."""

    encoded: bytes
    payload_bytes: int
    is_last: bool


def run_bytes(part: Slice, *, without_payloads: bool) -> bytes:
    """The encoded run of a slice. A slice that covers its whole run gives the stored bytes as they are."""
    run = part.run
    if part.is_whole and not without_payloads:
        return run.body
    slicer = run.slicer if isinstance(run, ColumnRun) else None
    if slicer is None:
        slicer = RunSlicer(run.body)
        if isinstance(run, ColumnRun):
            run.slicer = slicer
    return slicer.cut(part.lo, part.hi, without_payloads=without_payloads)


def get_responses(
    call_id: int, answer: ReadAnswer, summary: pb.GetSummary, *, without_payloads: bool
) -> Iterator[EncodedMessage]:
    """Yield the messages that answer a get. The last message has the summary."""
    head = _CALL_ID + _varint(call_id) if call_id else b""  # proto3 leaves out fields of value zero
    parts, runs, size, payload_bytes = [head], 0, 0, 0
    next_time, rest = answer.next_time, drained(answer.slices)
    following = next(rest, None)
    while (part := following) is not None:
        following = next(rest, None)
        body = run_bytes(part, without_payloads=without_payloads)
        if runs and (size + len(body) > MESSAGE_BYTES_MAX or runs >= MESSAGE_RUNS_MAX):
            yield EncodedMessage(b"".join(parts), payload_bytes, False)
            parts, runs, size, payload_bytes = [head], 0, 0, 0
        _add_run(parts, _GET_RUNS, body, None if following else next_time)
        runs += 1
        size += len(body)
        payload_bytes += 0 if without_payloads else part.payload_bytes
    encoded = summary.SerializeToString()
    parts += (_GET_SUMMARY, _varint(len(encoded)), encoded)
    yield EncodedMessage(b"".join(parts), payload_bytes, True)


def get_error(call_id: int, error: error_pb2.Error) -> Iterator[EncodedMessage]:
    """Yield the single message that ends a get with an error."""
    encoded = error.SerializeToString()
    head = _CALL_ID + _varint(call_id) if call_id else b""
    yield EncodedMessage(b"".join((head, _GET_ERROR, _varint(len(encoded)), encoded)), 0, True)


class SharedMessages:
    """The last encoded message of a channel's subscriptions. All readers of the same items get the same bytes.

    Keeps one message at most.
    """

    __slots__ = ("_key", "_message")

    def __init__(self) -> None:
        self._key: tuple[Sequence[DeliveredSlice], bytes, bool] | None = None  # the arguments that made the message
        self._message: EncodedMessage | None = None

    def encode(
        self, slices: Sequence[DeliveredSlice], about: bytes, *, without_payloads: bool, readers: int
    ) -> EncodedMessage:
        """A SubscribeResponse with the runs `slices` and the encoded fields `about`.

        Keeps the message if `readers`, the number of the channel's subscriptions, is above 1.
        """
        key = (slices, about, without_payloads)
        if key == self._key and self._message is not None:  # runs compare by identity
            return self._message
        payload_bytes = 0 if without_payloads else sum(one.slice.payload_bytes for one in slices)
        message = EncodedMessage(_subscribe_response(slices, about, without_payloads), payload_bytes, False)
        self._key, self._message = (key, message) if readers > 1 else (None, None)
        return message


def _subscribe_response(slices: Sequence[DeliveredSlice], about: bytes, without_payloads: bool) -> bytes:
    """The encoded response. Its fields need no order, because protobuf accepts any order on the wire."""
    parts = [about]
    for part, next_time in slices:
        _add_run(parts, _SUBSCRIBE_RUNS, run_bytes(part, without_payloads=without_payloads), next_time)
    return b"".join(parts)


def _add_run(parts: list[bytes], tag: bytes, body: bytes, next_time: int | None) -> None:
    length = _varint(len(body))
    end = b"" if next_time is None else _NEXT_TIME.pack(_NEXT_TIME_TAG, next_time)
    parts += (tag, _varint(1 + len(length) + len(body) + len(end)), _RUN, length, body, end)


def _varint(value: int) -> bytes:
    if value < 0x80:
        return _SMALL[value]
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


_SMALL = [bytes((value,)) for value in range(0x80)]
