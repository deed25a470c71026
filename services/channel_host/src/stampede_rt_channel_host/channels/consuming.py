"""Performs one request to consume items, in pieces. A request may name thousands of seqs that are not adjacent, and the
channel keeps an entry for each of them.
"""

from __future__ import annotations

from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt_channel_host.channels import refusals
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.store import ChannelStore
from stampede_rt_channel_host.core.channel import LEASE_NANOS, Pieces

SEQS_PER_PIECE = 256


def consuming(store: ChannelStore, request: pb.ConsumeRequest, caller_name: str = "") -> Pieces[pb.ConsumeResponse]:
    """Consume items for one consumer, in pieces, and accept the waiting puts for which there is room now.

    An invalid request consumes nothing. `caller_name`: the name of the caller; empty if the number of its consumer
    places has no limit. Raises InvalidArgument, StaleBinding if the host does not serve the channel, ChannelFull if all
    consumer places are taken, and IncarnationLost if the seqs belong to another incarnation. Raises Overloaded if the
    caller has too many places, or if the memory for seqs that are consumed out of order is used up. If the memory is
    used up, the first pieces may have consumed some of the items.
    """
    hosted, lease_nanos, seqs, items = _find(store, request), _lease_nanos(request), sorted(request.seqs), 0
    yield from hosted.core.catching_up(store.now())
    hosted.core.check_consumption(request.consumer_id, seqs, lease_nanos)
    while len(seqs) > SEQS_PER_PIECE:
        part, seqs = seqs[:SEQS_PER_PIECE], seqs[SEQS_PER_PIECE:]
        # a lease of 0 in the request gives the consumer's place up: only the last piece may do that
        items += (
            _find(store, request).consume(request.consumer_id, part, max(lease_nanos, LEASE_NANOS), caller_name).items
        )
        yield
    last = _find(store, request).consume(request.consumer_id, seqs, lease_nanos, caller_name)
    return pb.ConsumeResponse(consumed=items + last.items, lease_nanos=last.lease_nanos)


def _find(store: ChannelStore, request: pb.ConsumeRequest) -> HostedChannel:
    """The channel of the request. Call it before each piece: the channel may leave the host between two pieces."""
    hosted = store.find(request.channel_id, request.epoch)
    if not hosted.core.holds(request.incarnation, request.seqs):
        raise refusals.other_incarnation(hosted.record.name, request.incarnation, hosted.record.incarnation)
    return hosted


def _lease_nanos(request: pb.ConsumeRequest) -> int:
    return request.lease_nanos if request.HasField("lease_nanos") else LEASE_NANOS
