# Generated from ../_async by tools/generate.py; do not edit.
"""Single puts into a channel, queue or mailbox. Each goes over an open stream to the host, and waits for its ack."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from stampede_rt._sync.attempts import Locator, attempt
from stampede_rt._sync.channel_state import ChannelState
from stampede_rt._sync.session import CALL_TIMEOUT_S, Session
from stampede_rt.cluster.binding import Binding
from stampede_rt.errors import Full, NotArchived, NotReplicated
from stampede_rt.status import from_error_message
from stampede_rt.transports.concurrency_sync import monotonic_s
from stampede_rt.transports.grpc_sync import PutExchange, ServerEndpoint
from stampede_rt.v1 import channel_service_pb2 as channel_pb
from stampede_rt.values.codecs import HandleCodec
from stampede_rt.values.model import Ack, Item, PutItem
from stampede_rt.values.payloads import check_attributes, check_payload
from stampede_rt.values.policy import ack_of, content_type_of
from stampede_rt.values.queueing import Enqueued, parse_message_id
from stampede_rt.values.reading import RENEW_S, Wait
from stampede_rt.values.timeline import DurationLike, InstantLike, parse_instant, parse_item_duration
from stampede_rt.wire.put_frames import enqueue_tail, put_head, put_request, put_tail
from stampede_rt.wire.records import ack_to_wire
from stampede_rt.wire.runs import run_parts


class ProducerNumbers:
    """The id of a producer and the numbers of its puts. The host uses them to recognise a repeated put."""

    def __init__(self) -> None:
        self.producer_id = int.from_bytes(os.urandom(8), "little") | 1
        self._numbers = itertools.count(1)

    def put_of(self, item: SingleItem) -> NumberedPut:
        """Return the put of an item, under a new number. Several threads may call it."""
        return NumberedPut(self.producer_id, next(self._numbers), item)


class NumberedPut(NamedTuple):
    """One item, and the number under which its producer puts it. A put that is repeated keeps its number."""

    producer_id: int
    number: int
    item: SingleItem


class Puts:
    """Performs the puts of one handle."""

    def __init__(
        self, session: Session, locator: Locator, open_stream: Callable[[ServerEndpoint], PutExchange]
    ) -> None:
        self._session = session
        self._locator = locator
        self._open_stream = open_stream
        self._handle_id = session.put_streams.handle(self)
        self._has_been_full = False  # whether the host refused a put without a wait because the channel was full

    def put(
        self, put: NumberedPut, wait: Wait, renew_s: float = RENEW_S, *, may_fill: bool = True
    ) -> channel_pb.PutAck:
        """Put one item under its number, so that it is safe to repeat. Returns the ack.

        `wait` bounds the wait for room. The client splits a long wait into several requests, so that it notices a host
        that hangs. The first request asks for a wait of at most `renew_s`, a later request of at most RENEW_S.

        `may_fill` False: as far as the handle knows, the channel drops its oldest items and is never full. On asyncio
        the put then uses a stream that all handles share, and asks for no wait: a wait would block the other handles.
        If the host says that the channel is full, another program has changed the policy. The client then repeats this
        put with its wait, and the handle uses streams of its own from then on.
        """
        if not (may_fill or self._has_been_full or PutExchange.one_at_a_time):
            try:
                return self._put(put, Wait(0.0), shares=True)
            except Full:
                self._has_been_full = True
                if wait.seconds == 0:
                    raise
        began_s = monotonic_s()
        while True:  # ends when the time of `wait` is over
            asked_s = monotonic_s()
            left = wait.after(asked_s - began_s)
            part = left if left.seconds is not None and left.seconds <= renew_s else Wait(renew_s)
            try:
                return self._put(put, part, shares=PutExchange.one_at_a_time)
            except NotReplicated:  # the next try repeats the put, and the host recognises it
                if part is left:
                    raise
            except (Full, NotArchived):
                # The host refused the put early: no put of this channel waits for room, or the disk fails.
                if part is left or monotonic_s() - asked_s < renew_s / 2:
                    raise
            renew_s = RENEW_S

    def _put(self, put: NumberedPut, wait: Wait, *, shares: bool) -> channel_pb.PutAck:
        """Put over a stream of this handle; with `shares` over a stream that all handles use."""
        seconds = wait.seconds or 0.0
        ends_s = monotonic_s() + seconds

        def put_at(binding: Binding, timeout_s: float) -> channel_pb.PutAck:
            left = Wait(max(ends_s - monotonic_s(), 0.0))  # a repeated put does not wait longer
            head = put_head(binding.subject_id, binding.epoch, put.producer_id)
            request = put_request(head, put.number, put.item.run_parts(), left.nanos, put.item.tail)
            owner = (self._open_stream, binding.target) if shares else self._handle_id
            blocks_until_s = 0.0 if shares else ends_s  # on a shared stream no put makes another one wait for room
            with self._session.put_streams.use(
                owner, blocks_until_s, binding, lambda: self._open_stream(self._session.endpoints.to(binding.target))
            ) as stream:
                ack = stream.put(request, timeout_s, survives_cancel=shares)
            return accepted(ack)

        return attempt(self._locator, put_at, seconds + CALL_TIMEOUT_S)

    def close(self) -> None:
        """Close the streams of this handle. A later put opens a new stream."""
        self._session.put_streams.close(self._handle_id)


def enqueued(ack: channel_pb.PutAck) -> Enqueued:
    """Return the ack of a queue as the value that a program gets."""
    return Enqueued(ack.first_seq, ack.duplicate, ack.incarnation, ack.copies or 1)


def accepted(ack: channel_pb.PutAck) -> channel_pb.PutAck:
    """Return the ack of one item. Raises the error with which the host has refused the item."""
    if ack.HasField("error"):
        raise from_error_message(ack.error)
    if ack.rejections:
        raise from_error_message(ack.rejections[0].error)
    return ack


@dataclass(frozen=True, slots=True)
class SingleItem:
    """One item with the checked arguments of a put."""

    payload: bytes
    time: int | None
    duration: int | None
    attributes: Mapping[str, str]
    content_type: str
    tail: bytes = b""
    """The encoded fields of the put after its run."""

    @classmethod
    def parse(
        cls,
        coding: HandleCodec | None,
        payload: Any,
        time: InstantLike | None,
        duration: DurationLike | int | None,
        attributes: Mapping[str, str] | None,
        content_type: str | None,
        message_id: str | None = None,
        ack: Ack | None = None,
    ) -> SingleItem:
        """Check the arguments of a put. `message_id` is for queues only, `ack` for channels only.

        Raises InvalidArgument, ItemTooLarge, CodecError.
        """
        check_attributes(attributes)
        message_id, ack = parse_message_id(message_id), ack_of(ack)
        return cls(
            coding.encode(payload) if coding else check_payload(payload),
            None if time is None else parse_instant(time),
            parse_item_duration(duration),
            dict(attributes or {}),
            content_type_of(content_type) or (coding.content_type if coding else ""),
            put_tail(ack_to_wire(ack)) if ack else enqueue_tail(message_id) if message_id else b"",
        )

    def accepted_as(self, state: ChannelState, ack: channel_pb.PutAck) -> Item:
        """Return the item as the host accepted it: with the time and seq of `ack`."""
        time = ack.stamped_unix_nano if self.time is None else self.time
        fields = (
            time,
            None if self.duration is None else time + self.duration,
            self.duration,
            ack.first_seq,
            self.payload,
            self.attributes,
            self.content_type or state.info.policy.content_type or "",
            len(self.payload),
            ack.incarnation,
        )
        item: PutItem = state.coding.item(fields) if state.coding else PutItem._make(fields)
        item.acknowledged_copies = ack.copies or 1  # without replicas the host leaves it out
        return item

    def run_parts(self) -> list[bytes]:
        """Return the encoded run that contains only this item."""
        return run_parts(
            (self.payload,),
            times=None if self.time is None else (self.time,),
            durations=None if self.duration is None else (self.duration,),
            content_type=self.content_type,
            attributes=self.attributes,
        )
