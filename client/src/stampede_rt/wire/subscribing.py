"""The beginning of a subscription as a message."""

from __future__ import annotations

from stampede_rt.errors import InvalidArgument
from stampede_rt.v1 import channel_service_pb2 as channel_pb
from stampede_rt.values.model import Item
from stampede_rt.values.reading import SubscribeMode
from stampede_rt.values.timeline import Bound
from stampede_rt.wire.reads import bound_to_message, position_of

_MODES = {"all": channel_pb.SUBSCRIBE_MODE_ALL, "newest": channel_pb.SUBSCRIBE_MODE_NEWEST}


def beginning(start: Bound | None, mode: SubscribeMode, after: Item | None) -> channel_pb.SubscribeOpen:
    """Return the first message of a subscription, with its mode and its beginning. Raises InvalidArgument."""
    if mode not in _MODES:
        raise InvalidArgument(f'mode is {mode!r}; write "all" or "newest"')
    if start is not None and after is not None:
        raise InvalidArgument("start and after exclude each other; give start to begin, or after to resume")
    if after is not None and not isinstance(after, Item):
        raise InvalidArgument(f"after is {after!r}; give the last Item received, or use start for a time")
    opening = channel_pb.SubscribeOpen(mode=_MODES[mode])
    if start is not None:
        opening.start.CopyFrom(bound_to_message(start))
    if after is not None:
        opening.after.CopyFrom(position_of(after))
    return opening
