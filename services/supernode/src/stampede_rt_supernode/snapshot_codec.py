"""The whole directory, to and from the bytes of a snapshot."""

from __future__ import annotations

from stampede_rt.errors import StampedeError, VersionMismatch
from stampede_rt.v1 import directory_command_pb2 as pb
from stampede_rt_supernode.answered import Answer
from stampede_rt_supernode.command_codec import read_result, result_message
from stampede_rt_supernode.commands import Refused
from stampede_rt_supernode.directory import Directory
from stampede_rt_supernode.record_codec import channel_from, channel_record, host_entry, host_from

FORMAT_VERSION = 1


def encode_snapshot(directory: Directory) -> bytes:
    """The state as of its applied index. The same state gives the same bytes on every replica."""
    tables = directory.tables
    return pb.DirectorySnapshot(
        format_version=FORMAT_VERSION,
        applied_index=directory.applied_index,
        tenure=directory.tenure,
        cluster_id=directory.cluster_id,
        lease_ttl_nanos=directory.lease_ttl_nanos,
        hosts=[host_entry(tables.hosts[host_id]) for host_id in sorted(tables.hosts)],
        channels=[channel_record(tables.channels[channel_id]) for channel_id in tables.channel_ids.values()],
        remembered_operations=[_remembered(answer) for answer in directory.answered],
    ).SerializeToString(deterministic=True)


def _remembered(answer: Answer) -> pb.RememberedOperation:
    return pb.RememberedOperation(
        op_id=answer.op_id, log_index=answer.index, subject=answer.subject, result=result_message(answer.result)
    )


def decode_snapshot(encoded: bytes) -> Directory:
    """The directory that `encode_snapshot` wrote. Raises DecodeError or VersionMismatch: do not go on without it."""
    message = pb.DirectorySnapshot.FromString(encoded)
    if message.format_version != FORMAT_VERSION:
        raise VersionMismatch(
            f"the snapshot has format {message.format_version}, this supernode reads {FORMAT_VERSION}; run the version "
            "that wrote it"
        )
    return Directory(
        index=message.applied_index,
        tenure=message.tenure,
        cluster_id=message.cluster_id,
        lease_ttl_nanos=message.lease_ttl_nanos,
        hosts=[host_from(entry) for entry in message.hosts],
        channels=[channel_from(record) for record in message.channels],
        answers=[_answer(operation) for operation in message.remembered_operations],
    )


def _answer(operation: pb.RememberedOperation) -> Answer:
    result = read_result(operation.result)
    if isinstance(result, Refused):
        raise StampedeError("the snapshot remembers a refusal, which no supernode writes; it is damaged")
    return Answer(operation.op_id, operation.log_index, operation.subject, result)
