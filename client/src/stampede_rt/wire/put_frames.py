"""Encodes put requests without protobuf, so that payloads are copied only once (`channel_service.proto`)."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

from stampede_rt.v1 import channel_pb2
from stampede_rt.v1 import channel_service_pb2 as channel_pb
from stampede_rt.v1 import queue_service_pb2 as queue_pb
from stampede_rt.wire.varints import encode_varint

HEADS_KEPT_MAX = 1024
_PUTS_TAG = bytes((4 << 3 | 2,))  # PutRequest.puts
_FIRST_NUMBER_TAG = bytes((1 << 3,))  # PutRun.first_number
_WAIT_TAG = bytes((2 << 3,))  # PutRun.wait_nanos, sint64
_RUN_TAG = bytes((3 << 3 | 2,))  # PutRun.run


@lru_cache(HEADS_KEPT_MAX)  # a handle's puts have the same head
def put_head(subject_id: bytes, epoch: int, producer_id: int) -> bytes:
    """Return the encoded fields that name the channel or queue and the producer.

    They are the beginning of the first request of a stream.
    """
    return channel_pb.PutRequest(channel_id=subject_id, epoch=epoch, producer_id=producer_id).SerializeToString()


def put_request(
    head: bytes, first_number: int, run: Sequence[bytes], wait_nanos: int | None = None, tail: bytes = b""
) -> bytes:
    """Return an encoded PutRequest or EnqueueRequest with one run.

    `head` is the result of `put_head`, or empty. `run` has the bytes of the run, in pieces. `tail` has the fields
    after the run (`enqueue_tail`, `put_tail`). `wait_nanos` is as in PutRun; None leaves the field out.
    """
    return b"".join(put_pieces(head, first_number, run, wait_nanos, tail))


def put_tail(ack: channel_pb2.Ack) -> bytes:
    """Return the encoded fields of a PutRun after its run: the conditions for its ack."""
    return channel_pb.PutRun(ack=ack).SerializeToString()


def enqueue_tail(message_id: str) -> bytes:
    """Return the encoded fields of an EnqueueRun after its run."""
    return queue_pb.EnqueueRun(message_id=message_id).SerializeToString()


def put_pieces(
    head: bytes, first_number: int, run: Sequence[bytes], wait_nanos: int | None = None, tail: bytes = b""
) -> list[bytes]:
    """Return the bytes of `put_request` in pieces.

    The pieces of several requests, joined, are one request with all their runs. Give a head to the first one only.
    """
    run_bytes = sum(map(len, run))
    put = _numbers_of(first_number, wait_nanos) + _RUN_TAG + encode_varint(run_bytes)
    begin = b"".join((head, _PUTS_TAG, encode_varint(len(put) + run_bytes + len(tail)), put))
    return [begin, *run, tail] if tail else [begin, *run]


def _numbers_of(first_number: int, wait_nanos: int | None) -> bytes:
    """Return the encoded fields of a PutRun before its run."""
    first = _FIRST_NUMBER_TAG + encode_varint(first_number) if first_number else b""  # proto3 leaves out a zero
    if wait_nanos is None:
        return first
    zigzag = wait_nanos << 1 if wait_nanos >= 0 else (-wait_nanos << 1) - 1
    return first + _WAIT_TAG + encode_varint(zigzag)
