"""Encodes put requests without protobuf, so that payloads are copied only once (`channel_service.proto`)."""

from __future__ import annotations

from collections.abc import Sequence

from stampede_rt.v1 import channel_service_pb2 as channel_pb
from stampede_rt.v1 import queue_service_pb2 as queue_pb
from stampede_rt.wire.runs import encode_varint

_PUTS_TAG = bytes((4 << 3 | 2,))  # PutRequest.puts
_RUN_TAG = bytes((3 << 3 | 2,))  # PutRun.run


def put_head(subject_id: bytes, epoch: int, producer_id: int) -> bytes:
    """Return the encoded fields that name the channel or queue and the producer.

    They are the beginning of the first request of a stream.
    """
    return channel_pb.PutRequest(channel_id=subject_id, epoch=epoch, producer_id=producer_id).SerializeToString()


def put_request(
    head: bytes, first_number: int, run: Sequence[bytes], wait_nanos: int | None = None, message_id: str = ""
) -> bytes:
    """Return an encoded PutRequest or EnqueueRequest with one run.

    `head` is the result of `put_head`, or empty. `run` has the bytes of the run, in pieces. `message_id` is for queues
    only. `wait_nanos` is as in PutRun; None leaves the field out.
    """
    return b"".join(put_pieces(head, first_number, run, wait_nanos, message_id))


def put_pieces(
    head: bytes, first_number: int, run: Sequence[bytes], wait_nanos: int | None = None, message_id: str = ""
) -> list[bytes]:
    """Return the bytes of `put_request` in pieces.

    The pieces of several requests, joined, are one request with all their runs. Give a head to the first one only.
    """
    put = queue_pb.EnqueueRun(
        first_number=first_number, wait_nanos=wait_nanos, message_id=message_id
    ).SerializeToString()
    run_length = encode_varint(sum(map(len, run)))
    inner = len(put) + len(_RUN_TAG) + len(run_length) + sum(map(len, run))
    return [head, _PUTS_TAG, encode_varint(inner), put, _RUN_TAG, run_length, *run]
