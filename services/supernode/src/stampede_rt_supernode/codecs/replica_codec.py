"""Copies of channels and what is done to them, to and from the messages that carry them. Thin: decides nothing."""

from __future__ import annotations

from stampede_rt.errors import InvalidArgument, StampedeError
from stampede_rt.v1 import directory_command_pb2 as pb
from stampede_rt.v1 import replica_pb2, subject_pb2
from stampede_rt_supernode.codecs.host_codec import host_entry, host_from
from stampede_rt_supernode.core.commands import ReplicaOperation, ReplicaSuccess
from stampede_rt_supernode.core.records import Replica, ReplicaKind
from stampede_rt_supernode.core.replicas.commands import (
    AddReplica,
    RemoveReplica,
    ReplicaAdded,
    ReplicaInSyncSet,
    ReplicaRemoved,
    SetReplicaInSync,
)
from stampede_rt_supernode.core.replicas.loads import ReplicaLoad

_KINDS_TO_WIRE = {
    ReplicaKind.PROXY: replica_pb2.REPLICA_KIND_PROXY,
    ReplicaKind.WARM: replica_pb2.REPLICA_KIND_WARM,
}
_KINDS_FROM_WIRE = {wire: kind for kind, wire in _KINDS_TO_WIRE.items()}

REPLICA_OPERATIONS = ("add_replica", "remove_replica", "set_replica_in_sync")
REPLICA_OUTCOMES = ("replica_added", "replica_removed", "replica_in_sync_set")


def kind_from(kind: replica_pb2.ReplicaKind) -> ReplicaKind:
    """Raises InvalidArgument for a kind that nobody can ask for."""
    if kind not in _KINDS_FROM_WIRE:
        raise InvalidArgument(
            f"kind is {kind}; state REPLICA_KIND_PROXY or REPLICA_KIND_WARM: moves make their copies themselves",
            metadata={"field": "kind"},
        )
    return _KINDS_FROM_WIRE[kind]


def channel_id_of(subject: subject_pb2.Subject) -> bytes:
    """The channel that is meant. Raises InvalidArgument without one, QUEUE_NOT_FOUND for a queue, not copied yet."""
    if subject.WhichOneof("id") == "queue_id":
        shown = subject.queue_id.hex()
        text = f"queue {shown} cannot be copied: this version copies channels only; name one by its channel_id"
        raise StampedeError(text, reason="QUEUE_NOT_FOUND", metadata={"queue_id": shown})
    return subject.channel_id


def subject_of(channel_id: bytes) -> subject_pb2.Subject:
    """The channel as a subject."""
    return subject_pb2.Subject(channel_id=channel_id)


def replica_record(replica: Replica) -> replica_pb2.ReplicaRecord:
    """The copy as it travels."""
    return replica_pb2.ReplicaRecord(
        subject=subject_of(replica.channel_id),
        host_id=replica.host_id,
        boot_incarnation=replica.boot_incarnation,
        kind=_KINDS_TO_WIRE[replica.kind],
        source_host_id=replica.source_host_id,
        in_sync=replica.in_sync,
        acknowledged=replica.acknowledged,
        epoch=replica.epoch,
    )


def replica_from(record: replica_pb2.ReplicaRecord) -> Replica:
    """The copy of a record that this codec wrote."""
    return Replica(
        channel_id=channel_id_of(record.subject),
        host_id=record.host_id,
        boot_incarnation=record.boot_incarnation,
        kind=kind_from(record.kind),
        source_host_id=record.source_host_id,
        in_sync=record.in_sync,
        acknowledged=record.acknowledged,
        epoch=record.epoch,
    )


def load_message(load: ReplicaLoad) -> replica_pb2.ReplicaLoad:
    """How busy somebody is, as it travels."""
    return replica_pb2.ReplicaLoad(
        subject=subject_of(load.channel_id),
        host_id=load.host_id,
        subscriptions=load.subscriptions,
        delivered_bytes_per_second=load.delivered_bytes_per_second,
        next_seq=load.next_seq,
        lag_nanos=load.lag_nanos,
    )


def load_from(message: replica_pb2.ReplicaLoad) -> ReplicaLoad:
    """What a host tells. Raises as `channel_id_of`."""
    return ReplicaLoad(
        channel_id=channel_id_of(message.subject),
        host_id=message.host_id,
        subscriptions=message.subscriptions,
        delivered_bytes_per_second=message.delivered_bytes_per_second,
        next_seq=message.next_seq,
        lag_nanos=message.lag_nanos,
    )


def write_replica_operation(message: pb.DirectoryCommand, operation: ReplicaOperation) -> None:
    """Into the command's oneof."""
    subject = subject_of(operation.channel_id)
    match operation:
        case AddReplica():
            message.add_replica.CopyFrom(_add_message(operation))
        case RemoveReplica(host_id=host_id):
            message.remove_replica.CopyFrom(pb.RemoveReplicaCommand(subject=subject, host_id=host_id))
        case SetReplicaInSync():
            said = pb.SetReplicaInSyncCommand(
                subject=subject,
                epoch=operation.epoch,
                host_id=operation.host_id,
                boot_incarnation=operation.boot_incarnation,
                in_sync=operation.in_sync,
            )
            message.set_replica_in_sync.CopyFrom(said)


def _add_message(operation: AddReplica) -> pb.AddReplicaCommand:
    return pb.AddReplicaCommand(
        subject=subject_of(operation.channel_id),
        epoch=operation.epoch,
        host_id=operation.host_id,
        kind=_KINDS_TO_WIRE[operation.kind],
        source_host_id=operation.source_host_id,
        acknowledged=operation.acknowledged,
    )


def read_replica_operation(message: pb.DirectoryCommand) -> ReplicaOperation:
    """Of a command whose kind is one of REPLICA_OPERATIONS. Raises InvalidArgument."""
    if message.HasField("add_replica"):
        return _read_add(message.add_replica)
    if message.HasField("remove_replica"):
        gone = message.remove_replica
        return RemoveReplica(channel_id=channel_id_of(gone.subject), host_id=gone.host_id)
    said = message.set_replica_in_sync
    return SetReplicaInSync(
        channel_id=channel_id_of(said.subject),
        epoch=said.epoch,
        host_id=said.host_id,
        boot_incarnation=said.boot_incarnation,
        in_sync=said.in_sync,
    )


def _read_add(message: pb.AddReplicaCommand) -> AddReplica:
    return AddReplica(
        channel_id=channel_id_of(message.subject),
        epoch=message.epoch,
        host_id=message.host_id,
        kind=kind_from(message.kind),
        source_host_id=message.source_host_id,
        acknowledged=message.acknowledged,
    )


def replica_result_message(result: ReplicaSuccess) -> pb.DirectoryResult:
    """A result as it travels."""
    match result:
        case ReplicaAdded(replica=replica, host=host):
            added = pb.ReplicaAddedResult(replica=replica_record(replica), host=host_entry(host))
            return pb.DirectoryResult(replica_added=added)
        case ReplicaRemoved():
            return pb.DirectoryResult(replica_removed=pb.ReplicaRemovedResult())
        case ReplicaInSyncSet(replica=replica):
            done = pb.ReplicaInSyncSetResult(replica=replica_record(replica))
            return pb.DirectoryResult(replica_in_sync_set=done)


def read_replica_result(message: pb.DirectoryResult) -> ReplicaSuccess:
    """Of a result whose outcome is one of REPLICA_OUTCOMES."""
    match message.WhichOneof("outcome"):
        case "replica_added":
            added = message.replica_added
            return ReplicaAdded(replica=replica_from(added.replica), host=host_from(added.host))
        case "replica_removed":
            return ReplicaRemoved()
        case "replica_in_sync_set":
            return ReplicaInSyncSet(replica=replica_from(message.replica_in_sync_set.replica))
        case other:
            raise StampedeError(f"{other} is no result of a copy; report this")
