"""Applies the loss of a host to its channels and queues, their copies and groups, and its mailboxes. Pure.

A warm replica in sync holds all acknowledged items. So its host becomes the owner in the same step that ends the former
owner's registration, and no other host gets the channel in between. If each put waited for the replica before its
acknowledgement, the replica also holds all items that readers have seen. The incarnation then stays, because no reader
can have a position or a cursor of a lost item.
"""

from __future__ import annotations

from dataclasses import replace

from stampede_rt_supernode.core.groups.transitions import leave_groups, note_lost_cuts
from stampede_rt_supernode.core.queues.placement import move_mailboxes
from stampede_rt_supernode.core.records import ChannelRecord, HostRecord, ReplicaKind
from stampede_rt_supernode.core.replicas.copied_subjects import Copied, id_of, known_copied_by_id
from stampede_rt_supernode.core.replicas.transitions import copies_after_owner_change, drop_copy, store
from stampede_rt_supernode.core.tables import Tables


def give_owner(tables: Tables, before: Copied, after: Copied) -> None:
    """Replace the record of a channel or queue by `after`, which has a higher epoch, and another owner or incarnation.

    The caller must then call `note_lost_cuts`, once for all channels of one log entry, because these channels may be in
    the same groups.
    """
    store(tables, after, copies_after_owner_change(tables, before, after))


def forget_channel(tables: Tables, channel: ChannelRecord) -> tuple[str, ...]:
    """Delete a channel, with its copies and its membership in groups.

    Returns the names of the groups that are deleted with it.
    """
    freed_groups = leave_groups(tables, channel.channel_id)
    tables.replicas.store(channel.channel_id, ())
    tables.remove_channel(channel)
    return freed_groups


def end_registration(tables: Tables, host_id: bytes) -> None:
    """End the registration of a process of a host: apply the loss of all items of this process.

    The host's lease must have ended, or a new process of the host must have registered. The directory removes the
    copies that the host held. A channel or queue with a warm replica in sync gets the host of this replica as its
    owner. Mailboxes without such a replica stay at the host if a new process of the host has registered. Otherwise they
    move to other hosts.
    """
    for channel_id in tables.replicas.channel_ids_at(host_id):
        drop_copy(tables, known_copied_by_id(tables, channel_id), host_id)
    taken_over: list[bytes] = []
    # The entries of the replicas are fewer than the channels of the host if few channels have a copy.
    for channel_id, _ in tables.replicas.entries():
        channel = known_copied_by_id(tables, channel_id)
        successor = _successor(tables, channel) if channel.host_id == host_id else None
        if successor is not None:
            incarnation = channel.incarnation
            if not _lost_nothing(tables, channel, successor):
                incarnation = (channel.incarnation + 1) % 2**64 or 1  # never 0; the first number is random
            after = replace(channel, host_id=successor.host_id, epoch=channel.epoch + 1, incarnation=incarnation)
            give_owner(tables, channel, after)
            taken_over += [channel.channel_id] if isinstance(channel, ChannelRecord) else []
    note_lost_cuts(tables, taken_over)
    host = tables.hosts.get(host_id)
    if host is None or not host.alive:
        move_mailboxes(tables, host_id)


def _lost_nothing(tables: Tables, channel: Copied, successor: HostRecord) -> bool:
    """Whether the successor has all acknowledged items, and all items that a reader has seen.

    This is so if puts waited for the successor's replica, or if the channel has just moved away from the successor.
    """
    copy = tables.replicas.at(id_of(channel), successor.host_id)
    # `acknowledged`: puts waited for this copy
    return copy is not None and (copy.kind is ReplicaKind.MOVE or copy.acknowledged)


def _successor(tables: Tables, channel: Copied) -> HostRecord | None:
    """The live host with a copy in sync that has the fewest channels; None if there is no such host.

    Among equals, returns the host whose copy was added first. If the channel has just moved, its former owner comes
    before all other hosts: the lost owner had not acknowledged a put yet, so the former owner has all items.
    """
    copies = [one for one in tables.replicas.of(id_of(channel)) if one.in_sync]
    former = [one for one in copies if one.kind is ReplicaKind.MOVE]
    in_sync = (tables.hosts[one.host_id] for one in former or copies)
    live = (host for host in in_sync if host.alive and host.host_id != channel.host_id)
    return min(live, key=lambda host: host.channels, default=None)
