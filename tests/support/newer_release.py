"""Simulates a later release of the supernode, made from the present code, with one more kind of command.

The new kind is a field of DirectoryCommand that the present contract does not have. So it is unknown to the present
code, as each addition of a later release is. The command limits a channel to one item, and needs the next feature
level. Everything else is the present code: hello, log, directory, services.

`NewerReplica` is the directory of that release, for tests with several releases in one process. As a program, `python
-m tests.support.newer_release ARGUMENTS` is `stampede supernode ARGUMENTS` of that release: the names of the release
are put into the present modules before they run, and an UpdateChannel to one item goes into the log as the new kind.
"""

from __future__ import annotations

import sys
from unittest import mock

from google.protobuf.unknown_fields import UnknownFieldSet

from stampede_rt.v1.directory_command_pb2 import DirectoryCommand, UpdateChannelCommand
from stampede_rt.values.model import Policy
from stampede_rt_supernode.codecs.command_codec import decode_command, encode_command, kind_in, level_needed
from stampede_rt_supernode.core.channels.commands import UpdateChannel
from stampede_rt_supernode.core.cluster.feature_levels import HIGHEST_LEVEL
from stampede_rt_supernode.core.commands import Command
from stampede_rt_supernode.replica import DirectoryReplica

NEW_KIND, NEW_LEVEL = "cap_channel", HIGHEST_LEVEL + 1
NEW_FIELD = 90
CAPPED = Policy(max_items=1)


def _varint(number: int) -> bytes:
    low, rest = number & 0x7F, number >> 7
    return bytes((low,)) if not rest else bytes((low | 0x80,)) + _varint(rest)


def encode_cap(op_id: bytes, channel_id: bytes, epoch: int, *, as_of_index: int = 0) -> bytes:
    """Return a command of the new kind."""
    body = UpdateChannelCommand(channel_id=channel_id, epoch=epoch).SerializeToString()
    head = DirectoryCommand(op_id=op_id, as_of_index=as_of_index).SerializeToString()
    return head + _varint(NEW_FIELD << 3 | 2) + _varint(len(body)) + body


def encode_newer(command: Command) -> bytes:
    """Encode a command as the newer release does."""
    operation = command.operation
    if isinstance(operation, UpdateChannel) and operation.policy.max_items == CAPPED.max_items:
        return encode_cap(command.op_id, operation.channel_id, operation.epoch, as_of_index=command.as_of_index)
    return encode_command(command)


def _body_of(encoded: bytes) -> UpdateChannelCommand | None:
    message = DirectoryCommand.FromString(encoded)
    found = [field.data for field in UnknownFieldSet(message) if field.field_number == NEW_FIELD]
    return UpdateChannelCommand.FromString(found[0]) if found else None


def newer_kind_in(encoded: bytes) -> str:
    """Return the kind of a command, as the newer release names it."""
    return kind_in(encoded) or (NEW_KIND if _body_of(encoded) is not None else "")


def decode_newer(encoded: bytes) -> Command:
    """Decode a command as the newer release does."""
    body = None if kind_in(encoded) else _body_of(encoded)
    if body is None:
        return decode_command(encoded)
    head = DirectoryCommand.FromString(encoded)
    operation = UpdateChannel(channel_id=body.channel_id, epoch=body.epoch, policy=CAPPED)
    return Command(op_id=head.op_id, time_unix_nano=0, operation=operation, as_of_index=head.as_of_index)


def newer_level_needed(kind: str) -> int:
    """Return the level that a kind needs in the newer release."""
    return NEW_LEVEL if kind == NEW_KIND else level_needed(kind)


class NewerReplica(DirectoryReplica):
    """The directory of the newer release."""

    highest_level = NEW_LEVEL
    level_needed = staticmethod(newer_level_needed)
    kind_in = staticmethod(newer_kind_in)
    decode_command = staticmethod(decode_newer)


def main() -> int:
    """Run `stampede supernode` of the newer release; returns the exit code."""
    with (
        mock.patch("stampede_rt_supernode.app.DirectoryReplica", NewerReplica),
        mock.patch("stampede_rt_supernode.joining.preparing.DirectoryReplica", NewerReplica),
        mock.patch("stampede_rt_supernode.joining.join_requests.HIGHEST_LEVEL", NEW_LEVEL),
        mock.patch("stampede_rt_supernode.servicers.submission.encode_command", encode_newer),
    ):
        from stampede_rt_supernode.app import main as run

        return run()


if __name__ == "__main__":
    sys.exit(main())
