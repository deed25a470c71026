"""Encodes the puts that the owner of a queue sends ahead, and the answers to them, in fixed places.

The bytes are valid messages of `migration_service.proto` (`FeedQueueRequest.put`, `FeedQueueResponse.put_next_step`).
"""

from __future__ import annotations

import struct

from google.protobuf.message import Message

from stampede_rt.errors import InvalidArgument
from stampede_rt.v1 import migration_service_pb2 as pb
from stampede_rt_channel_host.channels.requests import parse
from stampede_rt_channel_host.copies.fixed_fields import FixedFields, LongField
from stampede_rt_channel_host.core.queue import AheadPut

_PUT = LongField(5)
PUT_TAG = _PUT.tag
"""The first byte of a request with a put."""
_HEAD = FixedFields("QQQQqIB")  # the fields 1 to 7 of a FedQueuePut
_OWNER, _RUN = LongField(8), LongField(9)
_ANSWER = FixedFields("Q", first=6)


def encode_request(request: Message | AheadPut) -> bytes:
    """The bytes of a request of the owner."""
    return encode_put(request) if isinstance(request, AheadPut) else request.SerializeToString()


def encode_put(put: AheadPut) -> bytes:
    """The request with this put."""
    stamped = put.stamped_time
    head = _HEAD.encode(
        put.number, put.seq, put.producer_id, put.first_number, stamped or 0, put.length, stamped is not None
    )
    caller_name = put.caller_name.encode()
    return _PUT.encode(head, _OWNER.head(len(caller_name)), caller_name, _RUN.head(len(put.body)), put.body)


def read_put(raw: bytes | memoryview) -> AheadPut:
    """The put in a request that begins with PUT_TAG. Raises InvalidArgument."""
    try:
        found = _read_fixed(raw)
    except (IndexError, struct.error, UnicodeDecodeError):  # the bytes end within a field, for example
        found = None
    return found or put_of(parse(pb.FeedQueueRequest, bytes(raw), "FeedQueueRequest").put)


def _read_fixed(raw: bytes | memoryview) -> AheadPut | None:
    """The put, if its fields have the places that `encode_put` gives them; otherwise None."""
    put = _PUT.find(raw)
    if put is None or put[1] != len(raw):
        return None
    values = _HEAD.read(raw, put[0])
    name_range = _OWNER.find(raw, put[0] + _HEAD.size_bytes)
    run = None if name_range is None or name_range[1] >= len(raw) else _RUN.find(raw, name_range[1])
    if values is None or name_range is None or run is None or run[1] != len(raw):
        return None
    number, seq, producer_id, first_number, stamped, length, is_stamped = values
    stamped_time, caller_name = stamped if is_stamped else None, str(raw[slice(*name_range)], "utf-8")
    body = bytes(raw[slice(*run)])
    return AheadPut(number, seq, producer_id, first_number, length, stamped_time, caller_name, body)


def put_of(message: pb.FedQueuePut) -> AheadPut:
    """The put in a message whose fields come in any order. Raises InvalidArgument if it is no put."""
    if not (message.step and message.seq and message.producer_id and message.run):
        raise InvalidArgument("the feed has a put without a step, seq, producer or run; install the same release")
    return AheadPut(
        message.step, message.seq, message.producer_id, message.first_number, message.payload_length_bytes,
        message.stamped_unix_nano if message.is_stamped else None, message.owner, message.run,
    )  # fmt: skip


def encode_answer(next_step: int) -> bytes:
    """The answer of a copy to a put: it has all steps before `next_step`."""
    return _ANSWER.encode(next_step)


def read_answer(raw: bytes | memoryview) -> pb.FeedQueueResponse | int:
    """The answer of a copy. The `next_step` of `encode_answer`, or any other answer. Raises DecodeError."""
    found = _ANSWER.read_whole(raw)
    return pb.FeedQueueResponse.FromString(bytes(raw)) if found is None else found[0]
