"""The last step of the source in a move: it holds the channel, and permits the move when the copy has everything."""

from __future__ import annotations

from stampede_rt.v1 import replica_service_pb2 as pb
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.copies.moves.outgoing_moves import OutgoingMove
from stampede_rt_channel_host.core.channel import ChannelFeed

IDLE_NANOS = 1_000_000_000
"""A channel is idle if no producer has put for this time."""


class HandoffDecision:
    """Decides which message of a feed hands the channel over."""

    def __init__(self, hosted: HostedChannel, move: OutgoingMove, feed: ChannelFeed, *, when_idle: bool) -> None:
        """`when_idle`: the destination need not ask for the hold if the channel is idle (`FeedOpen`)."""
        self._hosted = hosted
        self._move = move
        self._feed = feed
        self._when_idle = when_idle
        self._is_over = False

    def next_handoff(self, now: int) -> pb.FeedHandoff | None:
        """The handoff for the next message; None: it comes later.

        The next message has it if the channel is held, the replicas in sync have everything, and the copy has
        everything with this message. Holds an idle channel now if the destination wants that.

        Raises Unavailable if too few replicas are in sync.
        """
        is_early = not self._move.is_held
        if self._is_over or (is_early and not self._is_idle(now)) or not self._has_everything(now):
            return None
        if is_early:
            self._move.hold()
            if not self._has_everything(now):  # the hold has noted the outcomes of runs that wait for room
                return None
        if not self._move.is_held or not self._is_fully_replicated():
            return None
        self._is_over = True
        return pb.FeedHandoff(host_time_unix_nano=now, permit=self._move.permit)

    def _is_idle(self, now: int) -> bool:
        """Whether the channel may be held already while the last message is on its way, because no caller puts."""
        if not self._when_idle or self._hosted.replication is not None:
            return False
        latest = self._hosted.puts.retries.latest_time
        return latest is None or now - latest >= IDLE_NANOS

    def _has_everything(self, now: int) -> bool:
        feed = self._feed
        return (
            feed.owner_facts is not None and feed.next_seq == feed.source_next_seq and feed.owner_facts.is_complete(now)
        )

    def _is_fully_replicated(self) -> bool:
        replication = self._hosted.replication
        if replication is None or replication.is_fully_replicated:
            return True
        replication.check_movable()
        return False
