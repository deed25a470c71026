"""The runs that the feed of a replica sends before the channel stores them."""

from __future__ import annotations

from collections.abc import Callable

from stampede_rt.v1 import replica_service_pb2 as pb
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.replication import Replication
from stampede_rt_channel_host.copies.fed_items import encode_item
from stampede_rt_channel_host.copies.feed_responses import FeedResponses
from stampede_rt_channel_host.copies.sent_ahead import SentAhead
from stampede_rt_channel_host.core.channel import ChannelFeed, NewItem


class AheadItemSender(SentAhead):
    """Sends runs of one feed ahead."""

    def __init__(
        self, hosted: HostedChannel, replication: Replication, opening: pb.FeedOpen, feed: ChannelFeed,
        responses: FeedResponses,
    ) -> None:  # fmt: skip
        """`opening`: the first request of the feed. `responses` makes the other messages of the feed."""
        super().__init__(opening.host_id, replication.diverged_host_ids)
        self._hosted = hosted
        self._feed = feed
        self._responses = responses
        self._takes_runs = opening.takes_runs  # whether the replica takes runs of several items ahead

    def send(self, item: NewItem, write: Callable[[bytes], None]) -> bool:
        """Send a run that the channel is about to store.

        Returns False, and sends nothing, if the replica also lacks other facts, or does not take this run ahead.
        """
        is_fit = (item.items == 1 or self._takes_runs) and not self._responses.owes_facts(self._hosted)
        fed = self._feed.take_ahead(item) if is_fit else None
        if fed is None:
            return False
        self.sent(item.end_seq)
        write(encode_item(fed))
        return True
