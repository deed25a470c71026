"""Item runs: columns that a producer encodes once, and that a host stores and sends as they are (`item.proto`).

A host appends its own fields to the producer's bytes. The result is again a valid run, because a protobuf parser keeps
the last value of a scalar field and concatenates repeated fields.
"""

from __future__ import annotations

import struct
import sys
from array import array
from collections.abc import Mapping, Sequence
from itertools import accumulate
from typing import NamedTuple

from google.protobuf.message import DecodeError
from google.protobuf.unknown_fields import UnknownFieldSet

from stampede_rt.errors import ItemTooLarge, MalformedRun
from stampede_rt.v1 import item_pb2
from stampede_rt.values.answers import ABSENT
from stampede_rt.values.payloads import ATTRIBUTES_BYTES_MAX, ITEM_BYTES_MAX
from stampede_rt.wire.delivered import RUN_ITEMS_MAX
from stampede_rt.wire.plain_runs import plain_run_parts, read_plain_run
from stampede_rt.wire.varints import decode_varint, encode_varint

RUN_BYTES_MAX = 224 * 1024  # a full run with its columns fits into one message to a host
CONTENT_TYPE_BYTES_MAX = 255

_FIRST_SEQ = struct.Struct("<BQ")
_FIRST_SEQ_TAG = 7 << 3 | 1  # field 7, fixed64
_TIMES_TAG = 1 << 3 | 2  # field 1, packed
_ORIGIN_TAG = bytes((8 << 3 | 2,))
_PAYLOADS_TAG = 6 << 3 | 2
_TAGS_BEFORE_PAYLOADS = frozenset(field << 3 | 2 for field in range(1, 6))
_FIXED_FIELD_BYTES = {1 << 3 | 1: 9, 2 << 3 | 1: 9, 3 << 3 | 5: 5}  # one entry of a column that is not packed, by tag
_PACKED_COLUMNS = ((1 << 3 | 2, "q"), (2 << 3 | 2, "q"), (3 << 3 | 2, "I"))  # times, durations and lengths
_COLUMN_TAGS = frozenset(field << 3 | 2 for field in range(1, 4))
_SEALS_OF_ONE = (_FIRST_SEQ.size, _FIRST_SEQ.size + 10)  # bytes that a host appends to a run of one item
_PIECE_BYTES_MIN = 1024  # shorter payloads, on average, become one piece
_SHORT_BYTES = 4096  # shorter runs are parsed whole, which is faster than a look for their payloads
_FIELDS_LOOKED_AT_MAX = 4096
# The bytes of one item in three columns, if the encoder did not pack them and each entry has a tag.
_COLUMN_BYTES_MAX = 23
_ATTRIBUTE_FRAMING_BYTES_MAX = 16
_FRAMING_BYTES_MAX = 64
_REST_BYTES_MAX = (
    RUN_ITEMS_MAX * _COLUMN_BYTES_MAX
    + CONTENT_TYPE_BYTES_MAX
    + ATTRIBUTES_BYTES_MAX * (1 + _ATTRIBUTE_FRAMING_BYTES_MAX)
    + _FRAMING_BYTES_MAX
)
"""The most bytes of a run without its payloads. A longer run that does not end with its payloads is refused.

A parser would copy all of it in one step, up to 20 MiB, while all other callers wait.
"""


class RunColumns(NamedTuple):
    """The columns of a producer's run, with one entry for each item. A duration of -1 means no duration.

    If `times` is None, the host gives the items their time. If `durations` is None, no item has a duration.
    """

    times: Sequence[int] | None
    durations: Sequence[int] | None
    lengths: Sequence[int]


def encode_run(
    payloads: Sequence[bytes],
    *,
    times: Sequence[int] | None,
    durations: Sequence[int] | None = None,
    content_type: str = "",
    attributes: Mapping[str, str] | None = None,
) -> bytes:
    """Return the bytes of a run in the form that a producer sends.

    `times` None: the host gives the items their time.
    """
    return b"".join(
        run_parts(payloads, times=times, durations=durations, content_type=content_type, attributes=attributes)
    )


def run_parts(
    payloads: Sequence[bytes],
    *,
    times: Sequence[int] | None,
    durations: Sequence[int] | None = None,
    content_type: str = "",
    attributes: Mapping[str, str] | None = None,
) -> list[bytes]:
    """Return the bytes of a run in pieces. Each payload is one of the pieces, unless several short ones are joined.

    The caller joins the pieces together with other bytes, so that each payload is copied only once. A copy of 300 KB
    takes a third of the time of a round trip. Short payloads are one piece, because each step that counts the bytes
    or passes on the pieces would take longer than the copy.
    """
    if len(payloads) == 1 and not (content_type or attributes):
        time, duration = times[0] if times else None, durations[0] if durations else None
        return plain_run_parts(payloads[0], time, duration)
    lengths = [len(payload) for payload in payloads]
    columns = item_pb2.ItemRun(
        time_unix_nano=times,
        duration_nanos=durations,
        payload_length_bytes=lengths,
        content_type=content_type,
        attributes=attributes,
    )
    payload_bytes = sum(lengths)
    begin = columns.SerializeToString(), bytes((_PAYLOADS_TAG,)), encode_varint(payload_bytes)
    if len(payloads) > 1 and payload_bytes < _PIECE_BYTES_MIN * len(payloads):
        return [b"".join((*begin, *payloads))]
    return [b"".join(begin), *payloads]


def parse_run(raw: bytes | memoryview) -> RunColumns:
    """Check a producer's run and return its columns. Raises MalformedRun, ItemTooLarge.

    Copies at most _REST_BYTES_MAX.
    """
    if (plain := _plain_columns(raw)) is not None:
        return plain
    if (packed := _packed_columns(raw)) is not None:
        return packed
    columns_end, payload_bytes = _payloads_of(raw)
    if columns_end > _REST_BYTES_MAX:
        raise _too_long(len(raw))
    try:
        run = item_pb2.ItemRun.FromString(bytes(raw[:columns_end]))
    except DecodeError as error:
        raise MalformedRun("the run is not a valid ItemRun message; encode it as item.proto says") from error
    if not payload_bytes:
        payload_bytes = len(run.payloads)
    times, durations, lengths = list(run.time_unix_nano), list(run.duration_nanos), list(run.payload_length_bytes)
    _check_columns(times, durations, lengths, payload_bytes)
    _check_labels(run)
    _check_length(raw, run, items=len(lengths), payload_bytes=sum(lengths))
    return RunColumns(times or None, durations or None, lengths)


def _plain_columns(raw: bytes | memoryview) -> RunColumns | None:
    """Return the columns of a valid run of one item without labels; None for any other run."""
    plain = read_plain_run(raw)
    if plain is None or plain.length > ITEM_BYTES_MAX:
        return None
    time, duration, length = plain
    if duration is not None and duration < ABSENT:
        return None
    return RunColumns(None if time is None else (time,), None if duration is None else (duration,), (length,))


def _packed_columns(raw: bytes | memoryview) -> RunColumns | None:
    """Return the checked columns of a run without labels; None if only protobuf can read or judge the run.

    The fields must come once each, packed, in the order of their numbers, and end with the payloads. So no byte belongs
    to another field. Protobuf takes five times as long for a run of 256 items.
    """
    columns, at = list[list[int]](), 0
    try:
        for tag, code in _PACKED_COLUMNS if sys.byteorder == "little" else ():
            column = array(code)
            if raw[at] == tag:
                length, begin = decode_varint(raw, at + 1)
                at = begin + length
                if length > RUN_ITEMS_MAX * column.itemsize:
                    return None
                column.frombytes(raw[begin:at])
            columns.append(column.tolist())
        payload_bytes, begin = decode_varint(raw, at + 1)
        if raw[at] != _PAYLOADS_TAG or begin + payload_bytes != len(raw):
            return None
        times, durations, lengths = columns
    except (IndexError, ValueError):  # a field ends too early, or the machine has another byte order
        return None
    _check_columns(times, durations, lengths, payload_bytes)
    return RunColumns(times or None, durations or None, lengths)


def _payloads_of(raw: bytes | memoryview) -> tuple[int, int]:
    """Return the end of the fields before the payloads, and the length of the payloads.

    So the parser need not copy the payloads. Returns the whole length and 0 for a short run, and for a run whose last
    field is not the payloads: the caller parses such a run whole, or refuses it.
    """
    at, size = 0, len(raw)
    try:
        for _ in range(_FIELDS_LOOKED_AT_MAX if size > _SHORT_BYTES else 0):
            tag = raw[at]
            if tag in _FIXED_FIELD_BYTES:
                at += _FIXED_FIELD_BYTES[tag]
                continue
            length, value = decode_varint(raw, at + 1)
            if tag == _PAYLOADS_TAG:
                return (at, length) if value + length == size else (size, 0)
            if tag not in _TAGS_BEFORE_PAYLOADS:
                break
            at = value + length
    except IndexError:  # it ends within a field: the parser raises the error
        pass
    return size, 0


def _check_columns(times: list[int], durations: list[int], lengths: list[int], payload_bytes: int) -> None:
    items = len(lengths)
    total = sum(lengths)
    if not items:
        raise MalformedRun("the run holds no items; write one entry of payload_length_bytes for each item")
    if len(times) not in (0, items) or len(durations) not in (0, items):
        raise MalformedRun(
            f"the run's columns disagree: {items} lengths, {len(times)} times, {len(durations)} durations; "
            "a column has one entry for each item or is left out"
        )
    if total != payload_bytes:
        raise MalformedRun(
            f"the run's lengths add up to {total} bytes, but its payloads have {payload_bytes}; write the length "
            "of each payload"
        )
    if items > RUN_ITEMS_MAX or (items > 1 and total > RUN_BYTES_MAX):
        raise MalformedRun(
            f"the run holds {items} items and {total} bytes; a run of several items ends at {RUN_ITEMS_MAX} items "
            f"and {RUN_BYTES_MAX} bytes: split it"
        )
    if durations and min(durations) < ABSENT:
        raise MalformedRun(f"the run holds a duration of {min(durations)} ns; it is 0 or more, or -1 for none")
    if total > ITEM_BYTES_MAX:
        raise ItemTooLarge(f"the item has {total} bytes; one item has at most {ITEM_BYTES_MAX}: split it")


def _check_length(raw: bytes | memoryview, run: item_pb2.ItemRun, *, items: int, payload_bytes: int) -> None:
    """Refuse a run in which a field comes twice. The parser keeps the last value, but the host would keep both."""
    attributes_bytes = attributes_length_bytes(run.attributes) + len(run.attributes) * _ATTRIBUTE_FRAMING_BYTES_MAX
    labels_bytes = len(run.content_type.encode()) + attributes_bytes
    if len(raw) > payload_bytes + items * _COLUMN_BYTES_MAX + labels_bytes + _FRAMING_BYTES_MAX:
        raise _too_long(len(raw))


def _too_long(length_bytes: int) -> MalformedRun:
    return MalformedRun(
        f"the run has {length_bytes} bytes, more than its fields take; write each field of item.proto once, and the "
        "payloads last"
    )


def _check_labels(run: item_pb2.ItemRun) -> None:
    if run.first_seq or run.HasField("origin") or len(UnknownFieldSet(run)):
        raise MalformedRun("the run sets first_seq, origin or fields that item.proto does not have; leave them out")
    if len(run.content_type.encode()) > CONTENT_TYPE_BYTES_MAX:
        raise MalformedRun(f"the run's content type is longer than {CONTENT_TYPE_BYTES_MAX} bytes; shorten it")
    if run.attributes and attributes_length_bytes(run.attributes) > ATTRIBUTES_BYTES_MAX:
        raise MalformedRun(
            f"the run's attributes are longer than {ATTRIBUTES_BYTES_MAX} bytes in all; put large data into the payload"
        )


def attributes_length_bytes(attributes: Mapping[str, str]) -> int:
    """Return the sum of the lengths of all keys and values, in bytes of UTF-8."""
    return sum(len(key.encode()) + len(value.encode()) for key, value in attributes.items())


def seal_run(raw: bytes | memoryview, first_seq: int, stamped_times: Sequence[int] | None = None) -> bytes:
    """Return a producer's run with the host's fields appended: `first_seq`, and `stamped_times` if it has no times."""
    seq = _FIRST_SEQ.pack(_FIRST_SEQ_TAG, first_seq)
    if stamped_times is None:
        return b"".join((raw, seq))
    items, time = len(stamped_times), stamped_times[0]
    if stamped_times.count(time) == items:  # nearly always; it takes a tenth of the time
        column = struct.pack("<q", time) * items
    else:
        column = struct.pack(f"<{items}q", *stamped_times)
    return b"".join((raw, bytes((_TIMES_TAG,)), encode_varint(len(column)), column, seq))


def plain_payload_at(sealed: bytes, payload_bytes: int) -> int:
    """Return where the payload begins in a sealed run of one item.

    Returns 0 if the item has a content type, attributes or an empty payload, or if the fields come in an unusual order.
    """
    at = 0
    while at < len(sealed):
        tag = sealed[at]
        if tag in _FIXED_FIELD_BYTES:
            at += _FIXED_FIELD_BYTES[tag]
            continue
        length, value = decode_varint(sealed, at + 1)
        if tag == _PAYLOADS_TAG:
            rest_bytes = len(sealed) - value - length
            return value if length == payload_bytes and rest_bytes in _SEALS_OF_ONE else 0
        if tag not in _COLUMN_TAGS:
            return 0
        at = value + length
    return 0


def origin_field(origin: bytes) -> bytes:
    """Return the field that a host appends to the sealed run of a dead letter.

    `origin`: an encoded DeadLetterOrigin.
    """
    return b"".join((_ORIGIN_TAG, encode_varint(len(origin)), origin))


def select_items(raw: bytes | memoryview, indexes: Sequence[int]) -> bytes:
    """Return a producer's run with only the items at `indexes`. A host calls this when it refuses the other items."""
    run = item_pb2.ItemRun.FromString(bytes(raw))
    offsets = [0, *accumulate(run.payload_length_bytes)]
    return encode_run(
        [run.payloads[offsets[i] : offsets[i + 1]] for i in indexes],
        times=[run.time_unix_nano[i] for i in indexes] if run.time_unix_nano else None,
        durations=[run.duration_nanos[i] for i in indexes] if run.duration_nanos else None,
        content_type=run.content_type,
        attributes=dict(run.attributes),
    )
