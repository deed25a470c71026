"""Encodes put requests without protobuf, so that payloads are copied only once (`channel_service.proto`).

A request has runs. A run is a sequence of items that a producer puts together (`wire.runs`), as encoded bytes.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

from stampede_rt.v1 import channel_pb2
from stampede_rt.v1 import channel_service_pb2 as channel_pb
from stampede_rt.v1 import queue_service_pb2 as queue_pb
from stampede_rt.wire.varints import encode_varint

HEADS_KEPT_MAX = 1024
# EnqueueRequest and EnqueueRun have the same field numbers as PutRequest and PutRun, so these tags fit both.
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
    head: bytes, first_number: int, run_pieces: Sequence[bytes], wait_nanos: int | None = None, tail: bytes = b""
) -> bytes:
    """Return an encoded PutRequest or EnqueueRequest with one run.

    `head` is the result of `put_head`, or empty. `first_number` is the producer's number of the run's first item.
    `run_pieces` has the encoded bytes of the run, in pieces. `tail` has the fields of the PutRun that follow the run
    (`enqueue_tail`, `put_tail`). `wait_nanos` is as in PutRun; None leaves the field out.
    """
    return b"".join(put_pieces(head, first_number, run_pieces, wait_nanos, tail))


def put_tail(ack: channel_pb2.Ack) -> bytes:
    """Return the encoded fields of a PutRun that follow the field `run`: the conditions for the ack."""
    return channel_pb.PutRun(ack=ack).SerializeToString()


def enqueue_tail(message_id: str) -> bytes:
    """Return the encoded fields of an EnqueueRun that follow the field `run`."""
    return queue_pb.EnqueueRun(message_id=message_id).SerializeToString()


def put_pieces(
    head: bytes, first_number: int, run_pieces: Sequence[bytes], wait_nanos: int | None = None, tail: bytes = b""
) -> list[bytes]:
    """Return the bytes of `put_request` in pieces.

    A caller may join the pieces of several requests. The joined bytes are one request with the runs of all of them.
    Only the first of these requests may then have a head.
    """
    run_bytes = sum(map(len, run_pieces))
    put = _numbers_of(first_number, wait_nanos) + _RUN_TAG + encode_varint(run_bytes)
    begin = b"".join((head, _PUTS_TAG, encode_varint(len(put) + run_bytes + len(tail)), put))
    return [begin, *run_pieces, tail] if tail else [begin, *run_pieces]


def _numbers_of(first_number: int, wait_nanos: int | None) -> bytes:
    """Return the encoded fields of a PutRun that precede the field `run`."""
    first = _FIRST_NUMBER_TAG + encode_varint(first_number) if first_number else b""  # proto3 leaves out a zero
    if wait_nanos is None:
        return first
    zigzag = wait_nanos << 1 if wait_nanos >= 0 else (-wait_nanos << 1) - 1
    return first + _WAIT_TAG + encode_varint(zigzag)
