"""Items that an archive lacks, next to items that a read takes. Pure."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from itertools import pairwise
from typing import NamedTuple

from stampede_rt.values.timeline import MIN_INSTANT
from stampede_rt_channel_host.core.archive.segment import PlacedBlock, Segment
from stampede_rt_channel_host.core.archive.segment_blocks import SegmentBlocks
from stampede_rt_channel_host.core.archive.seq_starts import given_between


class Hole(NamedTuple):
    """A hole: items that an archive lacks. Their times lie between `start` and `end`, unless they came late."""

    start: int
    end: int
    items: int


def holes(blocks: SegmentBlocks, taken: Set[int]) -> Iterator[Hole]:
    """The holes next to the blocks that a read took: items that were never archived, or whose block has a damaged head.

    `taken`: the offsets of these blocks.
    """
    positions = {blocks.position(offset) for offset in taken}
    for at in sorted(positions | {at - 1 for at in positions if at}):
        before, after = blocks.items_at(at), blocks.items_at(at + 1)
        if before is not None and after is not None:
            yield from _between(before, after)


def border_holes(
    segments: Sequence[Segment],
    blocks_of: Callable[[Segment], SegmentBlocks],
    taken: Mapping[Segment, Set[int]],
) -> Iterator[Hole]:
    """The holes between two segments, next to the blocks that a read took. `taken`: the offsets of these blocks.

    Includes the hole before all items, if the very first block of the archive is damaged.
    """
    first = segments[0] if segments else None
    if first is not None and first.lacks and first.first_seq == 1 and first.low is not None:
        yield Hole(MIN_INSTANT, first.low[0] - 1, first.lacks)
    for earlier, later in pairwise(one for one in segments if one.items):
        last = blocks_of(earlier).items_at(-1) if earlier in taken else None
        next_one = blocks_of(later).items_at(0) if later in taken else None
        if last is not None and last.offset in taken[earlier]:
            next_one = next_one or blocks_of(later).items_at(0)
        elif next_one is not None and next_one.offset in taken[later]:
            last = last or blocks_of(earlier).items_at(-1)
        else:
            continue
        if next_one is not None and last is not None:
            yield from _between(last, next_one)


def _between(earlier: PlacedBlock, later: PlacedBlock) -> Iterator[Hole]:
    before, after = earlier.head, later.head
    lacks = given_between(before.end_seq, after.first_seq)
    if lacks:
        start, end = sorted((before.high[0], after.low[0]))
        inner = (start + 1, end - 1) if end - start > 1 else (start, end)
        yield Hole(*inner, lacks)
