"""Adds, changes and removes copies of channels and queues in the tables (paper, section 4.1). Pure.

As in `channels.transitions`, a function either raises a StampedeError without any change, or succeeds. For the effects
of a lost host or a new owner, see `takeover`.
"""

from __future__ import annotations

from dataclasses import replace

from stampede_rt.errors import ChannelExists, HostNotFound, InvalidArgument, StaleBinding, Unavailable
from stampede_rt_supernode.core.groups.transitions import note_lost_cuts
from stampede_rt_supernode.core.hosts.placement import is_full, least_loaded, machine_of
from stampede_rt_supernode.core.records import HostRecord, QueueRecord, ReplicaKind, ReplicaRecord
from stampede_rt_supernode.core.replicas.commands import (
    AddReplica,
    RemoveReplica,
    ReplicaAdded,
    ReplicaInSyncSet,
    ReplicaRemoved,
    SetReplicaInSync,
)
from stampede_rt_supernode.core.replicas.copied_subjects import Copied, about, copied_by_id, id_of, shown
from stampede_rt_supernode.core.tables import Tables
from stampede_rt_supernode.core.validation import check_id, check_incarnation

REPLICAS_MAX = 16  # the most replicas and proxies of one channel


def check_add_replica(operation: AddReplica) -> None:
    """Check the operation without the tables. Raises InvalidArgument."""
    check_id(operation.channel_id, "subject")
    if operation.host_id:
        check_id(operation.host_id, "host_id")
    if operation.source_host_id:
        check_id(operation.source_host_id, "source_host_id")
    if operation.acknowledged and operation.kind is not ReplicaKind.WARM:
        text = "acknowledged is set for a proxy, but puts wait only for warm replicas; leave it out, or state kind WARM"
        raise InvalidArgument(text, metadata={"field": "acknowledged"})
    if operation.is_of_queue and operation.kind is not ReplicaKind.WARM:
        raise InvalidArgument(
            "a queue has no proxies, because a proxy gives no messages to takers; state kind WARM for a replica",
            metadata={"field": "kind"},
        )


def check_remove_replica(operation: RemoveReplica) -> None:
    """Check the operation without the tables. Raises InvalidArgument."""
    check_id(operation.channel_id, "subject")
    check_id(operation.host_id, "host_id")


def check_set_in_sync(operation: SetReplicaInSync) -> None:
    """Check the operation without the tables. Raises InvalidArgument."""
    check_id(operation.channel_id, "subject")
    check_id(operation.host_id, "host_id")
    check_incarnation(operation.boot_incarnation, "boot_incarnation")


def check_epoch(channel: Copied, epoch: int) -> None:
    """Raises StaleBinding with reason WRONG_EPOCH if the channel has another epoch."""
    if epoch != channel.epoch:
        raise StaleBinding(
            f"{shown(channel)} is at epoch {channel.epoch}, not {epoch}: its host has changed or restarted; "
            "resolve it again",
            reason="WRONG_EPOCH",
            metadata=about(channel) | {"epoch": str(channel.epoch)},
        )


def check_has_host(tables: Tables, operation: AddReplica) -> None:
    """Check that a host can take the copy. Changes nothing.

    Raises the errors of `add_replica` about the fields of `operation`, about the id and the epoch, and about hosts.
    """
    check_add_replica(operation)
    subject = copied_by_id(tables, operation.channel_id, is_of_queue=operation.is_of_queue)
    check_epoch(subject, operation.epoch)
    _choose_host(tables, subject, operation.host_id)


def check_agrees_with_policy(tables: Tables, operation: AddReplica) -> None:
    """Check that puts wait for the warm replica as the policy says. Changes nothing.

    Raises InvalidArgument, and the errors of `add_replica` about the id and the epoch.
    """
    channel = copied_by_id(tables, operation.channel_id, is_of_queue=operation.is_of_queue)
    check_epoch(channel, operation.epoch)
    ack = channel.spec.ack if isinstance(channel, QueueRecord) else channel.policy.ack
    waits = ack == "replica"
    if operation.kind is ReplicaKind.WARM and operation.acknowledged is not waits:
        text = f"acknowledged is {operation.acknowledged}, but puts {'wait' if waits else 'do not wait'} for replicas"
        raise InvalidArgument(
            f'{shown(channel)}: {text} (ack="{ack or "host"}"); state acknowledged={waits}',
            metadata=about(channel) | {"field": "acknowledged"},
        )


def add_replica(tables: Tables, operation: AddReplica, *, added_index: int) -> ReplicaAdded:
    """Add a copy. If the host has a copy of the same kind already, returns that copy."""
    check_add_replica(operation)
    channel = copied_by_id(tables, operation.channel_id, is_of_queue=operation.is_of_queue)
    check_epoch(channel, operation.epoch)
    if isinstance(channel, QueueRecord) and channel.spec.ack != "replica":
        text = f'{shown(channel)} waits for no replicas; change its policy to ack="replica" and replicas first'
        raise InvalidArgument(text, metadata=about(channel))
    held = tables.replicas.of(id_of(channel))
    host = _choose_host(tables, channel, operation.host_id)
    there = tables.replicas.at(id_of(channel), host.host_id)
    if there is not None or host.host_id == channel.host_id:
        return ReplicaAdded(replica=_same_kind(channel, host, there, operation.kind), host=host)
    if len(held) >= REPLICAS_MAX:
        text = f"{shown(channel)} has {REPLICAS_MAX} copies, the limit; remove one first"
        raise InvalidArgument(text, metadata=about(channel))
    replica = ReplicaRecord(
        channel_id=id_of(channel),
        host_id=host.host_id,
        boot_incarnation=host.boot_incarnation,
        kind=operation.kind,
        source_host_id=_source(tables, channel, operation),
        acknowledged=operation.acknowledged,
        epoch=channel.epoch,
        added_index=added_index,
        is_of_queue=operation.is_of_queue,
    )
    store(tables, channel, (*held, replica))
    return ReplicaAdded(replica=replica, host=host)


def _choose_host(tables: Tables, channel: Copied, host_id: bytes) -> HostRecord:
    """The host for a copy: the live host `host_id`, if the caller names one.

    Otherwise it is the least loaded of the live hosts that hold nothing of this channel; among equals the host with the
    fewest channels and copies. Hosts on machines that hold nothing of the channel come first, unless they are full.
    Raises HostNotFound, or Unavailable with reason NO_HOST.
    """
    if host_id:
        host = tables.hosts.get(host_id)
        if host is None or not host.alive:
            raise HostNotFound(
                f"host {_shown_host(tables, host_id)} cannot hold a copy of {shown(channel)}: it never registered, or "
                "its lease has ended; choose a live host (`stampede hosts`)",
                metadata={"host_id": host_id.hex()},
            )
        return host
    holders = {channel.host_id, *(one.host_id for one in tables.replicas.of(id_of(channel)))}
    free = [host for host in tables.live_hosts() if host.host_id not in holders]
    machines = {machine_of(tables.hosts[one]) for one in holders} | {""}
    apart = [host for host in free if machine_of(host) not in machines and not is_full(tables, host)]
    least = _least_busy(tables, apart) or _least_busy(tables, free)
    if least is None:
        raise Unavailable(
            f"every live host holds {shown(channel)} already, or is private; start another with `stampede host` to "
            "hold a copy",
            reason="NO_HOST",
            metadata=about(channel),
        )
    return least


def _least_busy(tables: Tables, hosts: list[HostRecord]) -> HostRecord | None:
    return least_loaded(tables, hosts, lambda host: host.channels + tables.replicas.count_at(host.host_id))


def _same_kind(channel: Copied, host: HostRecord, there: ReplicaRecord | None, kind: ReplicaKind) -> ReplicaRecord:
    if there is not None and there.kind is kind:
        return there
    holds = "owns it" if there is None else f"holds a {there.kind.value} copy of it"
    raise ChannelExists(
        f"host {host.name} cannot hold a {kind.value} copy of {shown(channel)}: it {holds}; choose another host, "
        "or remove that copy first",
        metadata=about(channel) | {"host": host.name},
    )


def _source(tables: Tables, channel: Copied, operation: AddReplica) -> bytes:
    source = operation.source_host_id or channel.host_id
    if source == channel.host_id:
        return source
    if operation.kind is ReplicaKind.WARM:
        text = f"a warm replica of {shown(channel)} is fed by the owner only; leave source_host_id out"
    elif (there := tables.replicas.at(id_of(channel), source)) is None or there.kind is not ReplicaKind.PROXY:
        text = (
            f"host {_shown_host(tables, source)} holds no proxy of {shown(channel)} that could feed another one; name "
            "a host with a proxy as the source, or leave the source out"
        )
    else:
        return source
    raise InvalidArgument(text, metadata=about(channel) | {"field": "source_host_id"})


def _shown_host(tables: Tables, host_id: bytes) -> str:
    """The name of a host; the id of a host that never registered."""
    host = tables.hosts.get(host_id)
    return host_id.hex() if host is None else host.name


def remove_replica(tables: Tables, operation: RemoveReplica) -> ReplicaRemoved:
    """Remove a copy, if there is one. The owner then feeds the copies that the removed copy fed."""
    check_remove_replica(operation)
    channel = copied_by_id(tables, operation.channel_id, is_of_queue=operation.is_of_queue)
    if operation.epoch:
        check_epoch(channel, operation.epoch)
    drop_copy(tables, channel, operation.host_id)
    return ReplicaRemoved()


def is_left_to_owner(tables: Tables, operation: RemoveReplica) -> bool:
    """Whether only the owner, which names its epoch, may remove the copy.

    This is so if the copy may become the owner. The owner counts on such a copy, and would acknowledge puts that no
    copy of the directory has. Raises InvalidArgument, ChannelNotFound and QueueNotFound.
    """
    subject = copied_by_id(tables, operation.channel_id, is_of_queue=operation.is_of_queue)
    there = tables.replicas.at(id_of(subject), operation.host_id)
    return not operation.epoch and there is not None and there.in_sync


def drop_copy(tables: Tables, channel: Copied, host_id: bytes) -> None:
    """Remove the copy of `channel` at a host, if there is one."""
    held = tables.replicas.of(id_of(channel))
    left = tuple(one for one in held if one.host_id != host_id)
    if any(one.kind is ReplicaKind.MOVE for one in held if one not in left):
        # Without this copy its host is no longer a witness (see `GroupTable`), unless the host owns a member.
        note_lost_cuts(tables, [id_of(channel)])
    if left != held:
        store(tables, channel, tuple(_fed(one, {host_id}, channel.host_id) for one in left))


def _fed(replica: ReplicaRecord, gone: set[bytes], owner: bytes) -> ReplicaRecord:
    """`replica`, fed by the owner if its source is gone."""
    return replace(replica, source_host_id=owner) if replica.source_host_id in gone else replica


def copies_after_owner_change(tables: Tables, before: Copied, after: Copied) -> tuple[ReplicaRecord, ...]:
    """The copies of a channel whose record becomes `after`, with another owner or a new incarnation.

    If the new owner held a copy, that copy is gone. The new owner feeds the copies that its copy or the former owner
    fed. If the incarnation is new, no copy is in sync any more. Otherwise a copy stays in sync if puts wait for it:
    it holds all items that were acknowledged or shown. The copy of a fallback is gone.
    """
    held = tables.replicas.of(id_of(before))
    left = (one for one in held if one.host_id != after.host_id and one.kind is not ReplicaKind.MOVE)
    moved = (_fed(one, {before.host_id, after.host_id}, after.host_id) for one in left)
    continues = before.incarnation == after.incarnation
    return tuple(
        replace(one, in_sync=one.in_sync and one.acknowledged and continues, epoch=after.epoch, change_number=0)
        for one in moved
    )


def store(tables: Tables, channel: Copied, replicas: tuple[ReplicaRecord, ...]) -> None:
    """Store `channel` and its copies. Notes a change for watchers if the record differs."""
    tables.replicas.store(id_of(channel), replicas)
    if isinstance(channel, QueueRecord):
        tables.put_queue(channel)
        return
    host_ids = tuple(one.host_id for one in replicas if one.kind is not ReplicaKind.MOVE)  # fallbacks serve no caller
    changed = channel if channel.proxy_host_ids == host_ids else replace(channel, proxy_host_ids=host_ids)
    if changed != tables.channels[id_of(channel)]:
        tables.replace_channel(changed)


def set_in_sync(tables: Tables, operation: SetReplicaInSync) -> ReplicaInSyncSet:
    """Set `in_sync` of a copy as its owner reports it, if epoch and boot incarnation agree.

    The owner reports False, and waits until that is in the log, before it acknowledges a put without the replica. A
    late report of a former owner has another epoch. A report that arrives after a newer report has a lower number. A
    report about a replica that was removed and added again has another `added_index`. The directory refuses all three.
    So a replica that becomes the owner has all acknowledged items.
    """
    check_set_in_sync(operation)
    channel = copied_by_id(tables, operation.channel_id, is_of_queue=operation.is_of_queue)
    check_epoch(channel, operation.epoch)
    replica = tables.replicas.at(id_of(channel), operation.host_id)
    if replica is None or replica.boot_incarnation != operation.boot_incarnation:
        raise _no_copy(channel, operation.host_id, "holds no copy of it since its last start; add the replica again")
    if replica.kind is not ReplicaKind.WARM:
        text = f"the copy of {shown(channel)} at host {operation.host_id.hex()} is a proxy, which is never in sync"
        raise InvalidArgument(f"{text}; add a warm replica", metadata=about(channel))
    if operation.in_sync and not tables.hosts[channel.host_id].alive:
        raise _no_copy(
            channel, channel.host_id, "owns it without a lease, so its report does not count; register again"
        )
    if operation.change_number < replica.change_number:
        text = f"{shown(channel)}: a later change of the replica is in the log; report its present state"
        raise InvalidArgument(text, metadata=about(channel) | {"field": "change_number"})
    if operation.added_index not in (0, replica.added_index):
        text = f"{shown(channel)}: the replica was removed and added again since; report the state of the present one"
        raise InvalidArgument(text, metadata=about(channel) | {"field": "added_index"})
    number = operation.change_number
    changed = replace(replica, in_sync=operation.in_sync, epoch=channel.epoch, change_number=number)
    held = tables.replicas.of(id_of(channel))
    store(tables, channel, tuple(changed if one is replica else one for one in held))
    return ReplicaInSyncSet(replica=changed)


def end_replicas(tables: Tables, channel: Copied) -> None:
    """Remove the replicas of a channel whose policy has changed.

    The new policy wants no replicas, or puts wait for replicas only since the change, or only until the change.
    """
    held = tables.replicas.of(id_of(channel))
    gone = {one.host_id for one in held if one.kind is ReplicaKind.WARM}
    left = (one for one in held if one.host_id not in gone)
    store(tables, channel, tuple(_fed(one, gone, channel.host_id) for one in left))


def _no_copy(channel: Copied, host_id: bytes, what: str) -> HostNotFound:
    text = f"{shown(channel)}: host {host_id.hex()} {what}"
    return HostNotFound(text, metadata=about(channel) | {"host_id": host_id.hex()})
