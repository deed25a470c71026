"""Checks the beginning of a feed."""

from __future__ import annotations

from stampede_rt.errors import InvalidArgument, Overloaded
from stampede_rt.v1 import replica_service_pb2 as pb
from stampede_rt_channel_host.channels import refusals
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.store import ChannelStore
from stampede_rt_channel_host.cluster.identity import ID_BYTES
from stampede_rt_channel_host.copies.moves.outgoing_moves import OutgoingMoves

FEEDS_MAX = 64  # the most feeds of one channel; the directory allows 16 copies, and broken streams may linger


def check_named_host(opening: pb.FeedOpen) -> None:
    """Raises InvalidArgument if the first request of a feed does not name the host of the copy."""
    if len(opening.host_id) != ID_BYTES or not opening.target:
        raise InvalidArgument("the feed's open has no host_id of 16 bytes, or no target; state both")


async def fed_channel(store: ChannelStore, moves: OutgoingMoves, opening: pb.FeedOpen) -> HostedChannel:
    """The channel of a feed that begins. Raises the errors of `FeedStream.run`."""
    hosted = await store.bind_for_feed(opening.channel_id, opening.epoch)  # perhaps no caller has used it yet
    check_feeds(hosted)
    if opening.owner_facts and hosted.copy is not None:
        raise refusals.copy_cannot(hosted.record.name, "does not know the facts that only the owner has")
    if opening.move_id:
        # Checked before the feed begins: a replica whose feed begins anew leaves the replicas in sync, and a refused
        # move must not cause this.
        moves.check(hosted, opening.host_id)
    return hosted


def check_feeds(hosted: HostedChannel) -> None:
    """Raises Overloaded if the channel has too many feeds."""
    if len([*(hosted.fed or ())]) >= FEEDS_MAX:
        raise Overloaded(f"channel {hosted.record.name} has {FEEDS_MAX} feeds, the limit; end some")


def has_others_items(hosted: HostedChannel, opening: pb.FeedOpen) -> bool:
    """Whether the copy may have items that this owner lacks.

    They are items of a former owner, or items of a run that this owner sent ahead and then could not store.
    """
    replication, place = hosted.replication, opening.place
    if replication is None or place.incarnation != hosted.core.incarnation:
        return False
    if opening.host_id in replication.diverged_host_ids:
        return True
    start, since_epoch = replication.start, replication.since_epoch
    return place.owner_epoch < since_epoch and (place.owner_epoch + 1 < since_epoch or place.next_seq > start)
