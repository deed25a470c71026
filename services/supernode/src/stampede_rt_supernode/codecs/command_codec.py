"""Converts commands and results from and to the bytes in the replicated log. Makes no decisions."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from google.protobuf.message import DecodeError

from stampede_rt.errors import InvalidArgument, StampedeError, VersionMismatch
from stampede_rt.v1 import directory_command_pb2 as pb
from stampede_rt_supernode.codecs import (
    access_kinds,
    channel_kinds,
    cluster_kinds,
    group_kinds,
    host_kinds,
    move_kinds,
    peer_kinds,
    queue_kinds,
    quota_kinds,
    replica_kinds,
)
from stampede_rt_supernode.codecs.kind_codec import KindCodec
from stampede_rt_supernode.core.cluster.feature_levels import HIGHEST_LEVEL
from stampede_rt_supernode.core.command_table import FEATURE_LEVELS
from stampede_rt_supernode.core.commands import Command, Operation, RefusedOperation, Result, Success

CODECS: tuple[KindCodec[Any, Any, Any, Any], ...] = (
    *access_kinds.CODECS,
    *channel_kinds.CODECS,
    *cluster_kinds.CODECS,
    *group_kinds.CODECS,
    *host_kinds.CODECS,
    *move_kinds.CODECS,
    *peer_kinds.CODECS,
    *queue_kinds.CODECS,
    *quota_kinds.CODECS,
    *replica_kinds.CODECS,
)
_BY_OPERATION: Mapping[type[Operation], KindCodec[Any, Any, Any, Any]] = MappingProxyType(
    {one.operation: one for one in CODECS}
)
_BY_KIND: Mapping[str | None, KindCodec[Any, Any, Any, Any]] = MappingProxyType({one.kind: one for one in CODECS})
_BY_RESULT: Mapping[type[Success], KindCodec[Any, Any, Any, Any]] = MappingProxyType(
    {one.result: one for one in CODECS}
)
_BY_OUTCOME: Mapping[str | None, KindCodec[Any, Any, Any, Any]] = MappingProxyType({one.outcome: one for one in CODECS})


def encode_command(command: Command) -> bytes:
    """The bytes of a command, to be proposed to the log."""
    codec = _BY_OPERATION[type(command.operation)]
    kind: dict[str, Any] = {codec.kind: codec.write(command.operation)}
    return pb.DirectoryCommand(
        op_id=command.op_id,
        time_unix_nano=command.time_unix_nano,
        as_of_index=command.as_of_index,
        caller=command.caller,
        **kind,
    ).SerializeToString()


def kind_in(encoded: bytes) -> str:
    """The name of the command's kind in the `.proto` file; empty for a kind that this release does not know."""
    try:
        return pb.DirectoryCommand.FromString(encoded).WhichOneof("kind") or ""
    except DecodeError:
        return ""


def level_needed(kind: str) -> int:
    """The feature level that a kind of command needs. For an unknown kind, a level above all known levels."""
    codec = _BY_KIND.get(kind)
    return HIGHEST_LEVEL + 1 if codec is None else FEATURE_LEVELS[codec.operation]


def decode_command(encoded: bytes) -> Command:
    """The command. Raises InvalidArgument for invalid bytes, VersionMismatch for an unknown kind."""
    try:
        message = pb.DirectoryCommand.FromString(encoded)
    except DecodeError:
        raise InvalidArgument(
            "the log entry is not a directory command; a supernode of another version wrote it"
        ) from None
    return Command(
        op_id=message.op_id,
        time_unix_nano=message.time_unix_nano,
        operation=_read_operation(message),
        as_of_index=message.as_of_index,
        caller=message.caller,
    )


def _read_operation(message: pb.DirectoryCommand) -> Operation:
    codec = _BY_KIND.get(message.WhichOneof("kind"))
    if codec is None:
        raise VersionMismatch(
            "this supernode does not know that kind of directory command; bring all supernodes to one version"
        )
    operation: Operation = codec.read(getattr(message, codec.kind))
    return operation


def result_message(result: Result) -> pb.DirectoryResult:
    """The message of a result."""
    if isinstance(result, RefusedOperation):
        refused = pb.RefusedResult(reason=result.reason, message=result.message, metadata=dict(result.metadata))
        return pb.DirectoryResult(refused=refused)
    codec = _BY_RESULT[type(result)]
    outcome: dict[str, Any] = {codec.outcome: codec.write_result(result)}
    return pb.DirectoryResult(**outcome)


def encode_result(result: Result) -> bytes:
    """The bytes of a result, as `DirectoryReplica.apply` returns them. Equal results give equal bytes."""
    return result_message(result).SerializeToString(deterministic=True)


def read_result(message: pb.DirectoryResult) -> Result:
    """The result of a message. Raises StampedeError for an unknown outcome."""
    if message.HasField("refused"):
        refused = message.refused
        return RefusedOperation(reason=refused.reason, message=refused.message, metadata=dict(refused.metadata))
    codec = _BY_OUTCOME.get(message.WhichOneof("outcome"))
    if codec is None:
        raise StampedeError("the replicated log gave a result that this supernode does not know; report this")
    result: Success = codec.read_result(getattr(message, codec.outcome))
    return result


def decode_result(encoded: bytes) -> Result:
    """The result that `encode_result` wrote."""
    return read_result(pb.DirectoryResult.FromString(encoded))
