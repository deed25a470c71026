"""The items that the feed of a replica sends before the channel stores them."""

from __future__ import annotations

from collections.abc import Callable

from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.replication import Replication
from stampede_rt_channel_host.copies.ahead_place import AheadPlace
from stampede_rt_channel_host.copies.fed_items import encode_item
from stampede_rt_channel_host.copies.feed_responses import FeedResponses
from stampede_rt_channel_host.core.channel import ChannelFeed, NewItem


class AheadItemSender(AheadPlace):
    """Sends single items of one feed ahead."""

    def __init__(
        self, hosted: HostedChannel, replication: Replication, host_id: bytes, feed: ChannelFeed,
        responses: FeedResponses,
    ) -> None:  # fmt: skip
        """`host_id`: the host of the replica. `responses` makes the other messages of the feed."""
        super().__init__(host_id, replication.strays)
        self._hosted = hosted
        self._feed = feed
        self._responses = responses

    def send(self, item: NewItem, write: Callable[[bytes], None]) -> bool:
        """Send an item that the channel is about to store. Returns False if the replica lacks other facts, too."""
        fed = None if self._responses.owes_facts(self._hosted) else self._feed.take_ahead(item)
        if fed is None:
            return False
        self.sent(item.seq + 1)
        write(encode_item(fed))
        return True
