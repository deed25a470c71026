"""Requests that are larger than one message to a host."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stampede_rt.errors import InvalidArgument
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.v1 import queue_service_pb2 as queue_pb
from stampede_rt.wire.request_pieces import (
    MESSAGE_BYTES_MAX,
    PIECE_TAG,
    SOCKET_MESSAGE_BYTES_MAX,
    messages_of,
    piece_in,
)


def test_over_a_socket_a_larger_request_still_fits_in_one_message() -> None:
    request = bytes(SOCKET_MESSAGE_BYTES_MAX)
    assert list(messages_of(request, SOCKET_MESSAGE_BYTES_MAX)) == [request]
    messages = [*messages_of(request + request + b"x", SOCKET_MESSAGE_BYTES_MAX)]
    assert (len(messages), max(map(len, messages)) <= SOCKET_MESSAGE_BYTES_MAX) == (3, True)
    assert b"".join(piece_in(one).content for one in messages) == request + request + b"x"


@pytest.mark.parametrize("size", [1, MESSAGE_BYTES_MAX - 1, MESSAGE_BYTES_MAX])
def test_a_request_that_fits_in_one_message_is_sent_unchanged(size: int) -> None:
    request = bytes(size)
    (message,) = messages_of(request)
    assert message is request


@pytest.mark.parametrize("size", [MESSAGE_BYTES_MAX + 1, 3 * MESSAGE_BYTES_MAX, 2**24 + 17])
def test_the_joined_pieces_of_a_large_request_are_the_request_and_each_fits_in_a_message(size: int) -> None:
    request = bytes(range(256)) * (size // 256) + b"x" * (size % 256)
    messages = list(messages_of(request))
    assert max(map(len, messages)) <= MESSAGE_BYTES_MAX
    pieces = [pb.PutRequest.FromString(message).piece for message in messages]
    assert b"".join(piece.content for piece in pieces) == request
    assert [piece.request_bytes for piece in pieces] == [size] + [0] * (len(pieces) - 1)
    assert [piece_in(message) for message in messages] == [(one.request_bytes, one.content) for one in pieces]
    assert [queue_pb.EnqueueRequest.FromString(message).piece for message in messages] == pieces


def test_a_request_that_grpc_encodes_is_sent_unchanged() -> None:
    request = pb.GetRequest(call_id=1)
    assert list(messages_of(request)) == [request]


@given(st.binary(max_size=40), st.integers(0, 30), st.binary(max_size=3))
def test_a_changed_piece_is_refused_or_read_like_protobuf(content: bytes, at: int, noise: bytes) -> None:
    whole = pb.PutRequest(piece=pb.RequestPiece(request_bytes=300, content=content)).SerializeToString()
    message = PIECE_TAG + (whole[1 : 1 + at] + noise + whole[1 + at + len(noise) :])
    try:
        found = piece_in(message)
    except InvalidArgument:
        return
    expected = pb.PutRequest.FromString(message).piece
    assert (found.request_bytes, bytes(found.content)) == (expected.request_bytes, expected.content)


def test_a_length_without_an_end_is_refused() -> None:
    with pytest.raises(InvalidArgument):
        piece_in(PIECE_TAG + b"\x80" * 200_000)
