"""Converts commands about copies of channels and queues, and their results, from and to messages of the log."""

from __future__ import annotations

from typing import Any

from stampede_rt.v1 import directory_command_pb2 as pb
from stampede_rt_supernode.codecs.host_codec import host_entry, host_from
from stampede_rt_supernode.codecs.kind_codec import KindCodec
from stampede_rt_supernode.codecs.replica_codec import (
    copied_subject,
    kind_from,
    kind_message,
    replica_from,
    replica_record,
    subject_of,
)
from stampede_rt_supernode.core.replicas.commands import (
    AddReplica,
    RemoveReplica,
    ReplicaAdded,
    ReplicaInSyncSet,
    ReplicaRemoved,
    SetReplicaInSync,
)


def _add_message(operation: AddReplica) -> pb.AddReplicaCommand:
    return pb.AddReplicaCommand(
        subject=subject_of(operation.channel_id, is_of_queue=operation.is_of_queue),
        epoch=operation.epoch,
        host_id=operation.host_id,
        kind=kind_message(operation.kind),
        source_host_id=operation.source_host_id,
        acknowledged=operation.acknowledged,
    )


def _read_add(message: pb.AddReplicaCommand) -> AddReplica:
    subject_id, is_of_queue = copied_subject(message.subject)
    return AddReplica(
        channel_id=subject_id,
        is_of_queue=is_of_queue,
        epoch=message.epoch,
        host_id=message.host_id,
        kind=kind_from(message.kind),
        source_host_id=message.source_host_id,
        acknowledged=message.acknowledged,
    )


def _remove_message(operation: RemoveReplica) -> pb.RemoveReplicaCommand:
    return pb.RemoveReplicaCommand(
        subject=subject_of(operation.channel_id, is_of_queue=operation.is_of_queue),
        host_id=operation.host_id,
        epoch=operation.epoch,
    )


def _read_remove(message: pb.RemoveReplicaCommand) -> RemoveReplica:
    subject_id, is_of_queue = copied_subject(message.subject)
    return RemoveReplica(channel_id=subject_id, is_of_queue=is_of_queue, host_id=message.host_id, epoch=message.epoch)


def _in_sync_message(operation: SetReplicaInSync) -> pb.SetReplicaInSyncCommand:
    return pb.SetReplicaInSyncCommand(
        subject=subject_of(operation.channel_id, is_of_queue=operation.is_of_queue),
        epoch=operation.epoch,
        host_id=operation.host_id,
        boot_incarnation=operation.boot_incarnation,
        in_sync=operation.in_sync,
        change_number=operation.change_number,
        added_index=operation.added_index,
    )


def _read_in_sync(message: pb.SetReplicaInSyncCommand) -> SetReplicaInSync:
    subject_id, is_of_queue = copied_subject(message.subject)
    return SetReplicaInSync(
        channel_id=subject_id,
        is_of_queue=is_of_queue,
        epoch=message.epoch,
        host_id=message.host_id,
        boot_incarnation=message.boot_incarnation,
        in_sync=message.in_sync,
        change_number=message.change_number,
        added_index=message.added_index,
    )


def _added_message(result: ReplicaAdded) -> pb.ReplicaAddedResult:
    return pb.ReplicaAddedResult(replica=replica_record(result.replica), host=host_entry(result.host))


def _read_added(message: pb.ReplicaAddedResult) -> ReplicaAdded:
    return ReplicaAdded(replica=replica_from(message.replica), host=host_from(message.host))


CODECS: tuple[KindCodec[Any, Any, Any, Any], ...] = (
    KindCodec(
        kind="add_replica",
        outcome="replica_added",
        operation=AddReplica,
        result=ReplicaAdded,
        write=_add_message,
        read=_read_add,
        write_result=_added_message,
        read_result=_read_added,
    ),
    KindCodec(
        kind="remove_replica",
        outcome="replica_removed",
        operation=RemoveReplica,
        result=ReplicaRemoved,
        write=_remove_message,
        read=_read_remove,
        write_result=lambda one: pb.ReplicaRemovedResult(),
        read_result=lambda message: ReplicaRemoved(),
    ),
    KindCodec(
        kind="set_replica_in_sync",
        outcome="replica_in_sync_set",
        operation=SetReplicaInSync,
        result=ReplicaInSyncSet,
        write=_in_sync_message,
        read=_read_in_sync,
        write_result=lambda one: pb.ReplicaInSyncSetResult(replica=replica_record(one.replica)),
        read_result=lambda message: ReplicaInSyncSet(replica=replica_from(message.replica)),
    ),
)
