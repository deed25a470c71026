"""Cuts parts out of the bytes of sealed runs (`item.proto`). A `RunSlicer` parses its run only once."""

from __future__ import annotations

import struct
import sys
from array import array
from collections.abc import Iterator
from itertools import accumulate
from typing import NamedTuple

from stampede_rt.v1 import item_pb2
from stampede_rt.wire.varints import decode_varint, encode_varint

_TIMES, _DURATIONS, _LENGTHS, _PAYLOADS, _FIRST_SEQ = 1, 2, 3, 6, 7  # fields of ItemRun
_COLUMN_WIDTHS = {_TIMES: 8, _DURATIONS: 8, _LENGTHS: 4}
_COLUMN_CODES = {_TIMES: "q", _DURATIONS: "q", _LENGTHS: "I"}
_LABELS = (4, 5)  # content_type, attributes
_VARINT, _FIXED64, _BYTES = 0, 1, 2  # wire types
_SEQ = struct.Struct("<BQ")
_SEQ_TAG = _FIRST_SEQ << 3 | _FIXED64
_PAYLOADS_TAG = bytes((_PAYLOADS << 3 | _BYTES,))


class _Field(NamedTuple):
    """One field of a message: its number and wire type, and three positions.

    The field begins at `begin`, and its value at `value`. Both end at `end`.
    """

    number: int
    wire_type: int
    begin: int
    value: int
    end: int


class SealedColumns(NamedTuple):
    """The columns of a sealed run: times and durations in nanoseconds (-1: none), and the bytes of each payload."""

    first_seq: int
    times: array[int]
    durations: array[int] | None
    lengths: array[int]


class SealedParts(NamedTuple):
    """The columns of a sealed run, its encoded content type and attributes, and the place of all its payloads."""

    columns: SealedColumns
    labels: bytes
    payloads: slice


def sealed_columns(sealed: bytes | memoryview) -> SealedColumns | None:
    """The columns of a sealed run, without a look at its payloads. None: only a parser of messages can read the run."""
    parts = sealed_parts(sealed)
    return None if parts is None else parts.columns


def sealed_parts(sealed: bytes | memoryview) -> SealedParts | None:
    """The parts of a sealed run. None: as with `sealed_columns`."""
    try:
        if sys.byteorder != "little":
            return None
        if (parts := _ordered_parts(sealed)) is not None:
            return parts
        fields = list(_fields(sealed))
        if not _is_plain(fields) or fields[-1].end != len(sealed):
            return None
        found = {field.number: field for field in fields}
        (first_seq,) = struct.unpack_from("<Q", sealed, found[_FIRST_SEQ].value)
        times, durations, lengths = (_column(sealed, number, found.get(number)) for number in _COLUMN_WIDTHS)
    except (IndexError, ValueError, struct.error):
        return None
    labels = b"".join(sealed[field.begin : field.end] for field in fields if field.number in _LABELS)
    payloads = slice(found[_PAYLOADS].value, found[_PAYLOADS].end) if _PAYLOADS in found else slice(0)
    return SealedParts(SealedColumns(first_seq, times, durations or None, lengths), labels, payloads)


def _ordered_parts(sealed: bytes | memoryview) -> SealedParts | None:
    """The parts of a run without labels, with each field in the place where a host puts it; None for any other run.

    It takes half as long as the general way. Raises IndexError and ValueError for a field that ends too early.
    """
    columns: list[array[int]] = []
    at, payloads = 0, slice(0)
    for number, code in _COLUMN_CODES.items():
        column = array(code)
        if sealed[at] == number << 3 | _BYTES:
            length, begin = decode_varint(sealed, at + 1)
            at = begin + length
            column.frombytes(sealed[begin:at])
        columns.append(column)
    if sealed[at] == _PAYLOADS << 3 | _BYTES:
        length, begin = decode_varint(sealed, at + 1)
        at = begin + length
        payloads = slice(begin, at)
    if sealed[at] != _SEQ_TAG or at + _SEQ.size != len(sealed) or not columns[-1]:
        return None
    times, durations, lengths = columns
    first_seq: int = _SEQ.unpack_from(sealed, at)[1]
    return SealedParts(SealedColumns(first_seq, times, durations or None, lengths), b"", payloads)


def _column(sealed: bytes | memoryview, number: int, field: _Field | None) -> array[int]:
    """A column; empty: the run does not have it."""
    return array(_COLUMN_CODES[number], b"" if field is None else bytes(sealed[field.value : field.end]))


class RunSlicer:
    """One sealed run with the positions of its fields. The object keeps the run's bytes, and 4 bytes for each item."""

    __slots__ = ("_body", "_columns", "_first_seq", "_labels", "_offsets", "_payloads")

    def __init__(self, sealed: bytes) -> None:
        """Parse `sealed`, a run in the form that a host stores."""
        fields = list(_fields(sealed))
        if not _is_plain(fields):  # for example, a column is in several pieces; the run is then encoded again
            sealed = item_pb2.ItemRun.FromString(sealed).SerializeToString()
            fields = list(_fields(sealed))
        self._body = sealed
        found = {field.number: field for field in fields}
        self._columns = [(n, found[n].value, width) for n, width in _COLUMN_WIDTHS.items() if n in found]
        self._labels = [(field.begin, field.end) for field in fields if field.number in _LABELS]
        self._payloads = found[_PAYLOADS].value if _PAYLOADS in found else len(sealed)
        # Both fields are there: a run has at least one item, and seqs start at 1.
        seq, lengths = found[_FIRST_SEQ], found[_LENGTHS]
        self._first_seq: int = struct.unpack_from("<Q", sealed, seq.value)[0]
        counts = struct.unpack_from(f"<{(lengths.end - lengths.value) // 4}I", sealed, lengths.value)
        self._offsets = memoryview(struct.pack(f"<{len(counts) + 1}I", *accumulate(counts, initial=0))).cast("I")

    def cut(self, lo: int, hi: int, *, without_payloads: bool = False) -> bytes:
        """Return a run with the items from index `lo` up to `hi`, exclusive."""
        body, parts = self._body, []
        for number, begin, width in self._columns:
            parts.append(bytes((number << 3 | _BYTES,)) + encode_varint((hi - lo) * width))
            parts.append(body[begin + lo * width : begin + hi * width])
        parts += [body[begin:end] for begin, end in self._labels]
        start, end = self._payloads + self._offsets[lo], self._payloads + self._offsets[hi]
        if start < end and not without_payloads:
            parts += (_PAYLOADS_TAG, encode_varint(end - start), body[start:end])
        parts.append(_SEQ.pack(_SEQ_TAG, self._first_seq + lo))
        return b"".join(parts)

    def plain_payload(self, at: int) -> bytes | None:
        """Return the payload of the item at an index; None if the run has a content type or attributes."""
        if self._labels:
            return None
        return self._body[self._payloads + self._offsets[at] : self._payloads + self._offsets[at + 1]]


def slice_run(sealed: bytes, lo: int, hi: int, *, without_payloads: bool = False) -> bytes:
    """Return one part of a sealed run. For several parts use a `RunSlicer`."""
    return RunSlicer(sealed).cut(lo, hi, without_payloads=without_payloads)


def _is_plain(fields: list[_Field]) -> bool:
    """Whether all columns are packed, and each field except content type and attributes comes only once."""
    numbers = [field.number for field in fields if field.number not in _LABELS]
    packed = all(field.wire_type == _BYTES for field in fields if field.number in _COLUMN_WIDTHS)
    return packed and len(numbers) == len(set(numbers)) and {_LENGTHS, _FIRST_SEQ} <= set(numbers)


def _fields(message: bytes | memoryview) -> Iterator[_Field]:
    """Yield the fields of a valid ItemRun message, in their order."""
    at = 0
    while at < len(message):
        begin = at
        tag, at = decode_varint(message, at)
        value, wire_type = at, tag & 7
        if wire_type == _BYTES:
            length, value = decode_varint(message, at)
            at = value + length
        elif wire_type == _VARINT:
            _, at = decode_varint(message, at)
        else:
            at += 8 if wire_type == _FIXED64 else 4
        yield _Field(tag >> 3, wire_type, begin, value, at)
