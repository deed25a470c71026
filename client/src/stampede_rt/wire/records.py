"""Converts channels, policies, hosts and counters to and from protobuf (`channel.proto`, `directory.proto`)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from stampede_rt.v1 import channel_pb2, channel_service_pb2, directory_pb2, replica_pb2
from stampede_rt.values.model import (
    Ack,
    Change,
    ChangeKind,
    ChannelInfo,
    HostInfo,
    LoadInfo,
    OnFull,
    Policy,
    SupernodeInfo,
)
from stampede_rt.values.proxying import CopyStats, ProxyInfo
from stampede_rt.values.statistics import (
    ArchiveStats,
    ChannelMulticastStats,
    ChannelStats,
    ConsumerStats,
    ReaderStats,
    WriterStats,
)

_ON_FULL: dict[OnFull, channel_pb2.OnFull] = {
    "drop_oldest": channel_pb2.ON_FULL_DROP_OLDEST,
    "block": channel_pb2.ON_FULL_BLOCK,
    "reject": channel_pb2.ON_FULL_REJECT,
}
_ACKS: dict[Ack, channel_pb2.Ack] = {
    "host": channel_pb2.ACK_HOST,
    "disk": channel_pb2.ACK_DISK,
    "replica": channel_pb2.ACK_REPLICA,
}
_FROM_ACKS = {value: key for key, value in _ACKS.items()}
_FROM_ON_FULL = {value: key for key, value in _ON_FULL.items()}
_CHANGE_KINDS: dict[directory_pb2.ChangeKind, ChangeKind] = {
    directory_pb2.CHANGE_KIND_ADDED: "added",
    directory_pb2.CHANGE_KIND_UPDATED: "updated",
    directory_pb2.CHANGE_KIND_REMOVED: "removed",
}


def change_kind(kind: directory_pb2.ChangeKind) -> ChangeKind:
    """Return the kind of a change. A kind that this release does not know counts as "updated"."""
    return _CHANGE_KINDS.get(kind, "updated")


# The keys of `ChannelStats.collected` and `ChannelStats.rejected`, which are also parts of the names of counters.
COLLECTED_CAUSES = ("age", "count", "bytes", "consumption")
REJECTED_REASONS = ("too_old", "in_future", "too_large", "full", "malformed", "overloaded")


def policy_to_spec(policy: Policy) -> channel_pb2.ChannelSpec:
    """Return the message for a channel's policy. A setting that was not stated stays unset."""
    return channel_pb2.ChannelSpec(
        retention=_retention_of(policy),
        on_full=_ON_FULL[policy.on_full] if policy.on_full else channel_pb2.ON_FULL_UNSPECIFIED,
        max_future_nanos=policy.max_future_nanos,
        content_type=policy.content_type,
        max_item_bytes=policy.max_item_bytes,
        overlap_nanos=policy.overlap_nanos,
        archive_nanos=policy.archive_nanos,
        archive_bytes=policy.archive_bytes,
        replicas=policy.replicas,
        ack=ack_to_wire(policy.ack),
        min_replicas=policy.min_replicas,
    )


def ack_to_wire(ack: Ack | None) -> channel_pb2.Ack:
    """Return the number of an ack in the contract. None: the put does not state an ack."""
    return _ACKS[ack] if ack else channel_pb2.ACK_UNSPECIFIED


def ack_from_wire(ack: channel_pb2.Ack) -> Ack | None:
    """Return an ack of the contract; None if it is not stated."""
    return _FROM_ACKS.get(ack)


def _retention_of(policy: Policy) -> channel_pb2.RetentionPolicy:
    return channel_pb2.RetentionPolicy(
        max_age_nanos=policy.max_age_nanos,
        max_items=policy.max_items,
        max_bytes=policy.max_bytes,
        consumers=policy.consumers,
        max_age_unconsumed_nanos=policy.max_age_unconsumed_nanos,
    )


def policy_from_spec(spec: channel_pb2.ChannelSpec) -> Policy:
    """Return a channel's policy, from its message. A setting that was not stated is None."""
    retention, unconsumed = spec.retention, "max_age_unconsumed_nanos"
    return Policy(
        max_age_nanos=retention.max_age_nanos if retention.HasField("max_age_nanos") else None,
        max_items=retention.max_items if retention.HasField("max_items") else None,
        max_bytes=retention.max_bytes if retention.HasField("max_bytes") else None,
        consumers=retention.consumers if retention.HasField("consumers") else None,
        on_full=_FROM_ON_FULL.get(spec.on_full),
        max_future_nanos=spec.max_future_nanos if spec.HasField("max_future_nanos") else None,
        content_type=spec.content_type if spec.HasField("content_type") else None,
        max_item_bytes=spec.max_item_bytes if spec.HasField("max_item_bytes") else None,
        max_age_unconsumed_nanos=retention.max_age_unconsumed_nanos if retention.HasField(unconsumed) else None,
        overlap_nanos=spec.overlap_nanos if spec.HasField("overlap_nanos") else None,
        archive_nanos=spec.archive_nanos if spec.HasField("archive_nanos") else None,
        archive_bytes=spec.archive_bytes if spec.HasField("archive_bytes") else None,
        replicas=spec.replicas if spec.HasField("replicas") else None,
        ack=ack_from_wire(spec.ack),
        min_replicas=spec.min_replicas if spec.HasField("min_replicas") else None,
    )


def host_info(record: directory_pb2.HostRecord) -> HostInfo:
    """Return a host, as callers see it."""
    return HostInfo(
        host_id=record.host_id,
        name=record.name,
        endpoints=tuple(endpoint.target for endpoint in record.gatekeepers),
        alive=record.alive,
        channels=record.channels,
        version=record.version,
        load=host_load(record.load) if record.HasField("load") else None,
        lease_ended=record.lease_ended_unix_nano if record.HasField("lease_ended_unix_nano") else None,
        archive_place=record.archive_place or None,
    )


def host_load(message: directory_pb2.HostLoad) -> LoadInfo:
    """Return the load of a host, as callers see it."""
    return LoadInfo(
        busy_permille=message.busy_permille,
        held_bytes=message.held_bytes,
        bytes_max=message.bytes_max,
        private=message.private,
    )


def channel_info(record: channel_pb2.ChannelRecord, host: directory_pb2.HostRecord | None) -> ChannelInfo:
    """Return a channel, as callers see it. `host` is its owner, or None if the directory no longer knows that host."""
    return ChannelInfo(
        channel_id=record.channel_id,
        name=record.name,
        host_id=record.host_id,
        host=host.name if host else "",
        host_alive=bool(host and host.alive),
        epoch=record.epoch,
        incarnation=record.incarnation,
        policy=policy_from_spec(record.spec),
        spec_version=record.spec_version,
        created_by=record.created_by,
    )


def supernode_info(record: directory_pb2.SupernodeRecord) -> SupernodeInfo:
    """Return a supernode, as callers see it."""
    return SupernodeInfo(
        supernode_id=record.supernode_id,
        endpoint=record.endpoint.target,
        is_leader=record.is_leader,
        healthy=record.healthy,
    )


def channel_stats(
    status: channel_pb2.ChannelStatus, clock_offset_nanos: int | None = None, transport: str | None = None
) -> ChannelStats:
    """Return a channel's counters, as callers see them. The client has measured the offset and knows the transport."""
    counters = status.counters
    return ChannelStats(
        accepted=counters.accepted,
        held=counters.held,
        collected={cause: getattr(counters, f"collected_by_{cause}") for cause in COLLECTED_CAUSES},
        rejected={reason: getattr(counters, f"rejected_{reason}") for reason in REJECTED_REASONS},
        accepted_bytes=counters.accepted_bytes,
        held_bytes=counters.held_bytes,
        delivered_bytes=counters.delivered_bytes,
        newest=status.newest_unix_nano if status.HasField("newest_unix_nano") else None,
        oldest=status.oldest_unix_nano if status.HasField("oldest_unix_nano") else None,
        frontier=status.frontier_unix_nano if status.HasField("frontier_unix_nano") else None,
        advance=status.advance_unix_nano if status.HasField("advance_unix_nano") else None,
        subscriptions=status.subscriptions,
        waiting_gets=status.waiting_gets,
        waiting_puts=status.waiting_puts,
        incarnation=status.record.incarnation,
        host_time=status.host_time_unix_nano,
        policy=policy_from_spec(status.record.spec),
        consumers=[
            ConsumerStats(consumer_id=one.consumer_id, lease_nanos=one.lease_nanos, waiting=one.waiting)
            for one in status.consumers
        ],
        clock_offset_nanos=clock_offset_nanos,
        transport=transport,
        copies=[*map(copy_stats, status.fed_copies)],
        replicated=status.replicated_next_seq if status.HasField("replicated_next_seq") else None,
        not_replicated=status.counters.not_replicated,
        inherited_next_seq=status.inherited_next_seq if status.HasField("inherited_next_seq") else None,
        dropped=status.dropped,
        multicast=_multicast_stats(status.multicast) if status.HasField("multicast") else None,
        archive=_archive_stats(status.archive) if status.HasField("archive") else None,
        next_seq=status.next_seq if status.HasField("next_seq") else None,
        has_lost_items=status.has_lost_items if status.HasField("has_lost_items") else None,
    )


def _archive_stats(archive: channel_pb2.ArchiveStatus) -> ArchiveStats:
    return ArchiveStats(
        items=archive.items,
        bytes=archive.bytes,
        disk_bytes=archive.disk_bytes,
        oldest=archive.oldest_unix_nano if archive.HasField("oldest_unix_nano") else None,
        newest=archive.newest_unix_nano if archive.HasField("newest_unix_nano") else None,
        waiting=archive.waiting,
        unarchived=archive.unarchived,
        place=archive.place,
        failure=archive.failure,
    )


def _multicast_stats(sent: channel_pb2.MulticastStatus) -> ChannelMulticastStats:
    return ChannelMulticastStats(
        group=sent.group, readers=sent.readers, datagrams=sent.datagrams, bytes=sent.bytes, repairs=sent.repairs
    )


def copy_stats(copy: channel_pb2.FedCopyStatus) -> CopyStats:
    """Return a copy, as the host that feeds it sees it."""
    return CopyStats(
        host_id=copy.host_id,
        waiting=copy.waiting,
        subscriptions=copy.subscriptions,
        ready=copy.ready,
        replica=copy.replica,
        in_sync=copy.in_sync,
        heard_ago_nanos=copy.heard_ago_nanos,
    )


def with_users(stats: ChannelStats, response: channel_service_pb2.GetChannelStatusResponse) -> ChannelStats:
    """Return the counters with the channel's readers and writers, if the response has them."""
    if not response.HasField("users"):
        return stats
    users = response.users
    return replace(
        stats,
        readers=[
            ReaderStats(subscriber=one.subscriber, collected=one.collected, skipped=one.skipped)
            for one in users.readers
        ],
        writers=[WriterStats(name=one.name, last_put=one.last_put_unix_nano) for one in users.writers],
    )


def proxy_info(
    channel: str,
    replica: replica_pb2.ReplicaRecord,
    hosts: Mapping[bytes, directory_pb2.HostRecord],
    status: channel_pb2.ChannelStatus | None,
) -> ProxyInfo:
    """Return a proxy, as callers see it.

    `hosts` has the hosts by id. `status` is the status of the copy, or None if the copy's host did not answer.
    """
    names = {host_id: host.name for host_id, host in hosts.items()}
    host, source = names.get(replica.host_id, ""), names.get(replica.source_host_id, "")
    if status is None:
        return ProxyInfo(channel=channel, host=host, source=source)
    waiting = status.copy.waiting
    if not status.copy.HasField("waiting"):
        waiting = max(0, status.copy.source_next_seq - 1 - status.counters.accepted - status.copy.missed)
    return ProxyInfo(
        channel=channel,
        host=host,
        source=source,
        ready=status.copy.ready,
        staleness_nanos=status.copy.staleness_nanos,
        held=status.counters.held,
        missed=status.copy.missed,
        waiting=waiting,
        subscriptions=status.subscriptions,
        reconnects=status.copy.reconnects,
    )


def change(message: directory_pb2.DirectoryChange, hosts: Mapping[bytes, directory_pb2.HostRecord]) -> Change:
    """Return one change of the directory. `hosts` has the known hosts by id, for the names of owners."""
    if message.WhichOneof("subject") == "host":
        return Change(index=message.index, kind=change_kind(message.kind), subject=host_info(message.host))
    info = channel_info(message.channel, hosts.get(message.channel.host_id))
    return Change(index=message.index, kind=change_kind(message.kind), subject=info)
