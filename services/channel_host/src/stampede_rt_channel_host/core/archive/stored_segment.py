"""A closed segment as an object of an object store: its name, and the index after its bytes. Pure.

The name has all facts that the host keeps in memory about a segment, so that a listing of names opens an archive. The
object has the bytes of the segment, and after them an index of its blocks, so that a reader finds a block with one
request.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Sequence
from typing import NamedTuple
from zlib import crc32

from stampede_rt_channel_host.core.archive.block import ADVANCES, HEAD_BYTES, decode_head, encode_head
from stampede_rt_channel_host.core.archive.segment import PlacedBlock, Segment
from stampede_rt_channel_host.core.channel.item_keys import ItemKey

NUMBERS_PER_EPOCH = 10**9
"""The number of a segment is the epoch of its channel times this, and a count from 1 on."""
SEQ_MAX, TIME_MAX = 2**64, 2**63
_OFFSET = struct.Struct("<Q")
_END = struct.Struct("<4sII")  # the magic number, the checksum of the rows, and their number
_MAGIC = b"SRTX"
_ROW_BYTES = _OFFSET.size + HEAD_BYTES
_NUMBER, _KEY = r"(\d{1,30})", r"(?:x|(-?\d{1,19})\.(\d{1,20}))"
_NAME = re.compile("_".join([*[_NUMBER] * 5, _KEY, _KEY, r"(-?\d{1,20})\.segment"]))


class StoredSegment(NamedTuple):
    """A segment in an object store. `name`: the name of its object. `bytes`: the size of the object, with the index."""

    segment: Segment
    name: str
    bytes: int


def first_number(epoch: int) -> int:
    """The first number of a segment that the owner of a channel begins in this epoch."""
    return epoch * NUMBERS_PER_EPOCH + 1


def object_name(segment: Segment) -> str:
    """The name of a segment's object, which no other segment of the channel has."""
    one = segment
    plain = f"{one.number:018}_{one.length}_{one.items}_{one.first_seq}_{one.end_seq}"
    return f"{plain}_{_written(one.low)}_{_written(one.high)}_{one.last_accepted}.segment"


def segment_named(name: str) -> Segment | None:
    """The segment whose object has this name, or None if it is not the name of a segment."""
    found = _NAME.fullmatch(name)
    if found is None:
        return None
    *plain, low_time, low_seq, high_time, high_seq, last_accepted = found.groups()
    number, length, items, first_seq, end_seq = map(int, plain)
    low, high = _key(low_time, low_seq), _key(high_time, high_seq)
    segment = Segment(number, length, items, first_seq, end_seq, low, high, int(last_accepted))
    return segment if object_name(segment) == name and _is_possible(segment) else None


def _is_possible(one: Segment) -> bool:
    keys = [key for key in (one.low, one.high) if key is not None]
    in_range = all(-TIME_MAX <= time < TIME_MAX and seq < SEQ_MAX for time, seq in keys)
    has_keys = len(keys) == (2 if one.items else 0) and keys == sorted(keys)
    return in_range and has_keys and one.number > 0 and 0 < one.first_seq <= one.end_seq < SEQ_MAX


def _written(key: ItemKey | None) -> str:
    return "x" if key is None else f"{key[0]}.{key[1]}"


def _key(time: str | None, seq: str | None) -> ItemKey | None:
    return None if time is None or seq is None else (int(time), int(seq))


def encode_index(blocks: Sequence[PlacedBlock]) -> bytes:
    """The index of a segment's blocks."""
    rows = b"".join(_OFFSET.pack(one.offset) + encode_head(one.head) for one in blocks)
    return rows + _END.pack(_MAGIC, crc32(rows), len(blocks))


def decode_index(raw: bytes, length: int) -> list[PlacedBlock] | None:
    """The blocks of a segment of `length` bytes, from its index, or None if the index is damaged."""
    if len(raw) < _END.size:
        return None
    magic, checksum, count = _END.unpack_from(raw, len(raw) - _END.size)
    rows = raw[: -_END.size]
    if magic != _MAGIC or len(rows) != count * _ROW_BYTES or crc32(rows) != checksum:
        return None
    found = []
    for at in range(0, len(rows), _ROW_BYTES):
        head = decode_head(rows[at + _OFFSET.size : at + _ROW_BYTES])
        if head is None:
            return None
        found.append(PlacedBlock(_OFFSET.unpack_from(rows, at)[0], head))
    return found if all(one.end <= length for one in found) else None


def below(blocks: Sequence[PlacedBlock], length: int, end_seq: int) -> list[PlacedBlock]:
    """The blocks of a segment of `length` bytes, without their items from `end_seq` on.

    The owner that has these items again has only the latest advance again. So all blocks of advances stay.
    """
    whole = (one for one in blocks if one.end <= length)
    return [_cut(one, end_seq) for one in whole if one.head.first_seq < end_seq or one.head.kind == ADVANCES]


def up_to(blocks: Sequence[PlacedBlock], length: int, end_seq: int) -> list[PlacedBlock]:
    """Like `below`, but with the notes of losses at the end of the segment, which have no seqs."""
    ends = [one for one in blocks if one.end <= length and one.head.first_seq == one.head.end_seq == end_seq]
    return [*below(blocks, length, end_seq), *(one for one in ends if one.head.kind != ADVANCES)]


def _cut(block: PlacedBlock, end_seq: int) -> PlacedBlock:
    head = block.head
    if head.end_seq <= end_seq:
        return block
    first_seq = min(head.first_seq, end_seq)
    items = min(head.items, end_seq - first_seq)
    return PlacedBlock(block.offset, head._replace(first_seq=first_seq, end_seq=end_seq, items=items))
