"""Finds the items that an archive lacks before, between and after the items that a read takes. Pure."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Set
from typing import NamedTuple

from stampede_rt.values.seq_starts import begin_of, given_between, given_over
from stampede_rt.values.timeline import MIN_INSTANT
from stampede_rt_channel_host.core.archive.segment import PlacedBlock, Segment
from stampede_rt_channel_host.core.archive.segment_blocks import SegmentBlocks
from stampede_rt_channel_host.core.channel.item_keys import LAST_KEY

BlocksOf = Callable[[Segment], SegmentBlocks]


class Hole(NamedTuple):
    """Items that an archive should have, and lacks. Their times lie between `start` and `end`, unless they came late.

    `items` is 0 if an owner was lost, and no host knows which items it had.
    """

    start: int
    end: int
    items: int


class WindowReach(NamedTuple):
    """The times from `low` to `high`, inclusive: a window has looked for the archived items of these times.

    The window needs no archived items from the time `border` on, because memory has them.
    """

    low: int
    high: int
    border: int = LAST_KEY[0]

    def meets(self, segment: Segment) -> bool:
        """Whether the times from the first to the last item of the segment overlap with the times of the window."""
        low, high = segment.low, segment.high
        return low is not None and high is not None and low[0] <= self.high and self.low <= high[0]


def holes(blocks: SegmentBlocks, taken: Set[int]) -> Iterator[Hole]:
    """Yield the holes directly before and after the blocks that a read took from one segment.

    The items of a hole were never archived, or the head of their block is damaged. `taken`: the offsets of the blocks
    that the read took.
    """
    positions = {blocks.position(offset) for offset in taken}
    for at in sorted(positions | {at - 1 for at in positions if at}):
        before, after = blocks.items_at(at), blocks.items_at(at + 1)
        if before is not None and after is not None:
            yield from _between(before, after)


def border_holes(
    segments: Sequence[Segment], blocks_of: BlocksOf, taken: Mapping[Segment, Set[int]], reach: WindowReach
) -> Iterator[Hole]:
    """Yield the holes at the borders of segments. The function `holes` finds only holes within a segment.

    A segment without a readable block is a hole. Each other hole lies next to a block that the read took: between two
    segments, before all items, or after all items. `taken`: the offsets of the blocks that the read took.
    """
    with_items = [one for one in segments if one.items]
    yield from _unreadable(with_items, blocks_of, reach)
    if not taken:
        yield from _first_hole(segments, _readable(with_items, blocks_of), blocks_of)
        if any(one.low is not None and one.low[0] <= reach.high for one in with_items[-1:]):
            yield from _last_hole(segments, _readable(reversed(with_items), blocks_of), blocks_of, reach)
    for earlier, later in _neighbours(with_items, blocks_of, taken):
        if earlier is None:
            yield from _first_hole(segments, later, blocks_of)
        elif later is None:
            yield from _last_hole(segments, earlier, blocks_of, reach)
        else:
            yield from _holes_between(segments, earlier, later, blocks_of)


def _holes_between(
    segments: Sequence[Segment], earlier: Segment, later: Segment, blocks_of: BlocksOf
) -> Iterator[Hole]:
    """The holes between the last block of a segment and the first one of another."""
    last, following = blocks_of(earlier).items_at(-1), blocks_of(later).items_at(0)
    assert last is not None, "the segment has blocks"
    assert following is not None, "the segment has blocks"
    first, end = (bisect_left(segments, one.number, key=_number) for one in (earlier, later))
    records_loss = _records_loss((*segments[first + 1 : end], later), following.head.first_seq, blocks_of)
    yield from _between(last, following, [one.end_seq for one in segments[first:end]], records_loss=records_loss)
    for lost_before in _losses(segments, earlier, later, blocks_of):
        # the last items before the loss may have times after the loss; the hole then begins when they were accepted
        yield _hole(min(last.head.high[0], earlier.last_accepted), lost_before, 0)


def _unreadable(with_items: Sequence[Segment], blocks_of: BlocksOf, reach: WindowReach) -> Iterator[Hole]:
    """Yield a hole for each segment within reach that has no readable block."""
    for one in with_items:
        if one.low is None or one.high is None or one.low[0] > reach.high or one.high[0] < reach.low:
            continue
        if blocks_of(one).items_at(0) is None:
            yield Hole(one.low[0], one.high[0], one.items)


def _first_hole(segments: Sequence[Segment], first_readable: Segment | None, blocks_of: BlocksOf) -> Iterator[Hole]:
    """The hole before all items. `first_readable`: the first segment with a readable block.

    If the archive has dropped the items before the hole, the hole has no known start.
    """
    if first_readable is not None and (first := blocks_of(first_readable).items_at(0)) is not None:
        missing, end = given_between(segments[0].first_seq, first.head.first_seq), first.head.low[0] - 1
        has_dropped = given_between(1, segments[0].first_seq) > 0
        if missing:
            yield Hole(end if has_dropped else MIN_INSTANT, end, missing)
        for lost_before in () if has_dropped else _losses(segments, None, first_readable, blocks_of):
            yield Hole(MIN_INSTANT, lost_before - 1, 0)


def _last_hole(
    segments: Sequence[Segment], last_readable: Segment | None, blocks_of: BlocksOf, reach: WindowReach
) -> Iterator[Hole]:
    """The hole between all archived items and the items in memory. `last_readable`: the last segment with a readable
    block.
    """
    if last_readable is not None and (last := blocks_of(last_readable).items_at(-1)) is not None:
        missing, end = given_between(last.head.end_seq, segments[-1].end_seq), last.head.high[0]
        border = None if reach.border == LAST_KEY[0] else reach.border
        if not missing and border is not None and border > end:
            end_seq, rest = segments[-1].end_seq, segments[bisect_right(segments, last_readable.number, key=_number) :]
            if begins_anew(last.head.end_seq, end_seq) and not _records_loss(rest, end_seq, blocks_of):
                yield _hole(min(end, last_readable.last_accepted), border + 1, 0)
        if missing and end <= reach.high:
            yield _hole(end, end if reach.border == LAST_KEY[0] else reach.border + 1, missing)


def _neighbours(
    with_items: Sequence[Segment], blocks_of: BlocksOf, taken: Mapping[Segment, Set[int]]
) -> Iterator[tuple[Segment | None, Segment | None]]:
    """Yield pairs of neighbours among the segments with readable blocks. None: there is no neighbour on this side.

    Yields a pair only if the read took the last block of the earlier segment, or the first block of the later one.
    Looks at no other segments, because they may be in an object store that is unreachable.
    """
    former: Segment | None = None  # the read took the last block of this segment
    for at, one in enumerate(with_items):
        if one not in taken:
            continue
        if _took(blocks_of(one), 0, taken[one]):
            before = _readable(reversed(with_items[:at]), blocks_of)
            if before is None or before is not former:
                yield before, one
        if _took(blocks_of(one), -1, taken[one]):
            former = one
            yield one, _readable(with_items[at + 1 :], blocks_of)


def _took(blocks: SegmentBlocks, at: int, offsets: Set[int]) -> bool:
    """Whether the read took the block of items at this position; 0: the first one, -1: the last one."""
    block = blocks.items_at(at)
    return block is not None and block.offset in offsets


def _readable(segments: Iterable[Segment], blocks_of: BlocksOf) -> Segment | None:
    """The first of the segments that has a readable block of items, or None."""
    return next((one for one in segments if blocks_of(one).items_at(0) is not None), None)


def _losses(segments: Sequence[Segment], earlier: Segment | None, later: Segment, blocks_of: BlocksOf) -> Iterator[int]:
    """Yield the instants before which a host was lost.

    The segment `later` records them, or a segment without items between `earlier` and `later`.
    """
    first = 0 if earlier is None else bisect_right(segments, earlier.number, key=_number)
    for one in segments[first : bisect_right(segments, later.number, key=_number)]:
        lost_before = blocks_of(one).lost_before if one is later or not one.items else None
        if lost_before is not None:
            yield lost_before


def _records_loss(segments: Iterable[Segment], first_seq: int, blocks_of: BlocksOf) -> bool:
    """Whether one of the segments records that a host was lost before the owner of the item `first_seq` began."""
    begin = begin_of(1, first_seq + 1)
    return any(one.begin == begin and blocks_of(one).records_loss for one in segments)


def _number(segment: Segment) -> int:
    return segment.number


def begins_anew(end_seq: int, first_seq: int) -> bool:
    """Whether an owner has begun at a seq above `end_seq` and at most `first_seq`, because the former owner was lost.

    The new owner records this loss in a segment. If no segment has the record, the segment with the record is lost.
    """
    return begin_of(end_seq, first_seq + 1) > end_seq


def _between(
    earlier: PlacedBlock, later: PlacedBlock, ends: Sequence[int] = (), *, records_loss: bool = False
) -> Iterator[Hole]:
    """The hole between two blocks. `ends`: the end seq of each segment from the one of `earlier` on, up to `later`.
    `records_loss`: a segment records the loss of the owner before the one of `later`.
    """
    before, after = earlier.head, later.head
    missing = given_over(before.end_seq, after.first_seq, ends)
    if missing:
        yield _hole(before.high[0], after.low[0], missing)
    elif not records_loss and begins_anew(before.end_seq, after.first_seq):
        yield _hole(min(before.high[0], before.last_accepted), after.first_accepted, 0)


def _hole(before: int, after: int, missing: int) -> Hole:
    """The hole of `missing` items between two times: the time of the item before it, and of the item after it."""
    start, end = sorted((before, after))
    return Hole(start + 1, end - 1, missing) if end - start > 1 else Hole(start, end, missing)
