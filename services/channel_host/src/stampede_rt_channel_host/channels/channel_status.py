"""A channel's counters and bounds in their protobuf form."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from stampede_rt.v1 import channel_pb2
from stampede_rt.values.seq_starts import given_between
from stampede_rt.values.timeline import clamp
from stampede_rt_channel_host.channels.copy_state import CopyState
from stampede_rt_channel_host.channels.fed_copies import FedCopy
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.multicast.channel_multicast import ChannelMulticast
from stampede_rt_channel_host.channels.multicast.multicasts import Multicasts
from stampede_rt_channel_host.cluster.records import channel_message
from stampede_rt_channel_host.core.channel import ConsumerStanding, Counters, Pieces
from stampede_rt_channel_host.core.replication import ReplicaState


def channel_status(
    hosted: HostedChannel, now: Callable[[], int], dropped: int, multicasts: Multicasts | None
) -> Pieces[channel_pb2.ChannelStatus]:
    """The status as of the last piece of work, made in pieces. `dropped`: the items that open subscriptions missed.

    Only the number of items that each consumer has still to consume may be a little older.
    """
    consumers = yield from hosted.core.counting_consumers(now())
    status = _status(hosted, consumers, now())
    status.dropped = dropped
    if hosted.recording is not None and hosted.copy is None:
        status.archive.CopyFrom((yield from hosted.recording.status()))
    multicast = None if multicasts is None else multicasts.find(hosted)
    if multicast is not None:
        status.multicast.CopyFrom(_multicast_status(multicast))
    return status


def _multicast_status(multicast: ChannelMulticast) -> channel_pb2.MulticastStatus:
    return channel_pb2.MulticastStatus(
        group=multicast.offer.group,
        readers=multicast.readers,
        datagrams=multicast.datagrams,
        bytes=multicast.bytes,
        repairs=multicast.repairs,
    )


def _status(hosted: HostedChannel, consumers: Sequence[ConsumerStanding], now: int) -> channel_pb2.ChannelStatus:
    counters = _counters(hosted, now)  # first, because this call also frees outdated items, which changes the bounds
    channel = hosted.channel
    return channel_pb2.ChannelStatus(
        record=channel_message(hosted.record),
        counters=counters,
        newest_unix_nano=channel.newest,
        oldest_unix_nano=channel.oldest,
        # a span may end after the greatest int64
        frontier_unix_nano=None if channel.frontier is None else clamp(channel.frontier),
        advance_unix_nano=channel.advanced_to,
        subscriptions=len(hosted.subscriptions) + len(hosted.group_readers),
        waiting_gets=hosted.waiting_gets,
        waiting_puts=len(hosted.puts),
        host_time_unix_nano=now,
        consumers=[
            channel_pb2.ConsumerStatus(consumer_id=one.consumer_id, lease_nanos=one.lease_nanos, waiting=one.waiting)
            for one in consumers
        ],
        copy=None if hosted.copy is None else _copy_status(hosted, hosted.copy),
        fed_copies=[_fed_status(hosted, one) for one in hosted.fed or ()],
        replicated_next_seq=_replicated(hosted),
        inherited_next_seq=channel.losses.inherited_next_seq,
        next_seq=hosted.core.next_seq,
        has_lost_items=channel.lost_before is not None,
    )


def _replicated(hosted: HostedChannel) -> int | None:
    """The seq before which items are replicated; None if no put waits for replicas."""
    replication = hosted.replication
    return None if replication is None or hosted.core is hosted.channel else replication.replicated_next


def _copy_status(hosted: HostedChannel, copy: CopyState) -> channel_pb2.CopyStatus:
    return channel_pb2.CopyStatus(
        source_host_id=copy.source_host_id,
        staleness_nanos=copy.staleness_nanos,
        source_next_seq=copy.source_next_seq,
        missed=hosted.channel.missed,
        waiting=given_between(hosted.channel.next_seq, copy.source_next_seq),
        ready=copy.is_ready,
        reconnects=copy.reconnects,
    )


def _fed_status(hosted: HostedChannel, copy: FedCopy) -> channel_pb2.FedCopyStatus:
    states = {} if hosted.replication is None else hosted.replication.states()
    return channel_pb2.FedCopyStatus(
        host_id=copy.host_id,
        waiting=copy.waiting(),
        subscriptions=copy.subscriptions,
        heard_ago_nanos=copy.report_age_nanos,
        ready=copy.takes_readers,
        replica=copy.is_replica,
        in_sync=states.get(copy.host_id) is ReplicaState.IN,
    )


def _counters(hosted: HostedChannel, now: int) -> channel_pb2.ChannelCounters:
    message = counters_to(hosted.core.counters(now))
    message.delivered_bytes = hosted.delivered_bytes
    message.not_replicated = 0 if hosted.replication is None else hosted.replication.not_replicated
    return message


def counters_to(counted: Counters) -> channel_pb2.ChannelCounters:
    """The counters as a message, without the delivered bytes, which the core does not know."""
    collected, rejected = counted.collected, counted.rejected
    return channel_pb2.ChannelCounters(
        accepted=counted.accepted,
        held=counted.held,
        collected_by_age=collected["age"],
        collected_by_count=collected["count"],
        collected_by_bytes=collected["bytes"],
        collected_by_consumption=collected["consumption"],
        rejected_too_old=rejected["TOO_OLD"],
        rejected_in_future=rejected["IN_FUTURE"],
        rejected_too_large=rejected["ITEM_TOO_LARGE"],
        rejected_full=rejected["CHANNEL_FULL"],
        rejected_malformed=rejected["MALFORMED_RUN"],
        rejected_overloaded=rejected["OVERLOADED"],
        accepted_bytes=counted.accepted_bytes,
        held_bytes=counted.held_bytes,
    )
