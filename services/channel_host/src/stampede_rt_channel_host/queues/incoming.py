"""Turns a producer's run into an `Enqueue` of the core, and the outcome of the `Enqueue` into an ack."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

from google.protobuf.message import DecodeError

from stampede_rt.errors import InvalidArgument, MalformedRun, PermissionDenied
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.v1 import item_pb2, raw_run_pb2
from stampede_rt.wire.runs import origin_field, parse_run, seal_run, select_items
from stampede_rt_channel_host.channels.limits.memory import own_bytes
from stampede_rt_channel_host.channels.puts.acks import ack_of, refused
from stampede_rt_channel_host.channels.puts.long_requests import read_long
from stampede_rt_channel_host.channels.puts.read_ahead import left_nanos
from stampede_rt_channel_host.channels.puts.whole_requests import check_without_piece
from stampede_rt_channel_host.channels.requests import parse
from stampede_rt_channel_host.core.queue import Enqueue
from stampede_rt_runtime.identity import Identity, Role

MESSAGE_ID_BYTES_MAX = 128
ORIGIN_BYTES_MAX = 4096


class EnqueueRun(NamedTuple):
    """One run of a request. `wait_nanos` None: the run may wait without limit.

    The object keeps not much more than the bytes of the run, so that a waiting run does not keep the whole request in
    memory.
    """

    first_number: int
    wait_nanos: int | None
    run: bytes | memoryview
    message_id: str
    origin: bytes

    @classmethod
    def of(cls, message: raw_run_pb2.RawEnqueueRun, run: bytes | memoryview) -> EnqueueRun:
        """The run of a message. `run`: its bytes, perhaps a view of the request; the new object copies a view."""
        wait_nanos = message.wait_nanos if message.HasField("wait_nanos") else None
        return cls(message.first_number, wait_nanos, own_bytes(run), message.message_id, message.origin)


class EnqueueRequest(NamedTuple):
    """The fields of an EnqueueRequest. `queue_id` is empty if the request names no queue."""

    queue_id: bytes
    epoch: int
    producer_id: int
    runs: deque[EnqueueRun]


def read_request(raw: bytes | bytearray) -> EnqueueRequest:
    """Decode a whole request.

    Raises InvalidArgument if `raw` is no EnqueueRequest, or holds a piece of another request.
    """
    long = read_long(raw, raw_run_pb2.RawEnqueueRequest, raw_run_pb2.RawEnqueueRun, "EnqueueRequest")
    if long is not None:
        runs = deque(EnqueueRun.of(message, run) for message, run in long.runs)
        return EnqueueRequest(long.head.queue_id, long.head.epoch, long.head.producer_id, runs)
    request: raw_run_pb2.RawEnqueueRequest = parse(raw_run_pb2.RawEnqueueRequest, bytes(raw), "EnqueueRequest")
    check_without_piece(request)
    runs = deque(EnqueueRun.of(message, message.run) for message in request.runs)
    return EnqueueRequest(request.queue_id, request.epoch, request.producer_id, runs)


def enqueue_of(message: EnqueueRun, producer_id: int, received_s: float, caller_name: str = "") -> Enqueue:
    """The run as a value of the core, which has still to accept or refuse it.

    `received_s`: the monotonic time at which the request came. `caller_name`: see `RetryWindow.record`. Raises
    MalformedRun if the columns, the message id or the origin of the run are invalid, and ItemTooLarge for a message
    larger than any queue can hold.
    """
    encoded = message.run
    columns = parse_run(encoded)
    items = len(columns.lengths)
    origin = _origin_of(message, items)

    def seal(first_seq: int, positions: Sequence[int], stamped_time: int | None) -> bytes:
        kept = encoded if len(positions) == items else select_items(encoded, positions)
        return seal_run(kept, first_seq, None if stamped_time is None else (stamped_time,) * len(positions)) + origin

    return Enqueue(
        columns.lengths,
        seal,
        is_stamped=columns.times is None,
        producer_id=producer_id,
        first_number=message.first_number,
        wait_nanos=None if message.wait_nanos is None else left_nanos(message.wait_nanos, received_s),
        message_id=_message_id_of(message, items),
        caller_name=caller_name,
    )


def _message_id_of(message: EnqueueRun, items: int) -> str:
    length = len(message.message_id.encode())
    if length > MESSAGE_ID_BYTES_MAX or (length and items != 1):
        raise MalformedRun(
            f"the run of {items} messages has a message_id of {length} bytes; an id has "
            f"at most {MESSAGE_ID_BYTES_MAX} bytes of UTF-8 and names one message: put each message in a run of its own"
        )
    return message.message_id


def _origin_of(message: EnqueueRun, items: int) -> bytes:
    """The bytes to append to the stored run of a dead letter; empty for other runs."""
    if not message.origin:
        return b""
    try:
        item_pb2.DeadLetterOrigin.FromString(message.origin)
    except DecodeError as error:
        raise MalformedRun("the run's origin is not a valid DeadLetterOrigin; encode it from item.proto") from error
    if items != 1 or len(message.origin) > ORIGIN_BYTES_MAX:
        raise MalformedRun(
            f"the run has {items} messages and an origin of {len(message.origin)} bytes; a dead letter is a run of one "
            f"message, and its origin has at most {ORIGIN_BYTES_MAX} bytes"
        )
    return origin_field(message.origin)


def check_forwards(caller: Identity | None) -> None:
    """Raises PermissionDenied if `caller` is not a host, because only hosts may set the origin of a run.

    `caller` None: the caller has no certificate, as in a cluster without certificates. Then this check allows the call.
    """
    if caller is not None and caller.role is not Role.HOST:
        raise PermissionDenied(
            f"{caller.role} {caller.name} may not set the origin of a run, which says where a dead letter comes from: "
            "only hosts forward dead letters; leave origin out"
        )


def check_number(producer_id: int, first_number: int) -> None:
    """Raises InvalidArgument for a producer with an id, but without a number: its retries could not be recognised."""
    if producer_id and not first_number:
        raise InvalidArgument(
            "first_number is 0; a producer with an id numbers its messages from 1, or leaves its id out"
        )


def answer(run: Enqueue, now: int, incarnation: int) -> pb.PutAck:
    """The ack of a run that the core has accepted or refused."""
    if run.error is not None:
        return refused(run.first_number, len(run.lengths), run.error, now, incarnation)
    assert run.outcome is not None, "a run that is done has an outcome or an error"
    ack = ack_of(run.first_number, run.outcome, incarnation)
    ack.duplicate = run.is_duplicate
    return ack
