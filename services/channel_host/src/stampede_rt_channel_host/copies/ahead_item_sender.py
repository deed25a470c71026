"""The items that the feed of a replica sends before the channel stores them."""

from __future__ import annotations

from collections.abc import Callable

from stampede_rt.errors import Unavailable
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.copies.fed_items import encode_item
from stampede_rt_channel_host.copies.feed_responses import FeedResponses
from stampede_rt_channel_host.core.channel import ChannelFeed, NewItem


class AheadItemSender:
    """Sends single items of one feed ahead. At most one item is sent and not yet stored."""

    def __init__(self, hosted: HostedChannel, host_id: bytes, feed: ChannelFeed, responses: FeedResponses) -> None:
        """`host_id`: the host of the replica. `responses` makes the other messages of the feed."""
        self._hosted = hosted
        self._host_id = host_id
        self._feed = feed
        self._responses = responses
        self._unstored_next = 0  # the replica's place after an item that the channel has not stored yet; 0: none

    def send(self, item: NewItem, write: Callable[[bytes], None]) -> bool:
        """Send an item that the channel is about to store. Returns False if the replica lacks other facts, too."""
        fed = None if self._responses.owes_facts(self._hosted) else self._feed.take_ahead(item)
        if fed is None:
            return False
        self._unstored_next = item.seq + 1
        write(encode_item(fed))
        return True

    def stored(self) -> bool:
        """Note that the channel has stored its items. Returns whether the replica has got all of them ahead.

        The items that the channel has collected meanwhile leave the replica with the next part.
        """
        next_seq, self._unstored_next = self._unstored_next, 0
        return next_seq == self._hosted.core.next_seq

    def take_back(self) -> Unavailable | None:
        """The error that ends the feed, because a defect kept the channel from storing the item. None: none was sent.

        The replica must begin anew.
        """
        if not self._unstored_next:
            return None
        self._unstored_next = 0
        if self._hosted.replication is not None:
            self._hosted.replication.strays.add(self._host_id)
        return Unavailable("a defect kept the owner from storing an item, so its replicas begin anew")
