"""Converts the cuts of groups (`CutFloor`), which hosts send to each other, from and to protobuf (`group.proto`)."""

from __future__ import annotations

from stampede_rt.v1 import group_pb2
from stampede_rt_channel_host.core.group import CutFloor


def floor_to_message(floor: CutFloor) -> group_pb2.CutFloor:
    """The message in which a host sends its cut of a group to other hosts."""
    return group_pb2.CutFloor(
        group_id=floor.group_id,
        incarnation=floor.incarnation,
        cut_unix_nano=floor.cut,
        spec_version=floor.spec_version,
    )


def floor_from_message(message: group_pb2.CutFloor) -> CutFloor:
    """The cut of a group that another host has sent in a message."""
    return CutFloor(message.group_id, message.incarnation, message.cut_unix_nano, message.spec_version)
