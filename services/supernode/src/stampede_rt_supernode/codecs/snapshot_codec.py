"""Converts the whole directory from and to the bytes of a snapshot.

A worker thread encodes a snapshot while the supernode applies further commands. The records are immutable, so the
writer keeps their encoded forms for the next snapshot. Then it encodes only the changed records, and copies the rest.
Each record is encoded as a message of its own, and the snapshot is their concatenation: protobuf merges concatenated
messages when it decodes them (protobuf.dev, "Encoding", "Last One Wins").
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from sys import intern
from typing import Generic, TypeVar

from sortedcontainers import SortedDict

from stampede_rt.errors import StampedeError, VersionMismatch
from stampede_rt.v1 import directory_command_pb2 as pb
from stampede_rt_runtime.access.messages import rule_from, rule_message
from stampede_rt_runtime.access.rules import AccessRules
from stampede_rt_runtime.quotas.limits import QuotaTable
from stampede_rt_runtime.quotas.messages import setting_from, setting_message
from stampede_rt_supernode.codecs.command_codec import read_result, result_message
from stampede_rt_supernode.codecs.group_codec import group_entry, group_entry_from
from stampede_rt_supernode.codecs.host_codec import host_entry, host_from
from stampede_rt_supernode.codecs.peer_codec import peer_entry, peer_from
from stampede_rt_supernode.codecs.queue_codec import queue_from, queue_record
from stampede_rt_supernode.codecs.record_codec import channel_from, channel_record
from stampede_rt_supernode.codecs.replica_codec import replica_from, replica_record
from stampede_rt_supernode.core.access.table import AccessTable
from stampede_rt_supernode.core.commands import RefusedOperation
from stampede_rt_supernode.core.directory import Directory
from stampede_rt_supernode.core.groups.table import GroupWithWitnesses
from stampede_rt_supernode.core.kept_answers import KeptAnswer
from stampede_rt_supernode.core.records import (
    ChangeKind,
    ChannelRecord,
    DirectoryChange,
    PeerRecord,
    QueueRecord,
    ReplicaRecord,
)
from stampede_rt_supernode.core.snapshot_view import SnapshotView, snapshot_view
from stampede_rt_supernode.core.tables import Tables

FORMAT_VERSION = 1
# The snapshot has groups or copies of channels, which a reader of version 1 would lose in silence.
FORMAT_VERSION_WITH_GROUPS = 2
# The snapshot has queues or peers, which a reader of version 2 would lose in silence.
FORMAT_VERSION_WITH_QUEUES = 3

T = TypeVar("T")


class SnapshotWriter:
    """Writes the snapshots of one directory, one after the other.

    Between two snapshots it keeps the encoded forms of all channels, groups, copies, queues, peers and answers.
    """

    def __init__(self) -> None:
        self._channels = _ChannelParts()
        self._groups: _Parts[GroupWithWitnesses] = _Parts(lambda one: pb.DirectorySnapshot(groups=[group_entry(*one)]))
        self._replicas: _Parts[tuple[ReplicaRecord, ...]] = _Parts(
            lambda copies: pb.DirectorySnapshot(replicas=[replica_record(one) for one in copies])
        )
        self._queues: _Parts[QueueRecord] = _Parts(lambda one: pb.DirectorySnapshot(queues=[queue_record(one)]))
        self._peers: _Parts[PeerRecord] = _Parts(lambda one: pb.DirectorySnapshot(peers=[peer_entry(one)]))
        self._answers: _Parts[KeptAnswer] = _Parts(
            lambda answer: pb.DirectorySnapshot(remembered_operations=[_remembered(answer)])
        )

    def begin(self, directory: Directory) -> Callable[[], bytes]:
        """Take a view of the present state. Returns a function that encodes the view, on any thread.

        Call that function before the next `begin`. The same state gives the same bytes on every replica.
        """
        view = snapshot_view(directory, self._channels.position)
        return lambda: self._write(view)

    def _write(self, view: SnapshotView) -> bytes:
        directory, tables = view.directory, view.directory.tables
        return b"".join(
            [
                _head(directory),
                *self._channels.encode(view),
                *self._groups.encode(tables.groups.entries()),
                *self._replicas.encode(tables.replicas.entries()),
                *self._queues.encode(sorted(tables.queues.by_id.items())),
                *self._peers.encode(sorted(tables.peers.by_id.items())),
                *self._answers.encode((answer.op_id, answer) for answer in directory.kept_answers),
            ]
        )


class _ChannelParts:
    """The encoded forms of all channels as of the last snapshot.

    `position`: the position of the view that this snapshot encoded; None before the first snapshot.
    """

    def __init__(self) -> None:
        self.position: int | None = None
        self._by_name: SortedDict[str, bytes] = SortedDict()

    def encode(self, view: SnapshotView) -> Iterator[bytes]:
        """A part for each channel, by name."""
        if view.changes is None:
            self._by_name = SortedDict({channel.name: _channel_part(channel) for channel in view.channels})
        else:
            self._follow(view.changes)
        self.position = view.position
        return iter(self._by_name.values())

    def _follow(self, changes: Iterable[DirectoryChange]) -> None:
        last = {change.subject.name: change for change in changes if isinstance(change.subject, ChannelRecord)}
        for name, change in last.items():
            assert isinstance(change.subject, ChannelRecord)
            if change.kind is ChangeKind.REMOVED:
                self._by_name.pop(name, None)
            else:
                self._by_name[name] = _channel_part(change.subject)


def _channel_part(channel: ChannelRecord) -> bytes:
    return pb.DirectorySnapshot(channels=[channel_record(channel)]).SerializeToString(deterministic=True)


class _Parts(Generic[T]):
    """The encoded forms of values by id. A value that is still the same object is not encoded again."""

    def __init__(self, message: Callable[[T], pb.DirectorySnapshot]) -> None:
        self._message = message
        self._held: dict[bytes, tuple[T, bytes]] = {}

    def encode(self, values: Iterable[tuple[bytes, T]]) -> list[bytes]:
        """A part for each (id, value), in the same order. Forgets all other parts."""
        self._held = {one: self._part(one, value) for one, value in values}
        return [part for _, part in self._held.values()]

    def _part(self, one: bytes, value: T) -> tuple[T, bytes]:
        held = self._held.get(one)
        if held is not None and held[0] is value:
            return held
        return value, self._message(value).SerializeToString(deterministic=True)


def _head(directory: Directory) -> bytes:
    tables, hosts = directory.tables, directory.tables.hosts
    return pb.DirectorySnapshot(
        format_version=_format_of(tables),
        applied_index=directory.applied_index,
        tenure=directory.tenure,
        cluster_id=directory.cluster_id,
        lease_ttl_nanos=directory.lease_ttl_nanos,
        hosts=[host_entry(hosts[host_id]) for host_id in sorted(hosts)],
        time_marks=directory.kept_answers.marks,
        former_cluster_ids=directory.former_cluster_ids,
        join_key=directory.join_key,
        digest=directory.digest,
        feature_level=directory.feature_level,
        # A release that does not know the following fields refuses the snapshot for its feature level.
        access_rules=map(rule_message, directory.access.rules.rules),
        token_key=directory.access.token_key,
        access_version=directory.access.version,
        revoked_serials=directory.access.revoked_serials,
        quotas=map(setting_message, directory.access.quotas.settings),
    ).SerializeToString()


def _format_of(tables: Tables) -> int:
    """The lowest format version that holds the tables, so that supernodes of older versions can read most snapshots."""
    if tables.queues or tables.peers:
        return FORMAT_VERSION_WITH_QUEUES
    return FORMAT_VERSION_WITH_GROUPS if tables.groups or tables.replicas else FORMAT_VERSION


def _remembered(answer: KeptAnswer) -> pb.RememberedOperation:
    return pb.RememberedOperation(
        op_id=answer.op_id,
        log_index=answer.index,
        subject=answer.subject,
        result=result_message(answer.result),
        caller=answer.caller,
    )


def encode_snapshot(directory: Directory) -> bytes:
    """The bytes of one snapshot. Keeps no encoded forms for another snapshot."""
    return SnapshotWriter().begin(directory)()


def decode_snapshot(encoded: bytes) -> Directory:
    """The directory in a snapshot. Raises StampedeError if the snapshot is damaged or of another version."""
    try:
        return _directory(pb.DirectorySnapshot.FromString(encoded))
    except StampedeError:
        raise
    except Exception as error:  # the bytes may be no snapshot, or its records may contradict each other
        raise StampedeError(f"the snapshot holds no directory ({error!r}); use another one") from error


def _directory(message: pb.DirectorySnapshot) -> Directory:
    if not FORMAT_VERSION <= message.format_version <= FORMAT_VERSION_WITH_QUEUES:
        raise VersionMismatch(
            f"the snapshot has format {message.format_version}, this supernode reads {FORMAT_VERSION} to "
            f"{FORMAT_VERSION_WITH_QUEUES}; run the version that wrote it"
        )
    return Directory(
        index=message.applied_index,
        tenure=message.tenure,
        cluster_id=message.cluster_id,
        lease_ttl_nanos=message.lease_ttl_nanos,
        hosts=[host_from(entry) for entry in message.hosts],
        channels=[channel_from(record) for record in message.channels],
        groups=[group_entry_from(entry) for entry in message.groups],
        replicas=[replica_from(record) for record in message.replicas],
        queues=[queue_from(record) for record in message.queues],
        peers=[peer_from(entry) for entry in message.peers],
        answers=[_answer(operation) for operation in message.remembered_operations],
        time_marks=message.time_marks,
        former_cluster_ids=message.former_cluster_ids,
        join_key=message.join_key,
        digest=message.digest,
        feature_level=message.feature_level,
        access=AccessTable(
            version=message.access_version,
            rules=AccessRules(map(rule_from, message.access_rules)),
            token_key=message.token_key,
            revoked_serials=tuple(message.revoked_serials),
            quotas=QuotaTable(map(setting_from, message.quotas)),
        ),
    )


def _answer(operation: pb.RememberedOperation) -> KeptAnswer:
    result = read_result(operation.result)
    if isinstance(result, RefusedOperation):
        raise StampedeError("the snapshot remembers a refusal, which no supernode writes; it is damaged")
    return KeptAnswer(operation.op_id, operation.log_index, operation.subject, result, intern(operation.caller))
