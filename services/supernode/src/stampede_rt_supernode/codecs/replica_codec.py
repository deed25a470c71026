"""Converts copies of channels and queues from and to their messages. Makes no decisions."""

from __future__ import annotations

from stampede_rt.errors import InvalidArgument, StampedeError
from stampede_rt.v1 import replica_pb2, subject_pb2
from stampede_rt_supernode.core.records import ReplicaKind, ReplicaRecord
from stampede_rt_supernode.core.replicas.loads import ReplicaLoad

_KINDS_TO_WIRE = {
    ReplicaKind.PROXY: replica_pb2.REPLICA_KIND_PROXY,
    ReplicaKind.WARM: replica_pb2.REPLICA_KIND_WARM,
    ReplicaKind.MOVE: replica_pb2.REPLICA_KIND_MOVE,
}
_KINDS_FROM_WIRE = {wire: kind for kind, wire in _KINDS_TO_WIRE.items()}
_KINDS_TO_ADD = (replica_pb2.REPLICA_KIND_PROXY, replica_pb2.REPLICA_KIND_WARM)


def kind_from(kind: replica_pb2.ReplicaKind) -> ReplicaKind:
    """The kind in a message. Raises InvalidArgument for a kind that a caller may not request."""
    if kind not in _KINDS_TO_ADD:
        raise InvalidArgument(
            f"kind is {kind}; state REPLICA_KIND_PROXY or REPLICA_KIND_WARM, the kinds that a caller can add",
            metadata={"field": "kind"},
        )
    return _KINDS_FROM_WIRE[kind]


def kind_message(kind: ReplicaKind) -> replica_pb2.ReplicaKind:
    """The message value of a kind."""
    return _KINDS_TO_WIRE[kind]


def channel_id_of(subject: subject_pb2.Subject) -> bytes:
    """The channel of a subject. Raises QUEUE_NOT_FOUND for a queue, because hosts report no loads of queues."""
    if subject.WhichOneof("id") == "queue_id":
        shown = subject.queue_id.hex()
        text = f"queue {shown} has no loads of copies, because takers use only its owner; report only channels"
        raise StampedeError(text, reason="QUEUE_NOT_FOUND", metadata={"queue_id": shown})
    return subject.channel_id


def copied_subject(subject: subject_pb2.Subject) -> tuple[bytes, bool]:
    """The id of the channel or queue of a subject, and whether it is a queue."""
    is_of_queue = subject.WhichOneof("id") == "queue_id"
    return (subject.queue_id if is_of_queue else subject.channel_id), is_of_queue


def subject_of(subject_id: bytes, *, is_of_queue: bool = False) -> subject_pb2.Subject:
    """The subject of a channel or queue."""
    return subject_pb2.Subject(queue_id=subject_id) if is_of_queue else subject_pb2.Subject(channel_id=subject_id)


def replica_record(replica: ReplicaRecord) -> replica_pb2.ReplicaRecord:
    """The message of a copy."""
    return replica_pb2.ReplicaRecord(
        subject=subject_of(replica.channel_id, is_of_queue=replica.is_of_queue),
        host_id=replica.host_id,
        boot_incarnation=replica.boot_incarnation,
        kind=_KINDS_TO_WIRE[replica.kind],
        source_host_id=replica.source_host_id,
        in_sync=replica.in_sync,
        acknowledged=replica.acknowledged,
        epoch=replica.epoch,
        change_number=replica.change_number,
        added_index=replica.added_index,
    )


def replica_from(record: replica_pb2.ReplicaRecord) -> ReplicaRecord:
    """The copy of a record that this codec wrote."""
    subject_id, is_of_queue = copied_subject(record.subject)
    return ReplicaRecord(
        channel_id=subject_id,
        is_of_queue=is_of_queue,
        host_id=record.host_id,
        boot_incarnation=record.boot_incarnation,
        kind=_KINDS_FROM_WIRE[record.kind],
        source_host_id=record.source_host_id,
        in_sync=record.in_sync,
        acknowledged=record.acknowledged,
        epoch=record.epoch,
        change_number=record.change_number,
        added_index=record.added_index,
    )


def load_message(load: ReplicaLoad) -> replica_pb2.ReplicaLoad:
    """The message of the load that a copy of a channel causes at its host."""
    return replica_pb2.ReplicaLoad(
        subject=subject_of(load.channel_id),
        host_id=load.host_id,
        subscriptions=load.subscriptions,
        delivered_bytes_per_second=load.delivered_bytes_per_second,
        next_seq=load.next_seq,
        lag_nanos=load.lag_nanos,
    )


def load_from(message: replica_pb2.ReplicaLoad) -> ReplicaLoad:
    """The load in a message. Raises the errors of `channel_id_of`."""
    return ReplicaLoad(
        channel_id=channel_id_of(message.subject),
        host_id=message.host_id,
        subscriptions=message.subscriptions,
        delivered_bytes_per_second=message.delivered_bytes_per_second,
        next_seq=message.next_seq,
        lag_nanos=message.lag_nanos,
    )
