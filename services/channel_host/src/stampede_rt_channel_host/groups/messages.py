"""Converts the times of channels from and to protobuf (`group.proto`)."""

from __future__ import annotations

from stampede_rt.v1 import group_pb2
from stampede_rt_channel_host.core.group import ChannelTimes


def times_to_message(channel_id: bytes, times: ChannelTimes, silent_nanos: int) -> group_pb2.ChannelTimes:
    """The message with a channel's times, as its owner sends it. `silent_nanos`: since the last put or advance."""
    return group_pb2.ChannelTimes(
        channel_id=channel_id,
        epoch=times.epoch,
        incarnation=times.incarnation,
        newest_unix_nano=times.newest,
        newest_end_unix_nano=times.newest_end,
        advance_unix_nano=times.advance,
        silent_nanos=silent_nanos,
    )


def times_from_message(message: group_pb2.ChannelTimes) -> ChannelTimes:
    """The times in a message of the channel's owner."""
    return ChannelTimes(
        epoch=message.epoch,
        incarnation=message.incarnation,
        newest=message.newest_unix_nano if message.HasField("newest_unix_nano") else None,
        newest_end=message.newest_end_unix_nano if message.HasField("newest_end_unix_nano") else None,
        advance=message.advance_unix_nano if message.HasField("advance_unix_nano") else None,
    )
