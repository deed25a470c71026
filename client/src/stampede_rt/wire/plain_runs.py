"""Plain runs: of one item without attributes and content type. Protobuf would take longer for them. Pure."""

from __future__ import annotations

import functools
import struct
from typing import NamedTuple

from stampede_rt.wire.varints import decode_varint, encode_varint

_COLUMN = struct.Struct("<BBq")  # the tag and the length of a packed column, and its only number
_LENGTHS = struct.Struct("<BBIB")  # the same for the column of lengths, and then the tag of the payloads
_TIMES_TAG = 1 << 3 | 2
_DURATIONS_TAG = 2 << 3 | 2
_LENGTHS_TAG = 3 << 3 | 2
_PAYLOADS_TAG = 6 << 3 | 2
_SEQ = struct.Struct("<BQ")
_SEQ_TAG = 7 << 3 | 1
_PAYLOAD_BYTES = struct.Struct("<I")
# Layouts of stored plain runs. Each entry has: the first bytes of the last column before the column of lengths; the
# position of that column; the position of the column of lengths; and the number of bytes after the payload.
_LAYOUTS = (
    (b"", 0, 0, _COLUMN.size + _SEQ.size),
    (bytes((_TIMES_TAG, 8)), 0, _COLUMN.size, _SEQ.size),
    (bytes((_DURATIONS_TAG, 8)), 0, _COLUMN.size, _COLUMN.size + _SEQ.size),
    (bytes((_DURATIONS_TAG, 8)), _COLUMN.size, 2 * _COLUMN.size, _SEQ.size),
)


class PlainRun(NamedTuple):
    """The columns of a plain run. `time`, `duration`: None if the run lacks it. `length`: the length of the payload."""

    time: int | None
    duration: int | None
    length: int


def plain_run_parts(payload: bytes, time: int | None, duration: int | None) -> list[bytes]:
    """Return the bytes of a plain run in pieces.

    The last piece is the payload. Protobuf would make the same bytes. None leaves a column out.
    """
    head = _lengths_of(len(payload))
    if duration is not None:
        head = _COLUMN.pack(_DURATIONS_TAG, 8, duration) + head
    if time is not None:
        head = _COLUMN.pack(_TIMES_TAG, 8, time) + head
    return [head, payload]


def read_plain_run(raw: bytes | memoryview, run_bytes: int | None = None) -> PlainRun | None:
    """Return the columns of a plain run if its fields come in the order of their numbers; None for all other bytes.

    `run_bytes`: the length of the run, if `raw` has only the bytes before its payload; None: `raw` is the run.
    """
    try:
        at, time = _number_at(raw, 0, _TIMES_TAG)
        at, duration = _number_at(raw, at, _DURATIONS_TAG)
        *tags, length, payloads_tag = _LENGTHS.unpack_from(raw, at)
        payload_bytes, begin = decode_varint(raw, at + _LENGTHS.size)
    except (IndexError, struct.error):  # the run ends within a field
        return None
    is_plain = tags == [_LENGTHS_TAG, 4] and payloads_tag == _PAYLOADS_TAG
    if not is_plain or length != payload_bytes or begin + length != (len(raw) if run_bytes is None else run_bytes):
        return None
    return PlainRun(time, duration, length)


def read_sealed_run(sealed: bytes) -> tuple[int, PlainRun] | None:
    """The seq and the columns of a plain run with the fields of a host (`seal_run`). None for all other bytes."""
    try:
        at, time = _number_at(sealed, 0, _TIMES_TAG)
        at, duration = _number_at(sealed, at, _DURATIONS_TAG)
        (length,) = _PAYLOAD_BYTES.unpack_from(sealed, at + 2)
        end = len(sealed) - _SEQ.size
        tag, seq = _SEQ.unpack_from(sealed, end)
        if time is None:
            end -= _COLUMN.size
            times_tag, size, time = _COLUMN.unpack_from(sealed, end)
            if times_tag != _TIMES_TAG or size != 8:
                return None
    except (IndexError, struct.error):  # the run ends within a field
        return None
    lengths = _lengths_of(length)
    is_plain = sealed.startswith(lengths, at) and at + len(lengths) + length == end
    return (seq, PlainRun(time, duration, length)) if is_plain and tag == _SEQ_TAG else None


def sealed_payload_at(sealed: bytes, payload_bytes: int) -> int:
    """Where the payload begins in a stored run of one item, if the run is plain; otherwise 0.

    Faster than `read_sealed_run`, for a caller that knows the columns. A stored run always has a time and a seq. So its
    length says that it has no other fields.
    """
    lengths = _lengths_of(payload_bytes)
    for begin, place, at, behind in _LAYOUTS:
        if sealed.startswith(lengths, at) and sealed.startswith(begin, place):
            payload_at = at + len(lengths)
            return payload_at if payload_at + payload_bytes + behind == len(sealed) else 0
    return 0


@functools.lru_cache(maxsize=256)
def _lengths_of(payload_bytes: int) -> bytes:
    """The bytes of a plain run from its column of lengths up to its payload."""
    return _LENGTHS.pack(_LENGTHS_TAG, 4, payload_bytes, _PAYLOADS_TAG) + encode_varint(payload_bytes)


def _number_at(raw: bytes | memoryview, at: int, tag: int) -> tuple[int, int | None]:
    """Return the only number of the column at `at`, after the position after it; None if another field is there."""
    if raw[at] != tag or raw[at + 1] != 8:
        return at, None
    return at + _COLUMN.size, _COLUMN.unpack_from(raw, at)[2]
