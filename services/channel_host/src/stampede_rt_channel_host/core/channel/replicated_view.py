"""The part of a channel that readers see, if its items must be replicated first. Pure.

The owner accepts items into the channel immediately. Readers read a copy of the channel in the same process. This copy
is fed like a copy at another host, but gets each part only after all items of the part are replicated. A part is taken
right after each change of the channel. So the copy goes through the same states as the channel, a little later.
"""

from __future__ import annotations

from collections import deque

from stampede_rt_channel_host.core.channel.channel import ChannelCore
from stampede_rt_channel_host.core.channel.fed_channel import FedChannel
from stampede_rt_channel_host.core.channel.feeding import ChannelFeed, FeedPart
from stampede_rt_channel_host.core.channel.held_items import Cut
from stampede_rt_channel_host.core.channel.pieces import Pieces
from stampede_rt_channel_host.core.channel.run import (
    ITEM_OVERHEAD_BYTES,
    ColumnRun,
    Run,
    SingleItemRun,
    Slice,
    make_run,
)

PIECE_BYTES = 256 * 2**10
_WHOLE = 2**62  # more bytes than any channel holds


class ReplicatedView:
    """The part of `source` that readers see, as the channel `shown`."""

    def __init__(self, source: ChannelCore, now: int, cut: Cut) -> None:
        """`cut` copies the body of some items out of a run's body."""
        self.shown = FedChannel(
            source.policy,
            incarnation=source.incarnation,
            name=source.name,
            cut=cut,
        )
        self.shown.take_losses(source.losses)
        self._cut = cut
        self._feed = ChannelFeed(source, None, now, is_exact=True)
        self._parts: deque[FeedPart] = deque()
        self.staged_bytes = 0
        """The memory of the parts that are not shown yet. The source may no longer hold some of their items."""

    def filling(self, now: int) -> Pieces[None]:
        """Show the items that the channel has already, in pieces. Until then, the caller must serve no reads."""
        while (part := self._feed.take(now, PIECE_BYTES)) is not None:
            self._apply(part, now)
            yield

    def stage(self, now: int) -> None:
        """Process the latest change of the channel. It is shown as soon as its items are replicated."""
        is_whole = False
        while not is_whole and (part := self._feed.take(now, _WHOLE)) is not None:  # a part has a few slices at most
            is_whole = part.next_seq == self._feed.source_next_seq
            self.staged_bytes += _bytes_of(part)
            if not self._parts or not part.can_join(self._parts[-1]):
                self._parts.append(part)
            else:
                self._parts[-1] = part.joined_to(self._parts[-1])

    def show(self, replicated: int, now: int) -> bool:
        """Show the changes whose items are all before the seq `replicated`. Returns whether there were any."""
        has_shown = False
        while self._parts and self._parts[0].next_seq <= replicated:
            part = self._parts.popleft()
            self.staged_bytes -= _bytes_of(part)
            self._apply(part, now)
            has_shown = True
        return has_shown

    def _apply(self, part: FeedPart, now: int) -> None:
        self.shown.apply(
            first_seq=part.first_seq,
            cleared=part.cleared,
            runs=[self._run_of(one) for one in part.slices],
            next_seq=part.next_seq,
            collection=part.collection,
            advance=part.advance,
            now=now,
        )

    def _run_of(self, part: Slice) -> Run:
        """The items as a run of the shown channel. It shares the columns and the body of a whole run."""
        run = part.run
        if isinstance(run, SingleItemRun):
            return SingleItemRun(run.first_seq, run.first_time, run.duration, run.length, run.body)
        if part.is_whole:
            whole = ColumnRun(run.first_seq, run.times, run.durations, run.lengths, run.body, run.span)
            whole.whole_bytes = run.payload_bytes(0, len(run))
            return whole
        durations = None if run.durations is None else run.durations[part.lo : part.hi]
        body = self._cut(bytes(run.body), part.lo, part.hi)
        return make_run(part.first_seq, run.times[part.lo : part.hi], durations, run.lengths[part.lo : part.hi], body)

    def close(self) -> None:
        """End the feed. Idempotent."""
        self._feed.close()


def _bytes_of(part: FeedPart) -> int:
    """The memory of the items of a part. A slice keeps the body of its whole run."""
    return sum(len(one.run.body) + len(one.run) * ITEM_OVERHEAD_BYTES for one in part.slices)
