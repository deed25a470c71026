"""The tables of the directory, and the indexes derived from them (paper, section 4.3). Pure.

The paper has four maps. Its maps host id -> gatekeepers and channel id -> host id are in the records here, and its maps
of names are `host_ids` and `channel_ids`. Every edit keeps the invariants stated beside the attributes, and notes the
change for watchers. The values are immutable, so a copy of a map is a snapshot.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from heapq import nsmallest

from sortedcontainers import SortedDict

from stampede_rt_supernode.core.change_ring import ChangeRing
from stampede_rt_supernode.core.creators import Creators
from stampede_rt_supernode.core.groups.table import GroupTable
from stampede_rt_supernode.core.peers.table import PeerTable
from stampede_rt_supernode.core.queues.table import QueueTable
from stampede_rt_supernode.core.records import (
    ChangeKind,
    ChannelRecord,
    GroupRecord,
    HostLoad,
    HostRecord,
    PeerRecord,
    QueueRecord,
    ReplicaRecord,
)
from stampede_rt_supernode.core.replicas.table import ReplicaTable

# The most hosts that count as lost at a time.
LOST_HOSTS_MAX = 100


class Tables:
    """The maps. Every edit is atomic: it cannot fail half-way. Each edit takes O(log n)."""

    def __init__(
        self,
        hosts: Iterable[HostRecord] = (),
        channels: Iterable[ChannelRecord] = (),
        *,
        groups: Iterable[tuple[GroupRecord, tuple[bytes, ...]]] = (),
        replicas: Iterable[ReplicaRecord] = (),
        queues: Iterable[QueueRecord] = (),
        peers: Iterable[PeerRecord] = (),
        index: int = 0,
    ) -> None:
        self.index = index  # the log position that is being applied, or was applied last
        self.changes = ChangeRing(index)
        self.hosts: dict[bytes, HostRecord] = {host.host_id: host for host in hosts}
        self.channels: dict[bytes, ChannelRecord] = {channel.channel_id: channel for channel in channels}
        # The channel's id by its name, for all channels. Built in one call, because to add name by name takes twenty
        # times as long.
        self.channel_ids: SortedDict[str, bytes] = SortedDict({one.name: key for key, one in self.channels.items()})
        self.host_ids: SortedDict[str, bytes] = SortedDict()  # the host's id by its name, for all live hosts
        # The ids of the hosts whose lease ended without a deregistration.
        self.lost: set[bytes] = {host.host_id for host in self.hosts.values() if host.is_lost}
        # By host id, for all hosts: the ids of the channels that the host owns.
        self._channel_ids_at: dict[bytes, set[bytes]] = {host_id: set() for host_id in self.hosts}
        for host in self.hosts.values():
            if host.alive:
                self.host_ids[host.name] = host.host_id
        self.channel_creators = Creators()
        for channel in self.channels.values():
            self._channel_ids_at[channel.host_id].add(channel.channel_id)
            self.channel_creators.note(channel.created_by, +1)
        self.groups = GroupTable(groups, self.changes.note)
        self.replicas = ReplicaTable(replicas)
        self.queues = QueueTable(queues, self.changes.note)
        self.peers = PeerTable(peers, index)

    def begin(self, index: int) -> None:
        """Begin to apply log position `index`."""
        self.index = index
        self.changes.begin(index)

    def note_index(self, index: int) -> None:
        """Note that log position `index` is applied, with all its changes."""
        self.index = index
        self.changes.note_index(index)
        self.peers.changes.note_index(index)

    def channels_at(self, host_id: bytes, channels_max: int | None = None) -> list[ChannelRecord]:
        """The channels that a host owns, in the order of their ids: all, or the first `channels_max`."""
        ids = self._channel_ids_at.get(host_id, ())
        return [self.channels[one] for one in (sorted(ids) if channels_max is None else nsmallest(channels_max, ids))]

    def channel_named(self, name: str) -> ChannelRecord | None:
        """The channel of that name; None if no channel has it."""
        found = self.channel_ids.get(name)
        return None if found is None else self.channels[found]

    def live_host_named(self, name: str) -> HostRecord | None:
        """The live host of that name; None if no live host has it."""
        found = self.host_ids.get(name)
        return None if found is None else self.hosts[found]

    def live_hosts(self) -> Iterator[HostRecord]:
        """The live hosts, by name."""
        return (self.hosts[host_id] for host_id in self.host_ids.values())

    def add_channel(self, channel: ChannelRecord) -> None:
        """Add a channel. Its id and name must be new, and its host known."""
        self.channels[channel.channel_id] = channel
        self.channel_ids[channel.name] = channel.channel_id
        self._channel_ids_at[channel.host_id].add(channel.channel_id)
        self.channel_creators.note(channel.created_by, +1)
        self._count(channel.host_id, +1)
        self.changes.note(ChangeKind.ADDED, channel)

    def replace_channel(self, channel: ChannelRecord) -> None:
        """Replace the channel with the same id and name. The new owner may be another known host."""
        before = self.channels[channel.channel_id].host_id
        self.channels[channel.channel_id] = channel
        if before != channel.host_id:
            self._channel_ids_at[before].discard(channel.channel_id)
            self._channel_ids_at[channel.host_id].add(channel.channel_id)
            self._count(channel.host_id, +1)
        self.changes.note(ChangeKind.UPDATED, channel)
        if before != channel.host_id:
            self._count(before, -1)

    def remove_channel(self, channel: ChannelRecord) -> None:
        """Remove a channel that exists."""
        del self.channels[channel.channel_id]
        del self.channel_ids[channel.name]
        self.channel_creators.note(channel.created_by, -1)
        self._channel_ids_at[channel.host_id].discard(channel.channel_id)
        self.changes.note(ChangeKind.REMOVED, channel)
        self._count(channel.host_id, -1)

    def put_host(self, host: HostRecord) -> None:
        """Add or replace a host. If it is alive, no other live host may have its name.

        A host that is not alive stays in the tables while channels or queues still name it as their owner, or while it
        is among the last LOST_HOSTS_MAX lost hosts.
        """
        before = self.hosts.get(host.host_id)
        if before is not None and before.alive:
            del self.host_ids[before.name]
        self.hosts[host.host_id] = host
        self._channel_ids_at.setdefault(host.host_id, set())
        if host.alive:
            self.host_ids[host.name] = host.host_id
        self.changes.note(ChangeKind.ADDED if before is None else ChangeKind.UPDATED, host)
        self._note_lost(host)
        self._drop_if_done(host)

    def forget_lost_hosts(self, name: str) -> None:
        """Take the hosts of that name off the list of lost hosts, because a live host has the name now."""
        for host in [self.hosts[one] for one in self.lost if self.hosts[one].name == name]:
            self.put_host(replace(host, lease_ended_unix_nano=None))

    def _note_lost(self, host: HostRecord) -> None:
        if not host.is_lost:
            self.lost.discard(host.host_id)
            return
        self.lost.add(host.host_id)
        if len(self.lost) > LOST_HOSTS_MAX:
            first = min((self.hosts[one] for one in self.lost), key=_when_lost)
            self.put_host(replace(first, lease_ended_unix_nano=None))

    def set_load(self, host_id: bytes, load: HostLoad) -> None:
        """Set the load of a known host. Watchers do not get this change, because loads change all the time."""
        self.hosts[host_id] = replace(self.hosts[host_id], load=load)

    def put_queue(self, queue: QueueRecord) -> None:
        """Add a queue or mailbox, or replace the queue or mailbox of that id.

        Its host must be known, and may be another than before. If its puts wait for no replicas, it has none.
        """
        before = self.queues.by_id.get(queue.queue_id)
        if queue.spec.ack != "replica":
            self.replicas.store(queue.queue_id, ())
        self.queues.put(queue)
        if before is not None and before.host_id != queue.host_id:
            self._drop_if_done(self.hosts[before.host_id])

    def remove_queue(self, queue: QueueRecord) -> None:
        """Remove a queue or mailbox that exists, with its copies."""
        self.replicas.store(queue.queue_id, ())
        self.queues.remove(queue)
        self._drop_if_done(self.hosts[queue.host_id])

    def _count(self, host_id: bytes, step: int) -> None:
        host = self.hosts[host_id]
        host = self.hosts[host_id] = replace(host, channels=host.channels + step)
        self._drop_if_done(host)

    def _drop_if_done(self, host: HostRecord) -> None:
        if host.alive or host.is_lost:
            return
        if host.channels == 0 and self.queues.count_at(host.host_id) == 0 and host.host_id in self.hosts:
            del self.hosts[host.host_id]
            del self._channel_ids_at[host.host_id]
            self.changes.note(ChangeKind.REMOVED, host)


def _when_lost(host: HostRecord) -> tuple[int, bytes]:
    """The sort key of lost hosts, which is the same on every replica."""
    return host.lease_ended_unix_nano or 0, host.host_id
