"""Encodes the messages that carry runs, without the generated classes.

The host copies the stored bytes of a whole run once, into the message, and does not parse them. The result equals the
serialized messages of `raw_run.proto`. The tests compare the two.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.v1 import error_pb2
from stampede_rt.wire.run_slices import RunSlicer
from stampede_rt.wire.varints import encode_varint
from stampede_rt_channel_host.channels.joined_runs import joined_deliveries, joined_slices
from stampede_rt_channel_host.core.channel import ColumnRun, DeliveredSlice, ReadAnswer, Slice, Slicer, drained

MESSAGE_BYTES_MAX = 2**20  # the most bytes of runs in one message; a message with a single run may have more
SHARED_BYTES_MAX = 4 * 2**20  # the most memory of the deliveries that a host keeps until other readers take them
KEPT_DELIVERY_BYTES = 1024  # the approximate memory of a kept delivery besides its bytes
JOINED_BYTES_MAX = 2**16  # up to this length a join takes less time than to send parts
PART_BYTES_MIN = 1024  # on average; shorter parts are joined in less time than sent
MESSAGE_RUNS_MAX = 512  # the most stored runs in one message, so that the host makes it within two milliseconds

_LENGTH_DELIMITED = 2
_RUN = bytes((1 << 3 | _LENGTH_DELIMITED,))  # RawDeliveredRun.run
_NEXT_TIME = struct.Struct("<Bq")
_NEXT_TIME_TAG = 2 << 3 | 1  # RawDeliveredRun.next_time_unix_nano, sfixed64
_CALL_ID = bytes((1 << 3,))  # RawGetResponse.call_id, varint
_GET_RUNS = bytes((2 << 3 | _LENGTH_DELIMITED,))
_GET_SUMMARY = bytes((3 << 3 | _LENGTH_DELIMITED,))
_GET_ERROR = bytes((4 << 3 | _LENGTH_DELIMITED,))
_SUBSCRIBE_RUNS = bytes((3 << 3 | _LENGTH_DELIMITED,))


class EncodedMessage(NamedTuple):
    """One message of an answer, and the numbers of payload bytes and items in it.

    `is_last`: the answer has no further message.
    """

    encoded: bytes
    payload_bytes: int
    is_last: bool
    items: int = 0


def run_bytes(part: Slice, *, without_payloads: bool) -> bytes:
    """The encoded run of a slice. A slice that covers its whole run gives the stored bytes as they are."""
    run = part.run
    if part.is_whole and not without_payloads:
        return bytes(run.body)
    slicer = slicer_of(run) if isinstance(run, ColumnRun) else RunSlicer(bytes(run.body))
    return slicer.cut(part.lo, part.hi, without_payloads=without_payloads)


def slicer_of(run: ColumnRun) -> Slicer:
    """The slicer of a run, which the run keeps."""
    if run.slicer is None:
        run.slicer = RunSlicer(bytes(run.body))
    return run.slicer


def get_responses(
    call_id: int, answer: ReadAnswer, summary: pb.GetSummary, *, without_payloads: bool
) -> Iterator[EncodedMessage]:
    """Yield the messages that answer a get. The last message has the summary."""
    head = _CALL_ID + encode_varint(call_id) if call_id else b""  # proto3 leaves out fields of value zero
    parts, runs, size, payload_bytes, items = [head], 0, 0, 0, 0
    next_time, rest = answer.next_time, joined_slices(drained(answer.slices), answer.next_times)
    following = next(rest, None)
    while following is not None:
        part, stored = following
        following = next(rest, None)
        body = run_bytes(part, without_payloads=without_payloads)
        if runs and (size + len(body) > MESSAGE_BYTES_MAX or runs + stored > MESSAGE_RUNS_MAX):
            yield EncodedMessage(b"".join(parts), payload_bytes, False, items)
            parts, runs, size, payload_bytes, items = [head], 0, 0, 0, 0
        time_after = answer.next_times.get((part.last_time, part.end_seq)) if following else next_time
        _add_run(parts, _GET_RUNS, body, time_after)
        runs += stored
        items += part.items
        size += len(body)
        payload_bytes += 0 if without_payloads else part.payload_bytes
    encoded = summary.SerializeToString()
    parts += (_GET_SUMMARY, encode_varint(len(encoded)), encoded)
    yield EncodedMessage(b"".join(parts), payload_bytes, True, items)


def get_error(call_id: int, error: error_pb2.Error) -> Iterator[EncodedMessage]:
    """Yield the single message that ends a get with an error."""
    encoded = error.SerializeToString()
    head = _CALL_ID + encode_varint(call_id) if call_id else b""
    yield EncodedMessage(b"".join((head, _GET_ERROR, encode_varint(len(encoded)), encoded)), 0, True)


Sendable = bytes | Sequence[bytes]
"""An encoded message, or its parts."""


@dataclass(slots=True)
class Delivery:
    """One message of a subscription, its payload bytes, and the bytes that it costs the reader's credit.

    `parts`: the encoded message. Joined, they are `encoded`. Stored runs are parts of their own, so a transport that
    sends parts sends the stored bytes.
    """

    parts: Sequence[bytes]
    payload_bytes: int
    charge_bytes: int

    @property
    def length_bytes(self) -> int:
        """The length of the message."""
        return sum(map(len, self.parts))

    @property
    def encoded(self) -> bytes:
        """The whole message. Its parts are joined once, for all readers."""
        if len(self.parts) != 1:
            self.parts = (b"".join(self.parts),)
        return self.parts[0]

    def message(self, *, takes_parts: bool) -> Sendable:
        """The message for a transport: in parts if the transport takes parts, and a join would take more time."""
        is_long = self.length_bytes > max(JOINED_BYTES_MAX, PART_BYTES_MIN * len(self.parts))
        return self.parts if takes_parts and is_long else self.encoded


_Key = tuple[tuple[DeliveredSlice, ...], bytes, bool]  # runs compare by identity


@dataclass(slots=True)
class _SharedDelivery:
    """A kept delivery, the bytes that it keeps in memory, and how many readers have not taken it yet."""

    delivery: Delivery
    kept_bytes: int
    readers_left: int


class SharedDeliveries:
    """The latest deliveries of a host's subscriptions. All readers that are to get the same items get the same bytes.

    Forgets a delivery when all readers of the channel have taken it. Forgets the oldest deliveries beyond
    SHARED_BYTES_MAX, but never the newest one.
    """

    def __init__(self, bytes_max: int = SHARED_BYTES_MAX) -> None:
        self._bytes_max = bytes_max
        self._shared: dict[_Key, _SharedDelivery] = {}
        self.kept_bytes = 0
        """The bytes of the kept messages, and of the runs that they keep in memory."""
        self.encodings = 0
        """The number of deliveries encoded so far."""

    def encode(
        self, slices: Sequence[DeliveredSlice], about: bytes, *, without_payloads: bool, readers: int
    ) -> Delivery:
        """A SubscribeResponse with the runs `slices`. `about` has its other fields, encoded: progress, gap and cursor.

        `readers`: the number of the channel's subscriptions, this one included.
        """
        key = (tuple(slices), about, without_payloads)
        shared = self._shared.get(key)
        if shared is None:
            delivery = self._encode(slices, about, without_payloads)
            if readers > 1:
                self._keep(key, delivery, readers - 1)
            return delivery
        shared.readers_left -= 1
        if not shared.readers_left:
            self._forget(key)
        return shared.delivery

    def encode_once(self, slices: Sequence[Slice], about: bytes) -> Delivery:
        """Like `encode`, but for a copy of the channel. No other reader gets the message, and it has no next times,
        because the copy computes the ends of spans from its own items.
        """
        parts = [about]
        for part, _ in joined_slices(slices):
            _add_run(parts, _SUBSCRIBE_RUNS, run_bytes(part, without_payloads=False), None)
        return self._delivery(slices, parts, without_payloads=False)

    def _encode(self, slices: Sequence[DeliveredSlice], about: bytes, without_payloads: bool) -> Delivery:
        parts = _subscribe_parts(slices, about, without_payloads)
        return self._delivery([one.slice for one in slices], parts, without_payloads=without_payloads)

    def _delivery(self, slices: Sequence[Slice], parts: list[bytes], *, without_payloads: bool) -> Delivery:
        self.encodings += 1
        payload_bytes = 0 if without_payloads else sum(part.payload_bytes for part in slices)
        return Delivery(parts, payload_bytes, sum(part.charge_bytes for part in slices))

    def _keep(self, key: _Key, delivery: Delivery, readers_left: int) -> None:
        run_bytes = sum(len(run.body) for run in {one.slice.run for one in key[0]})
        kept_bytes = delivery.length_bytes + run_bytes + KEPT_DELIVERY_BYTES
        while self._shared and self.kept_bytes + kept_bytes > self._bytes_max:
            self._forget(next(iter(self._shared)))
        self._shared[key] = _SharedDelivery(delivery, kept_bytes, readers_left)
        self.kept_bytes += kept_bytes

    def _forget(self, key: _Key) -> None:
        self.kept_bytes -= self._shared.pop(key).kept_bytes


def _subscribe_parts(slices: Sequence[DeliveredSlice], about: bytes, without_payloads: bool) -> list[bytes]:
    """The encoded response in parts. Its fields need no order, because protobuf accepts any order on the wire."""
    parts = [about]
    for part, next_time in slices if len(slices) < 2 else joined_deliveries(slices):
        _add_run(parts, _SUBSCRIBE_RUNS, run_bytes(part, without_payloads=without_payloads), next_time)
    return parts


def _add_run(parts: list[bytes], tag: bytes, body: bytes, next_time: int | None) -> None:
    length = encode_varint(len(body))
    end = b"" if next_time is None else _NEXT_TIME.pack(_NEXT_TIME_TAG, next_time)
    begin = b"".join((tag, encode_varint(1 + len(length) + len(body) + len(end)), _RUN, length))
    parts += (begin, body, end) if end else (begin, body)
