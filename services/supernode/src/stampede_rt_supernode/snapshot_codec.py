"""The whole directory, to and from the bytes of a snapshot.

Snapshots are written on the log's own thread, which must not stand still. The values are immutable, so what was written
for one is kept and used again: a snapshot costs time for what changed, and a copy of the rest. Each part is an encoded
message of its own, since to parse joined messages is to merge them (protobuf.dev, "Encoding", "Last One Wins").
"""

from __future__ import annotations

from stampede_rt.errors import StampedeError, VersionMismatch
from stampede_rt.v1 import directory_command_pb2 as pb
from stampede_rt_supernode.answered import Answer
from stampede_rt_supernode.command_codec import read_result, result_message
from stampede_rt_supernode.commands import Refused
from stampede_rt_supernode.directory import Directory
from stampede_rt_supernode.record_codec import channel_from, channel_record, host_entry, host_from
from stampede_rt_supernode.records import Channel

FORMAT_VERSION = 1


class SnapshotWriter:
    """Writes one snapshot after the other of one directory. Holds the encoded form of every channel and answer."""

    def __init__(self) -> None:
        self._channels: dict[bytes, tuple[Channel, bytes]] = {}
        self._answers: dict[bytes, tuple[Answer, bytes]] = {}

    def write(self, directory: Directory) -> bytes:
        """The state as of its applied index. The same state gives the same bytes on every replica."""
        tables = directory.tables
        channels = (tables.channels[channel_id] for channel_id in tables.channel_ids.values())
        self._channels = {channel.channel_id: self._channel_part(channel) for channel in channels}
        self._answers = {answer.op_id: self._answer_part(answer) for answer in directory.answered}
        parts = [part for _, part in (*self._channels.values(), *self._answers.values())]
        return b"".join([_head(directory), *parts])

    def _channel_part(self, channel: Channel) -> tuple[Channel, bytes]:
        held = self._channels.get(channel.channel_id)
        if held is not None and held[0] is channel:
            return held
        return channel, pb.DirectorySnapshot(channels=[channel_record(channel)]).SerializeToString()

    def _answer_part(self, answer: Answer) -> tuple[Answer, bytes]:
        held = self._answers.get(answer.op_id)
        if held is not None and held[0] is answer:
            return held
        message = pb.DirectorySnapshot(remembered_operations=[_remembered(answer)])
        return answer, message.SerializeToString(deterministic=True)


def _head(directory: Directory) -> bytes:
    hosts = directory.tables.hosts
    return pb.DirectorySnapshot(
        format_version=FORMAT_VERSION,
        applied_index=directory.applied_index,
        tenure=directory.tenure,
        cluster_id=directory.cluster_id,
        lease_ttl_nanos=directory.lease_ttl_nanos,
        hosts=[host_entry(hosts[host_id]) for host_id in sorted(hosts)],
    ).SerializeToString()


def _remembered(answer: Answer) -> pb.RememberedOperation:
    return pb.RememberedOperation(
        op_id=answer.op_id, log_index=answer.index, subject=answer.subject, result=result_message(answer.result)
    )


def encode_snapshot(directory: Directory) -> bytes:
    """One snapshot, with nothing kept."""
    return SnapshotWriter().write(directory)


def decode_snapshot(encoded: bytes) -> Directory:
    """The directory that was written. Raises DecodeError or VersionMismatch: do not go on without it."""
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
