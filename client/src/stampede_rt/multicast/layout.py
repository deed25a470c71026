"""The layout of datagrams. Pure. docs/wire.md describes it for other languages.

A message carries the items of one range of seqs, or says that there are no later items. It is cut into parts, and each
datagram carries one part.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

MARK = b"SRM1"
DATAGRAM_BYTES_MAX = 1400  # below the MTU of Ethernet, with room for the headers of IP, UDP and a tunnel
STREAM_ID_BYTES = 8
KEY_BYTES = 32
SIGNATURE_BYTES = 64
MESSAGE_BYTES_MAX = 2**20
"""The largest message. Readers get larger items only over their streams from the host."""

HEAD = struct.Struct(f">4s{STREAM_ID_BYTES}sHQ")
_PART = struct.Struct(">BQQHH")
_TAG_BYTES = 16  # the length of an AES-GCM tag
ENCRYPTION_BYTES = HEAD.size + _TAG_BYTES
"""The number of bytes by which a datagram is longer than its part."""
DATA_BYTES_MAX = DATAGRAM_BYTES_MAX - HEAD.size - _PART.size - _TAG_BYTES
PARTS_MAX = -(-(MESSAGE_BYTES_MAX + SIGNATURE_BYTES) // DATA_BYTES_MAX)


class MessageKind(IntEnum):
    """The kinds of messages."""

    ITEMS = 1
    """Carries the items with seqs from `first_seq` up to `end_seq`, exclusive."""
    BEAT = 2
    """There is no item from `first_seq` on yet."""
    END = 3
    """The host sends no further datagrams. The reader opens another stream, which gives the reason."""


class DatagramHead(NamedTuple):
    """The part of a datagram that is not encrypted. `number` differs in all datagrams under one key."""

    stream_id: bytes
    key_number: int
    number: int


@dataclass(frozen=True, slots=True)
class MessagePart:
    """One part of a message: the `index`-th of `count`."""

    kind: MessageKind
    first_seq: int
    end_seq: int
    index: int
    count: int
    data: bytes


class MulticastMessage(NamedTuple):
    """A whole message. `body`: the signature of the host, then an encoded SubscribeResponse with runs."""

    kind: MessageKind
    first_seq: int
    end_seq: int
    body: bytes


def parts_of(message: MulticastMessage) -> Iterator[bytes]:
    """Yield the encoded parts of a message, whose body is not empty."""
    kind, first_seq, end_seq, body = message
    count = -(-len(body) // DATA_BYTES_MAX)
    for index in range(count):
        data = body[index * DATA_BYTES_MAX : (index + 1) * DATA_BYTES_MAX]
        yield _PART.pack(kind, first_seq, end_seq, index, count) + data


def parse_part(encoded: bytes) -> MessagePart | None:
    """Return the part; None if the bytes are not a part as a host encodes it."""
    if len(encoded) <= _PART.size:
        return None
    kind, first_seq, end_seq, index, count = _PART.unpack_from(encoded)
    data = encoded[_PART.size :]
    is_last = index == count - 1
    if not (1 <= kind <= 3 and 1 <= first_seq <= end_seq and index < count <= PARTS_MAX):
        return None
    if (kind == MessageKind.ITEMS) is (first_seq == end_seq) or (len(data) != DATA_BYTES_MAX and not is_last):
        return None
    return (
        MessagePart(MessageKind(kind), first_seq, end_seq, index, count, data) if len(data) <= DATA_BYTES_MAX else None
    )


def parse_head(datagram: bytes) -> DatagramHead | None:
    """Return the head; None if the datagram is not one of this layout."""
    if not HEAD.size + _PART.size + _TAG_BYTES < len(datagram) <= DATAGRAM_BYTES_MAX:
        return None
    mark, stream_id, key_number, number = HEAD.unpack_from(datagram)
    return DatagramHead(stream_id, key_number, number) if mark == MARK else None


def signed_bytes(stream_id: bytes, message: MulticastMessage) -> bytes:
    """The bytes that the host signs; `message.body` is without the signature."""
    return b"".join((b"stampede multicast 1", stream_id, struct.pack(">BQQ", *message[:3]), message.body))
