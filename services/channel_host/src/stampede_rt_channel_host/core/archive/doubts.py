"""The times at which an archive may lack items. Pure.

The seqs of an archive show that items are missing, but not which times they had: an item may come late, or have a time
in the future. So each hole in the seqs has an interval of doubt: from the least time that the host could still accept
then, to the greatest.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from stampede_rt.values.seq_starts import given_over
from stampede_rt.values.timeline import MAX_INSTANT, MIN_INSTANT
from stampede_rt_channel_host.core.archive.block import HEAD_BYTES, ROW_BYTES, BlockHead
from stampede_rt_channel_host.core.archive.holes import WindowReach
from stampede_rt_channel_host.core.archive.segment import Segment
from stampede_rt_channel_host.core.archive.segment_blocks import SegmentBlocks
from stampede_rt_channel_host.core.channel.limits import ChannelLimits
from stampede_rt_channel_host.core.channel.run import ITEM_OVERHEAD_BYTES

FILE_BYTES_PER_ITEM = HEAD_BYTES + ROW_BYTES + 64
"""An item without attributes takes at most this many bytes of a segment in addition to its payload. It takes all these
bytes if it is alone in its block and run.
"""


class Doubt(NamedTuple):
    """An interval of times, both ends inclusive, at which some of the `items` lost items may have been."""

    start: int
    end: int
    items: int


@dataclass(frozen=True)
class _Search:
    """A search for doubts: the segments, the limits of the channel, and the numbers of the segments to look into.

    `last`: no item of the archive has a later time.
    """

    segments: Sequence[Segment]
    limits: ChannelLimits
    blocks_of: Callable[[Segment], SegmentBlocks]
    near: Container[int]
    last: int
    _by_size: dict[int, int] = field(default_factory=dict)  # by the place of a segment: `_least_by_size` of it

    def find(self) -> Iterator[Doubt]:
        """All doubts. The doubts in segments that are not near have wider bounds, because their blocks may be in
        an object store.
        """
        former: BlockHead | Segment | None = None
        ends: list[int] = []  # the end seqs of the segments that end after `former`
        for at, one in enumerate(self.segments):
            if one.number not in self.near and one.items:
                if former is None or one.end_seq - former.end_seq != one.items:  # a quick test, for long archives
                    missing_items = self._count_missing(former, one.end_seq, ends) - one.items
                    if missing_items > 0:
                        yield self._doubt(at, former, self._end_after(at), missing_items)
                former, ends = one, []
                continue
            blocks = self.blocks_of(one) if one.items else SegmentBlocks()
            first, last = blocks.items_at(0), blocks.items_at(-1)
            if first is not None and last is not None:  # otherwise no block can be read: all its items are missing
                for earlier, later in ((former, first.head), *blocks.breaks()):
                    missing_items = self._count_missing(earlier, later.first_seq, ends)
                    if missing_items:
                        end = max(later.low[0], self._latest(later.first_accepted))
                        yield self._doubt(at, earlier, end, missing_items)
                former, ends = last.head, []
            ends.append(one.end_seq)
        missing_items = self._count_missing(former, self.segments[-1].end_seq, ends)
        if missing_items:
            yield self._doubt(len(self.segments) - 1, former, self.last, missing_items)

    def _count_missing(self, former: BlockHead | Segment | None, end_seq: int, ends: Sequence[int]) -> int:
        """The number of items that are missing before this seq. `ends`: see `given_over`."""
        return given_over(self.segments[0].first_seq if former is None else former.end_seq, end_seq, ends)

    def _latest(self, accepted: int) -> int:
        """The greatest possible time of an item that the host accepted at or before `accepted`."""
        return accepted + self.limits.max_future_nanos

    def _end_after(self, at: int) -> int:
        """The greatest time of a doubt in this segment or directly after it.

        The host accepted the missing items before the items of the next segment, so their times have a bound.
        """
        following = next((one for one in self.segments[at + 1 :] if one.items), None)
        high = self.segments[at].high
        end = self.last if following is None else self._latest(following.last_accepted)
        return end if high is None else max(end, high[0])

    def _doubt(self, at: int, former: BlockHead | Segment | None, end: int, missing_items: int) -> Doubt:
        """The doubt after the block or segment `former`, in the segment `at`."""
        if former is None or former.high is None:
            return Doubt(MIN_INSTANT, end, missing_items)
        if at not in self._by_size:
            self._by_size[at] = self._least_by_size(at)
        start = max(self._least_by_age(at, former.last_accepted), self._by_size[at])
        return Doubt(min(start, end, former.high[0]), max(end, former.high[0]), missing_items)

    def _least_by_age(self, at: int, accepted: int) -> int:
        """The least time of a doubt by `max_age`, for items that the host accepted after the instant `accepted`.

        The host accepts no item before the last bucket that had ended `max_age` before this instant.
        """
        if self.limits.max_age_nanos is None or self.limits.max_age_unconsumed_nanos is not None:
            return MIN_INSTANT
        bound = accepted - self.limits.max_age_nanos - self.limits.overlap_nanos
        times = (self._last_before(bound, self.segments[place]) for place in range(at, -1, -1))
        return next((one for one in times if one is not None), MIN_INSTANT)

    def _last_before(self, bound: int, one: Segment) -> int | None:
        """The latest known time before `bound` of an item of a segment, or None. Loads no blocks of a far segment."""
        if one.low is None or one.high is None or one.low[0] >= bound:
            return None
        if one.high[0] < bound:
            return one.high[0]
        found = self.blocks_of(one).last_end_before(bound) if one.number in self.near else None
        return one.low[0] if found is None else found

    def _least_by_size(self, at: int) -> int:
        """The least time of a doubt by `max_items` and `max_bytes`.

        The host accepts no item before the items that these limits have collected.
        """
        limits, items, charge = self.limits, 0, 0
        low = self.segments[at].low
        least = MAX_INSTANT if low is None else low[0]
        for one in reversed(self.segments[:at]):
            if one.low is not None:
                least = min(least, one.low[0])
            items, charge = items + one.items, charge + _least_charge(one)
            if charge > limits.max_bytes or (limits.max_items is not None and items > limits.max_items):
                return least
        return MIN_INSTANT


def _least_charge(one: Segment) -> int:
    """The least bytes that the items of a segment count against max_bytes. In a file an item has more bytes."""
    return one.items * ITEM_OVERHEAD_BYTES + max(0, one.length - one.items * FILE_BYTES_PER_ITEM)


def doubts_in(
    segments: Sequence[Segment],
    blocks_of: Callable[[Segment], SegmentBlocks],
    taken: Iterable[Segment],
    reach: WindowReach,
    limits: ChannelLimits | None,
    as_of: int | None,
) -> list[Doubt]:
    """Find the doubts at the times of a window. `taken`: the segments from which the window took blocks. `as_of`: the
    archive is as it was at this instant; None: it is as it is now.
    """
    if limits is None or not segments:
        return []
    near = {one.number for one in taken}
    near.update(one.number for one in segments if reach.meets(one))
    last = reach.border if as_of is None else max(reach.border, as_of + limits.max_future_nanos)
    found = _Search(segments, limits, blocks_of, near, last).find()
    return [one for one in found if one.start <= reach.high and one.end >= reach.low]
