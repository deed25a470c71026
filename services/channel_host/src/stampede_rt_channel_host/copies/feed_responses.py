"""The messages of a feed: the parts of the channel, with the state of the source."""

from __future__ import annotations

from collections.abc import Callable

from stampede_rt.v1 import replica_service_pb2 as pb
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.cluster.cut_floors import floor_to_message
from stampede_rt_channel_host.cluster.records import channel_message
from stampede_rt_channel_host.copies.messages import state_to
from stampede_rt_channel_host.core.channel import ChannelCore, ChannelFeed, FeedPart
from stampede_rt_channel_host.core.group import CutFloor

FLOORS_MAX = 64  # a copy learns of this many groups of one channel; reads through other groups go to the owner


class FeedResponses:
    """Makes the messages of one feed. It remembers the facts that the copy has already got."""

    def __init__(self, now: Callable[[], int], floors_of: Callable[[bytes], list[CutFloor]]) -> None:
        """`floors_of` returns the cuts of the groups of a channel that this host owns."""
        self._now = now
        self._floors_of = floors_of
        self._sent_floors: dict[bytes, CutFloor] = {}
        self.heard_nanos = 0
        """The copy's clock, as its last request had it."""
        self._sent_heard_nanos = -1
        self._sent_record = b""

    def owes_sign(self, hosted: HostedChannel) -> bool:
        """Whether the copy waits for a message, even if no item has come."""
        return self.heard_nanos != self._sent_heard_nanos or hosted.record.message != self._sent_record

    def owes_facts(self, hosted: HostedChannel) -> bool:
        """Whether the next message may need more than its items: a sign, or cuts of groups."""
        return self.owes_sign(hosted) or bool(self._floors_of(hosted.record.channel_id))

    def bare(
        self, hosted: HostedChannel, source: ChannelCore, feed: ChannelFeed,
        opened: pb.FeedOpened | None = None, handoff: pb.FeedHandoff | None = None,
    ) -> bytes:  # fmt: skip
        """The encoded message of a part in which nothing has changed."""
        part = FeedPart(feed.next_seq, None, (), feed.next_seq, None, None)
        return self.of(hosted, source, part, opened, handoff)

    def of(
        self, hosted: HostedChannel, source: ChannelCore, part: FeedPart,
        opened: pb.FeedOpened | None = None, handoff: pb.FeedHandoff | None = None,
    ) -> bytes:  # fmt: skip
        """The encoded message, without the part's items. `source`: the channel that is fed."""
        response = pb.FeedResponse(opened=opened, state=state_to(part, self._now()))
        state = response.state
        state.heard_nanos = self._sent_heard_nanos = self.heard_nanos
        state.source_next_seq = source.next_seq
        if hosted.copy is not None:
            state.staleness_nanos = hosted.copy.staleness_nanos
            state.source_next_seq = max(state.source_next_seq, hosted.copy.source_next_seq)
        if part.next_seq == source.next_seq and (floors := self._new_floors(hosted)):
            state.floors.extend(map(floor_to_message, floors))
        if hosted.record.message != self._sent_record:
            self._sent_record = hosted.record.message
            state.channel.CopyFrom(channel_message(hosted.record))
        if handoff is not None:
            state.handoff.CopyFrom(handoff)
        return response.SerializeToString()

    def _new_floors(self, hosted: HostedChannel) -> list[CutFloor]:
        """The cuts that have changed since the copy got them. With this part, the copy has all items before them."""
        copy = hosted.copy
        floors = self._floors_of(hosted.record.channel_id) if copy is None else [*copy.floors.values()]
        if not floors:
            return []
        new = [one for one in floors[:FLOORS_MAX] if self._sent_floors.get(one.group_id) != one]
        self._sent_floors |= {one.group_id: one for one in new}
        return new
