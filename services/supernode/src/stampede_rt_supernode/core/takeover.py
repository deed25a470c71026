"""The effects of the loss of a host on its channels, their copies and groups, and on mailboxes. Pure.

A warm replica in sync holds all acknowledged items. So it becomes the owner in the very step that ends the owner's
registration, and nobody else gets the channel in between. But the incarnation changes, because items that were put and
not acknowledged may be gone.
"""

from __future__ import annotations

from dataclasses import replace

from stampede_rt_supernode.core.groups.transitions import leave_groups, note_lost_cuts
from stampede_rt_supernode.core.queues.placement import rehouse_mailboxes
from stampede_rt_supernode.core.records import ChannelRecord, HostRecord
from stampede_rt_supernode.core.replicas.transitions import adopted, drop_copy, store
from stampede_rt_supernode.core.tables import Tables


def give_owner(tables: Tables, before: ChannelRecord, after: ChannelRecord) -> None:
    """Give a channel another owner, or let it begin anew: as `after`, with a higher epoch and a new incarnation.

    The caller notes lost cuts, once for all channels of one log entry, because they may be in the same groups.
    """
    store(tables, after, adopted(tables, before, after))


def forget_channel(tables: Tables, channel: ChannelRecord) -> None:
    """Delete a channel, with its copies and its membership in groups."""
    leave_groups(tables, channel.channel_id)
    tables.replicas.store(channel.channel_id, ())
    tables.remove_channel(channel)


def end_registration(tables: Tables, host_id: bytes) -> None:
    """Apply the loss of all items of a host: its copies are gone, and other hosts get some of its channels.

    Other hosts get the channels of which they hold a warm replica in sync. The host must have no lease any more, or
    have registered with a new process.
    """
    for channel_id in tables.replicas.channel_ids_at(host_id):
        drop_copy(tables, tables.channels[channel_id], host_id)
    inherited: list[bytes] = []
    for channel_id, _ in tables.replicas.entries():  # not over all channels of the host, because few may have a copy
        channel = tables.channels[channel_id]
        heir = _heir(tables, channel) if channel.host_id == host_id else None
        if heir is not None:
            incarnation = (channel.incarnation + 1) % 2**64 or 1  # random at first and then counted up
            after = replace(channel, host_id=heir.host_id, epoch=channel.epoch + 1, incarnation=incarnation)
            give_owner(tables, channel, after)
            inherited.append(channel.channel_id)
    note_lost_cuts(tables, inherited)
    host = tables.hosts.get(host_id)
    if host is None or not host.alive:
        rehouse_mailboxes(tables, host_id)


def _heir(tables: Tables, channel: ChannelRecord) -> HostRecord | None:
    """Of the live hosts with a warm replica in sync, the one with the fewest channels; None if there is no such host.

    Among equals it is the host whose replica was added first.
    """
    in_sync = (tables.hosts[one.host_id] for one in tables.replicas.of(channel.channel_id) if one.in_sync)
    live = (host for host in in_sync if host.alive and host.host_id != channel.host_id)
    return min(live, key=lambda host: host.channels, default=None)
