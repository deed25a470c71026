"""Encodes the runs of a feed that go ahead, and the answers to them. Protobuf would take longer.

The bytes are valid messages of `replica_service.proto` (`FeedResponse.item`, `FeedRequest.item_next_seq`), with each
field at a fixed offset.
"""

from __future__ import annotations

import struct

from stampede_rt.errors import InvalidArgument
from stampede_rt.v1 import replica_service_pb2 as pb
from stampede_rt_channel_host.copies.fixed_fields import FixedFields, LongField
from stampede_rt_channel_host.core.channel import FedItem, NewFloor, NewItem

_ITEM = LongField(5)
ITEM_TAG = _ITEM.tag
"""The first byte of a response with the items of one run."""
_HEAD = FixedFields("QQQqqIBq")  # the fields 1 to 8 of a FedItem
_FLOOR = FixedFields("qQqq", first=9)
_RUN = LongField(13)
_ITEMS = FixedFields("I", first=14)  # only of several items
_ANSWER = FixedFields("Q", first=10)
_INSTANT_MAX = 2**63 - 1


def encode_item(fed: FedItem) -> bytes:
    """The response of the source with this part."""
    item, body = fed.item, bytes(fed.item.body)
    head = _HEAD.encode(*item[:8])  # from `seq` to `judged_at`
    floor = b"" if fed.collected is None else _encode_floor(fed.collected)
    count = b"" if item.items == 1 else _ITEMS.encode(item.items)
    return _ITEM.encode(head, floor, count, _RUN.head(len(body)), body)


def _encode_floor(new: NewFloor) -> bytes:
    time, seq = new.floor
    end = min(new.collected_end, _INSTANT_MAX)  # a span may end later
    return _FLOOR.encode(time, seq, new.newest_collected, end)


def read_item(raw: bytes | memoryview) -> FedItem:
    """The part in a response that begins with ITEM_TAG. Raises InvalidArgument and DecodeError."""
    try:
        return _read_fixed(raw) or _read_message(raw)
    except (IndexError, struct.error):  # the bytes end within a field
        return _read_message(raw)


def _read_fixed(raw: bytes | memoryview) -> FedItem | None:
    """The part, if its fields have the places that `encode_item` gives them; otherwise None."""
    at, end = _ITEM.find(raw) or (0, 0)
    values = _HEAD.read(raw, at) if end == len(raw) else None
    if values is None:
        return None
    at += _HEAD.size_bytes
    collected = None
    if raw[at] == _FLOOR.first_tag:
        floor = _FLOOR.read(raw, at)
        if floor is None:
            return None
        collected, at = NewFloor((floor[0], floor[1]), *floor[2:]), at + _FLOOR.size_bytes
    items = 1
    if raw[at] == _ITEMS.first_tag:
        (items,) = _ITEMS.read(raw, at) or (0,)
        at += _ITEMS.size_bytes
    begin, end = _RUN.find(raw, at) or (0, 0)
    if end != len(raw) or not items:
        return None
    seq, producer_id, number, time, duration, length, is_stamped, judged_at = values
    body = bytes(raw[begin:])
    new = NewItem(seq, producer_id, number, time, duration, length, bool(is_stamped), judged_at, body, items=items)
    return FedItem(new, collected)


def _read_message(raw: bytes | memoryview) -> FedItem:
    """Like `read_item`, but the fields may be in any places."""
    item = pb.FeedResponse.FromString(bytes(raw)).item
    if not (item.seq and item.run):
        raise InvalidArgument("the feed has an item without a seq or run; install the same release")
    collected = None
    if item.HasField("floor_seq"):
        floor = item.floor_time_unix_nano, item.floor_seq
        collected = NewFloor(floor, item.newest_collected_unix_nano, item.collected_end_unix_nano)
    new = NewItem(
        item.seq, item.producer_id, item.first_number, item.time_unix_nano, item.duration_nanos,
        item.payload_length_bytes, item.is_stamped, item.judged_unix_nano, item.run, items=item.items or 1,
    )  # fmt: skip
    return FedItem(new, collected)


def encode_answer(next_seq: int) -> bytes:
    """The request of a copy that holds all items before `next_seq`, in answer to a run."""
    return _ANSWER.encode(next_seq)


def read_answer(raw: bytes | memoryview) -> int:
    """The `next_seq` of `encode_answer`; 0 for all other requests."""
    (next_seq,) = _ANSWER.read_whole(raw) or (0,)
    return next_seq
