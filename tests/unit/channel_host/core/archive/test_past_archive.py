"""The past of an archive in which a segment of a former owner has items that the next owner has written, too."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from stampede_rt_channel_host.core.archive import (
    ArchivedRun,
    PlacedBlock,
    Segment,
    SegmentBlocks,
    encode_items,
    past_of,
    summary,
)
from stampede_rt_channel_host.core.archive.stored_segment import below
from stampede_rt_channel_host.core.channel import make_run


def run(seq: int) -> ArchivedRun:
    """An item that was accepted at the instant 10 * seq."""
    return ArchivedRun(10 * seq, make_run(seq, [seq], None, [1], b"%d" % seq))


@pytest.mark.parametrize("known", range(9))
def test_each_instant_has_the_items_that_were_accepted_by_then(known: int) -> None:
    former, own = [run(seq) for seq in range(1, 7)], [run(seq) for seq in range(4, 9)]
    blocks = {}
    segments: list[Segment] = []
    for number, runs, end in ((1, former, 4), (2, own, 9)):
        placed = [PlacedBlock(0, encode_items(runs)[0])]
        cut = SegmentBlocks(below(placed, placed[-1].end, end))
        blocks[number] = cut
        found = summary(number, placed[-1].end, cut)
        assert found is not None
        segments.append(found)

    def runs_of(segment: Segment, block: PlacedBlock) -> Sequence[ArchivedRun]:
        kept = former if segment.number == 1 else own
        return [one for one in kept if one.run.first_seq < block.head.end_seq]

    past = past_of(segments, lambda one: blocks[one.number], runs_of, lambda *_: (), 10 * known + 5)
    assert sum(one.items for one in past.segments) == known
    following = None if past.next_items is None else past.next_items.accepted
    assert following == (None if known == 8 else 10 * (known + 1))
