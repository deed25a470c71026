"""Checks the requests of ChannelService and turns them into the core's values."""

from __future__ import annotations

from typing import Any, Protocol, TypeVar

from google.protobuf.message import DecodeError
from grpc.aio import EOF

from stampede_rt.errors import InvalidArgument
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.v1 import item_pb2
from stampede_rt.values.timeline import clamp
from stampede_rt.wire.reads import bound_from_message, interval_from_message, match_from_message
from stampede_rt_channel_host.channels.copy_state import Freshness
from stampede_rt_channel_host.channels.group_access import GroupReadParams
from stampede_rt_channel_host.core.channel import Position, Query, SavedCursor

_SEQ_MAX = 2**64 - 1

M = TypeVar("M", covariant=True)


class MessageType(Protocol[M]):
    """A type of messages."""

    def FromString(self, data: bytes, /) -> M:  # noqa: N802
        """Decode a message."""


def parse(kind: MessageType[M], raw: bytes, name: str) -> M:
    """Decode a request. Raises InvalidArgument if the bytes are no such message."""
    try:
        return kind.FromString(raw)
    except DecodeError as error:
        raise InvalidArgument(
            f"the request is not a valid {name} message; encode it from channel_service.proto"
        ) from error


def opening_of(raw: Any, kind: MessageType[M], name: str) -> M:
    """Decode the first request of a stream. Raises InvalidArgument if it is missing, invalid, or without `open`."""
    request: Any = None if raw is EOF else parse(kind, raw, name)
    if request is None or not request.HasField("open"):
        raise InvalidArgument(f"the first {name} of the stream has no open; send it before anything else")
    return request  # type: ignore[no-any-return]


def query_of(request: pb.GetRequest) -> Query:
    """The query of a get. Raises InvalidArgument or InvalidInterval for a missing or invalid field."""
    if not request.HasField("interval"):
        raise InvalidArgument("the get has no interval; set its start and end")
    return Query(
        interval=interval_from_message(request.interval),
        match=match_from_message(request.match),
        limit=request.limit if request.HasField("limit") else None,
        newest_first=request.newest_first,
        after=position_of(request.after) if request.HasField("after") else None,
        newer_than=position_of(request.newer_than) if request.HasField("newer_than") else None,
        now=request.now_unix_nano if request.HasField("now_unix_nano") else None,
        complete=request.complete,
    )


def wait_nanos_of(request: pb.GetRequest) -> int:
    """The time in nanoseconds that the get may wait. 0: not at all. -1: until the stream ends.

    Raises InvalidArgument for a number below -1.
    """
    if request.wait_nanos < -1:
        raise InvalidArgument(f"wait_nanos is {request.wait_nanos}; it is 0 or more, or -1 for no limit")
    return request.wait_nanos


def demand_of(request: pb.GetRequest) -> Freshness | None:
    """The get's demands on a copy; None: it accepts no copy. Raises InvalidArgument for a negative staleness."""
    stale = request.max_staleness_nanos if request.HasField("max_staleness_nanos") else None
    least = request.least_seq if request.HasField("least_seq") else None
    if stale is not None and stale < 0:
        raise InvalidArgument(f"max_staleness_nanos is {stale}; it is 0 or more, or left out")
    return None if stale is None and least is None else Freshness(stale, least)


def wanted_next_seq(opening: pb.SubscribeOpen) -> int:
    """The next seq that a copy must have before the subscription can continue there; 0: any."""
    which = opening.WhichOneof("begin")
    if which == "cursor":
        return opening.cursor.next_seq
    return opening.after.seq + 1 if which == "after" and opening.after.HasField("seq") else 0


def position_of(message: item_pb2.ItemPosition) -> Position:
    """A position in the order of items."""
    seq = message.seq if message.HasField("seq") else None
    return Position(message.time_unix_nano, seq, message.incarnation)


def position_to(position: Position) -> item_pb2.ItemPosition:
    """A position as a message."""
    return item_pb2.ItemPosition(time_unix_nano=position.time, seq=position.seq, incarnation=position.incarnation)


def is_newest(opening: pb.SubscribeOpen) -> bool:
    """Whether the reader wants only the newest items. Raises InvalidArgument for a mode unknown to this host."""
    if opening.mode in (pb.SUBSCRIBE_MODE_UNSPECIFIED, pb.SUBSCRIBE_MODE_ALL):
        return False
    if opening.mode == pb.SUBSCRIBE_MODE_NEWEST:
        return True
    raise InvalidArgument(f"mode is {opening.mode}; use a value of stampede_rt.v1.SubscribeMode")


def beginning_of(opening: pb.SubscribeOpen) -> dict[str, Any]:
    """The place where a subscription begins, as keyword arguments of the core's methods that subscribe.

    Raises InvalidArgument for an unusable bound.
    """
    which = opening.WhichOneof("begin")
    if which == "start":
        start = bound_from_message(opening.start, "the subscription's start")
        return {"start": start, "start_exclusive": opening.start.exclusive}
    if which == "after":
        return {"after": position_of(opening.after)}
    return {"saved": saved_of(opening.cursor)} if which == "cursor" else {}


def saved_of(cursor: pb.SubscriptionCursor) -> SavedCursor:
    """The saved cursor of a message, from which a subscription continues."""
    return SavedCursor(
        incarnation=cursor.incarnation,
        next_seq=max(1, cursor.next_seq),
        low=(cursor.from_unix_nano, cursor.from_seq) if cursor.HasField("from_unix_nano") else None,
        live_seq=cursor.live_seq,
        cut=cursor.cut_unix_nano if cursor.HasField("cut_unix_nano") else None,
    )


def saved_to(saved: SavedCursor) -> pb.SubscriptionCursor:
    """A saved cursor as a message."""
    cursor = pb.SubscriptionCursor(
        incarnation=saved.incarnation, next_seq=saved.next_seq, live_seq=saved.live_seq, cut_unix_nano=saved.cut
    )
    if saved.low is not None:
        cursor.from_unix_nano, cursor.from_seq = clamp(saved.low[0]), min(saved.low[1], _SEQ_MAX)
    return cursor


def group_of(request: pb.GetRequest) -> GroupReadParams | None:
    """The group through which the get reads; None: the get reads the whole channel."""
    if not request.HasField("group_id"):
        return None
    return GroupReadParams(
        group_id=request.group_id,
        floor=request.cut_floor_unix_nano if request.HasField("cut_floor_unix_nano") else None,
        at=request.cut_unix_nano if request.HasField("cut_unix_nano") else None,
        within_memory=request.within_memory,
        as_of=request.as_of_unix_nano if request.HasField("as_of_unix_nano") else None,
    )
