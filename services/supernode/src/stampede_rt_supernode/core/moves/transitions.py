"""Gives a channel or queue to another host that holds all its items (paper, section 4.1). Pure.

The caller holds everything that the owner accepted, and the owner accepts nothing more until the epoch changes. So one
entry decides: the first CommitMove of an epoch counts, and each later CommitMove of that epoch is refused. The former
owner keeps its items until the new owner removes it from the directory as a copy. If the new owner is lost before that,
the former owner becomes the owner again. If the new owner held a replica, the former owner becomes a replica in its
place. The former owner holds everything, so it stays in sync. The former owner of a queue is never a fallback. It stays
as a replica if the new owner held one.

The directory does not trust the host that calls: the owner's permit must say that this host holds everything, see
`move_permits`.
"""

from __future__ import annotations

from dataclasses import replace

from stampede_rt.errors import HostNotFound, LeaseExpired, PermissionDenied
from stampede_rt_runtime.access.move_permits import is_permit
from stampede_rt_supernode.core.groups.transitions import move_witness
from stampede_rt_supernode.core.lookups import channel_by_id, queue_by_id
from stampede_rt_supernode.core.moves.commands import CommitMove, CommitQueueMove, MoveCommitted, QueueMoveCommitted
from stampede_rt_supernode.core.queues.transitions import check_queue_epoch
from stampede_rt_supernode.core.records import HostRecord, QueueRecord, ReplicaKind, ReplicaRecord
from stampede_rt_supernode.core.replicas.copied_subjects import Copied, id_of
from stampede_rt_supernode.core.replicas.transitions import check_epoch, copies_after_owner_change, store
from stampede_rt_supernode.core.tables import Tables
from stampede_rt_supernode.core.validation import check_id, check_incarnation


def check_commit_move(operation: CommitMove) -> None:
    """Check the operation without the tables. Raises InvalidArgument."""
    check_id(operation.channel_id, "channel_id")
    check_id(operation.to_host_id, "to_host_id")
    check_incarnation(operation.to_boot_incarnation, "to_boot_incarnation")


def commit_move(tables: Tables, operation: CommitMove) -> MoveCommitted:
    """Make the host the owner, unless the epoch has changed. A repeated operation changes nothing."""
    check_commit_move(operation)
    channel = channel_by_id(tables, operation.channel_id)
    host = _destination(tables, f"channel {channel.name}", operation)
    if (channel.host_id, channel.epoch) == (host.host_id, operation.epoch + 1):
        return MoveCommitted(channel=channel)
    check_epoch(channel, operation.epoch)
    _check_registration(host, f"channel {channel.name}", operation)
    _check_permit(tables.hosts[channel.host_id], host, f"channel {channel.name}", channel.channel_id, operation)
    moved = replace(channel, host_id=host.host_id, epoch=channel.epoch + 1)
    store(tables, moved, (*copies_after_owner_change(tables, channel, moved), *_former_owner(tables, channel, moved)))
    move_witness(tables, channel.channel_id, channel.host_id)
    return MoveCommitted(channel=tables.channels[channel.channel_id])


def check_commit_queue_move(operation: CommitQueueMove) -> None:
    """Check the operation without the tables. Raises InvalidArgument."""
    check_id(operation.queue_id, "queue_id")
    check_id(operation.to_host_id, "to_host_id")
    check_incarnation(operation.to_boot_incarnation, "to_boot_incarnation")


def commit_queue_move(tables: Tables, operation: CommitQueueMove) -> QueueMoveCommitted:
    """Make the host the owner, unless the epoch has changed. A repeated operation changes nothing."""
    check_commit_queue_move(operation)
    queue = queue_by_id(tables, operation.queue_id)
    host = _destination(tables, f"queue {_name_of(queue)}", operation)
    if (queue.host_id, queue.epoch) == (host.host_id, operation.epoch + 1):
        return QueueMoveCommitted(queue=queue)
    check_queue_epoch(queue, operation.epoch)
    _check_registration(host, f"queue {_name_of(queue)}", operation)
    _check_permit(tables.hosts[queue.host_id], host, f"queue {_name_of(queue)}", queue.queue_id, operation)
    moved = replace(queue, host_id=host.host_id, epoch=queue.epoch + 1)
    former = [one for one in _former_owner(tables, queue, moved) if one.kind is ReplicaKind.WARM]
    store(tables, moved, (*copies_after_owner_change(tables, queue, moved), *former))
    return QueueMoveCommitted(queue=moved)


def _name_of(queue: QueueRecord) -> str:
    return queue.name or queue.queue_id.hex()


def _check_permit(
    owner: HostRecord, host: HostRecord, subject: str, subject_id: bytes, operation: CommitMove | CommitQueueMove
) -> None:
    """Raises PermissionDenied if the owner has a key and gave no permit. The owner itself needs none."""
    if host.host_id == owner.host_id or not owner.move_key:
        return
    if not is_permit(operation.permit, owner.move_key, subject_id, operation.epoch, host.host_id):
        raise PermissionDenied(
            f"host {host.name} cannot own {subject}: it has no permit of host {owner.name}, the owner; move it with "
            "`stampede move`",
            metadata={"subject": subject, "host": host.name},
        )


def _destination(tables: Tables, subject: str, operation: CommitMove | CommitQueueMove) -> HostRecord:
    host = tables.hosts.get(operation.to_host_id)
    if host is None or not host.alive:
        raise HostNotFound(
            f"host {operation.to_host_id.hex()} cannot own {subject}: it never registered, or its lease has ended; "
            "choose a live host (`stampede hosts`)",
            metadata={"subject": subject, "host_id": operation.to_host_id.hex()},
        )
    if host.boot_incarnation != operation.to_boot_incarnation:
        raise LeaseExpired(
            f"host {host.name} has started again since the move of {subject} began, and has lost its copy; move it "
            "again",
            metadata={"subject": subject, "host": host.name},
        )
    return host


def _check_registration(host: HostRecord, subject: str, operation: CommitMove | CommitQueueMove) -> None:
    """Raises LeaseExpired if the host has registered again since it sent the command.

    An earlier attempt to commit may arrive after the directory has refused a later one, because the host had no lease.
    The host has dropped its copy then.
    """
    if operation.to_registered_index not in (0, host.registered_index):
        raise LeaseExpired(
            f"host {host.name} has registered again since it sent the commit of the move of {subject}, and may have "
            "lost its copy; move it again",
            metadata={"subject": subject, "host": host.name},
        )


def _former_owner(tables: Tables, before: Copied, after: Copied) -> tuple[ReplicaRecord, ...]:
    """The former owner's copy, if that host has its lease and its items.

    The text at the top of this module says which kind of copy it is.
    """
    host = tables.hosts[before.host_id]
    if before.host_id == after.host_id or not host.alive:
        return ()
    there = tables.replicas.at(id_of(before), after.host_id)
    swaps = there is not None and there.kind is ReplicaKind.WARM
    acknowledged = there is None or there.kind is not ReplicaKind.WARM or there.acknowledged
    return (
        ReplicaRecord(
            channel_id=id_of(after),
            host_id=host.host_id,
            boot_incarnation=host.boot_incarnation,
            kind=ReplicaKind.WARM if swaps else ReplicaKind.MOVE,
            source_host_id=after.host_id,
            in_sync=True,
            acknowledged=acknowledged,
            epoch=after.epoch,
            added_index=tables.index,
            is_of_queue=isinstance(after, QueueRecord),
        ),
    )
