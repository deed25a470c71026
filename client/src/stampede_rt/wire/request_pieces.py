"""Cuts a large request of puts into pieces, and reads the pieces. A host accepts only small messages (`RequestPiece`).

Neither side uses protobuf here, so that each byte is copied only once.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

from stampede_rt.errors import InvalidArgument
from stampede_rt.wire.varints import encode_varint

MESSAGE_BYTES_MAX = 2**18  # the most bytes of one message to a host
REQUEST_BYTES_MAX = 20 * 2**20  # the most bytes of all pieces of one request
JOINED_BYTES_MAX = 2**20  # the most bytes of joined runs; a larger run has a request of its own
SOCKET_MESSAGE_BYTES_MAX = JOINED_BYTES_MAX + 2**14  # for one message over a socket (decision 0170)
PIECE_TAG = bytes((5 << 3 | 2,))  # PutRequest.piece and EnqueueRequest.piece
_REQUEST_BYTES_TAG = bytes((1 << 3,))  # RequestPiece.request_bytes
_CONTENT_TAG = bytes((2 << 3 | 2,))  # RequestPiece.content
_VARINT_BYTES_MAX = 10
_FRAMING_BYTES_MAX = 32  # the tags and lengths of a piece


def messages_of(request: Any, message_bytes_max: int = MESSAGE_BYTES_MAX) -> Iterator[Any]:
    """Yield the messages that carry a request: the request, or the pieces of a large encoded one.

    A list has the bytes of an encoded request in parts. A request that gRPC must still encode is small.
    """
    if isinstance(request, list):
        request = b"".join(request)
    if not isinstance(request, bytes) or len(request) <= message_bytes_max:
        yield request
        return
    view, content_bytes = memoryview(request), message_bytes_max - _FRAMING_BYTES_MAX
    for begin in range(0, len(view), content_bytes):
        content = view[begin : begin + content_bytes]
        head = b"" if begin else _REQUEST_BYTES_TAG + encode_varint(len(view))
        head += _CONTENT_TAG + encode_varint(len(content))
        yield b"".join((PIECE_TAG, encode_varint(len(head) + len(content)), head, content))


class Piece(NamedTuple):
    """A piece of a request. `request_bytes` is 0 unless it is the first one."""

    request_bytes: int
    content: memoryview


def piece_in(message: bytes) -> Piece:
    """Return the piece in a message that begins with PIECE_TAG. Copies nothing.

    Raises InvalidArgument if the message is invalid or holds anything else.
    """
    try:
        return _piece_in(message)
    except IndexError:
        raise _no_piece() from None


def _piece_in(message: bytes) -> Piece:
    length, at = _varint(message, 1)
    if at + length != len(message):
        raise _no_piece()
    request_bytes, content = 0, memoryview(b"")
    while at < len(message):
        tag = message[at : at + 1]
        value, at = _varint(message, at + 1)
        if tag == _REQUEST_BYTES_TAG:
            request_bytes = value
        elif tag == _CONTENT_TAG and not content and at + value <= len(message):
            content, at = memoryview(message)[at : at + value], at + value
        else:
            raise _no_piece()
    return Piece(request_bytes, content)


def _varint(message: bytes, at: int) -> tuple[int, int]:
    """Return the number at `at`, and the position after it."""
    value = 0
    for index in range(_VARINT_BYTES_MAX):
        byte = message[at + index]
        value |= (byte & 0x7F) << 7 * index
        if byte < 0x80:
            return value, at + index + 1
    raise _no_piece()


def _no_piece() -> InvalidArgument:
    return InvalidArgument(
        "a message with a piece of a request is invalid, or holds something else, too; send each piece by itself, "
        "encoded from channel_service.proto"
    )
