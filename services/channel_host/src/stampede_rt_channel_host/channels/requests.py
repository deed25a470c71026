"""What arrives at ChannelService, checked and turned into the core's values."""

from __future__ import annotations

from typing import Protocol, TypeVar

from google.protobuf.message import DecodeError

from stampede_rt.errors import InvalidArgument
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.v1 import item_pb2
from stampede_rt.wire.reads import interval_from_message, match_from_message
from stampede_rt_channel_host.channels.group_access import GroupAsk
from stampede_rt_channel_host.core.channel import Position, Query

M = TypeVar("M", covariant=True)


class _Message(Protocol[M]):
    def FromString(self, data: bytes, /) -> M: ...  # noqa: N802


def parse(kind: _Message[M], raw: bytes, name: str) -> M:
    """The request message. Raises InvalidArgument if the bytes are none."""
    try:
        return kind.FromString(raw)
    except DecodeError as error:
        raise InvalidArgument(
            f"the request is no valid {name} message; encode it from channel_service.proto"
        ) from error


def query_of(request: pb.GetRequest) -> Query:
    """What a get asks for. Raises InvalidArgument, InvalidInterval."""
    if not request.HasField("interval"):
        raise InvalidArgument("the get has no interval; set its start and end")
    return Query(
        interval=interval_from_message(request.interval),
        match=match_from_message(request.match),
        limit=request.limit if request.HasField("limit") else None,
        newest_first=request.newest_first,
        after=position_of(request.after) if request.HasField("after") else None,
        newer_than=position_of(request.newer_than) if request.HasField("newer_than") else None,
        complete=request.complete,
    )


def wait_nanos_of(request: pb.GetRequest) -> int:
    """How long the get may block: 0 not at all, -1 as long as the stream lives. Raises InvalidArgument."""
    if request.wait_nanos < -1:
        raise InvalidArgument(f"wait_nanos is {request.wait_nanos}; it is 0 or more, or -1 for no limit")
    return request.wait_nanos


def position_of(message: item_pb2.ItemPosition) -> Position:
    """A place in the order of items."""
    seq = message.seq if message.HasField("seq") else None
    return Position(message.time_unix_nano, seq, message.incarnation)


def position_to(position: Position) -> item_pb2.ItemPosition:
    """The same as a message."""
    return item_pb2.ItemPosition(time_unix_nano=position.time, seq=position.seq, incarnation=position.incarnation)


def group_of(request: pb.GetRequest) -> GroupAsk | None:
    """The group that the get reads through; None: the whole channel."""
    if not request.HasField("group_id"):
        return None
    return GroupAsk(
        group_id=request.group_id,
        floor=request.cut_floor_unix_nano if request.HasField("cut_floor_unix_nano") else None,
        at=request.cut_unix_nano if request.HasField("cut_unix_nano") else None,
    )
