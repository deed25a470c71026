"""Encodes the items of a feed, and the answers to them, in fixed places. Protobuf would take longer.

The bytes are valid messages of `replica_service.proto` (`FeedResponse.item`, `FeedRequest.item_next_seq`).
"""

from __future__ import annotations

import struct

from stampede_rt.errors import InvalidArgument
from stampede_rt.v1 import replica_service_pb2 as pb
from stampede_rt.wire.varints import decode_varint, encode_varint
from stampede_rt_channel_host.core.channel import FedItem, NewFloor, NewItem

ITEM_TAG = 5 << 3 | 2
"""The first byte of a response with an item."""
_ITEM = bytes((ITEM_TAG,))
_HEAD = struct.Struct("<BQBQBQBqBqBIBBBq")  # the fields 1 to 8 of a FedItem, each after its tag
_HEAD_TAGS = tuple(field << 3 | kind for field, kind in enumerate((1, 1, 1, 1, 1, 5, 0, 1), 1))
_FLOOR = struct.Struct("<BqBQBqBq")  # the fields 9 to 12
_FLOOR_TAGS = tuple(field << 3 | 1 for field in range(9, 13))
_RUN = bytes((13 << 3 | 2,))
_ANSWER = struct.Struct("<BQ")
_ANSWER_TAG = 10 << 3 | 1
_INSTANT_MAX = 2**63 - 1


def encode_item(fed: FedItem) -> bytes:
    """The response of the source with this part."""
    item, body = fed.item, bytes(fed.item.body)
    tags = _HEAD_TAGS
    head = _HEAD.pack(
        tags[0], item.seq, tags[1], item.producer_id, tags[2], item.first_number, tags[3], item.time,
        tags[4], item.duration, tags[5], item.length, tags[6], item.is_stamped, tags[7], item.judged_at,
    )  # fmt: skip
    floor = b"" if fed.collected is None else _encode_floor(fed.collected)
    length = encode_varint(len(body))
    whole_bytes = len(head) + len(floor) + len(_RUN) + len(length) + len(body)
    return b"".join((_ITEM, encode_varint(whole_bytes), head, floor, _RUN, length, body))


def _encode_floor(new: NewFloor) -> bytes:
    (time, seq), tags = new.floor, _FLOOR_TAGS
    end = min(new.collected_end, _INSTANT_MAX)  # a span may end later
    return _FLOOR.pack(tags[0], time, tags[1], seq, tags[2], new.newest_collected, tags[3], end)


def read_item(raw: bytes | memoryview) -> FedItem:
    """The part in a response that begins with ITEM_TAG. Raises InvalidArgument and DecodeError."""
    try:
        return _read_fixed(raw) or _read_message(raw)
    except (IndexError, struct.error):  # the bytes end within a field
        return _read_message(raw)


def _read_fixed(raw: bytes | memoryview) -> FedItem | None:
    """The part, if its fields have the places that `encode_item` gives them; otherwise None."""
    whole_bytes, at = decode_varint(raw, 1)
    if at + whole_bytes != len(raw):
        return None
    tags, values = _fields(_HEAD, raw, at)
    if tags != _HEAD_TAGS:
        return None
    at += _HEAD.size
    collected = None
    if raw[at] == _FLOOR_TAGS[0]:
        tags, (time, floor_seq, newest, end) = _fields(_FLOOR, raw, at)
        if tags != _FLOOR_TAGS:
            return None
        collected, at = NewFloor((time, floor_seq), newest, end), at + _FLOOR.size
    run_bytes, begin = decode_varint(raw, at + 1)
    if raw[at] != _RUN[0] or begin + run_bytes != len(raw):
        return None
    seq, producer_id, number, time, duration, length, is_stamped, judged_at = values
    body = bytes(raw[begin:])
    return FedItem(
        NewItem(seq, producer_id, number, time, duration, length, bool(is_stamped), judged_at, body), collected
    )


def _fields(form: struct.Struct, raw: bytes | memoryview, at: int) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """The tags and the values of fields that follow each other from the position `at` on."""
    found = form.unpack_from(raw, at)
    return found[::2], found[1::2]


def _read_message(raw: bytes | memoryview) -> FedItem:
    """As `read_item`, for fields in any places."""
    item = pb.FeedResponse.FromString(bytes(raw)).item
    if not (item.seq and item.producer_id and item.run):
        raise InvalidArgument("the feed has an item without a seq, producer or run; install the same release")
    collected = None
    if item.HasField("floor_seq"):
        floor = item.floor_time_unix_nano, item.floor_seq
        collected = NewFloor(floor, item.newest_collected_unix_nano, item.collected_end_unix_nano)
    new = NewItem(
        item.seq, item.producer_id, item.first_number, item.time_unix_nano, item.duration_nanos,
        item.payload_length_bytes, item.is_stamped, item.judged_unix_nano, item.run,
    )  # fmt: skip
    return FedItem(new, collected)


def encode_answer(next_seq: int) -> bytes:
    """The request of a copy that holds all items before `next_seq`, in answer to an item."""
    return _ANSWER.pack(_ANSWER_TAG, next_seq)


def read_answer(raw: bytes | memoryview) -> int:
    """The `next_seq` of `encode_answer`; 0 for all other requests."""
    if len(raw) != _ANSWER.size or raw[0] != _ANSWER_TAG:
        return 0
    next_seq: int = _ANSWER.unpack(raw)[1]
    return next_seq
