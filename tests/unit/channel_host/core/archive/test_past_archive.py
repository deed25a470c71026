"""The past of an archive in which a segment of a former owner has items that the next owner has written, too."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from stampede_rt.values.model import Policy
from stampede_rt_channel_host.core.archive import (
    ArchivedRun,
    PastFacts,
    PlacedBlock,
    Segment,
    SegmentBlocks,
    encode_gap,
    encode_items,
    past_moment,
    past_of,
    span_of,
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


def placed(number: int, runs: Sequence[ArchivedRun], end_seq: int) -> tuple[Segment, SegmentBlocks]:
    """A segment with these runs in one block, without their items from `end_seq` on."""
    blocks = [PlacedBlock(0, encode_items(runs)[0])]
    cut = SegmentBlocks(below(blocks, blocks[-1].end, end_seq))
    segment = summary(number, blocks[-1].end, cut)
    assert segment is not None
    return segment, cut


def test_a_cut_block_has_the_bounds_of_its_own_items_if_the_next_segment_came_later() -> None:
    """In an earlier version, reads as of an instant before the next segment missed the items before the last one."""
    former = [accepted(1, 50), accepted(2, 40), accepted(3, 60)]
    own = [accepted(3, 60), accepted(4, 70)]
    (first, cut), (second, rest) = placed(1, former, 3), placed(2, own, 5)
    blocks, runs = {1: cut, 2: rest}, {1: former[:2], 2: own}
    past = past_of(
        (first, second), lambda one: blocks[one.number], lambda one, _: runs[one.number], lambda *_: (), as_of=25
    )
    (found,) = past.segments
    (block,) = past.blocks_of(lambda one: blocks[one.number])(found)
    assert (found.low, found.high, found.end_seq) == ((40, 2), (50, 1), 3)
    assert (block.head.low, block.head.high, block.head.items) == ((40, 2), (50, 1), 2)


def accepted(seq: int, time: int) -> ArchivedRun:
    """An item with this time that was accepted at the instant 10 * seq."""
    return ArchivedRun(10 * seq, make_run(seq, [time], None, [1], b"%d" % seq))


@pytest.mark.parametrize("alone", [False, True])
@pytest.mark.parametrize(("as_of", "lost_before"), [(15, 200), (205, None)])
def test_a_loss_after_the_items_of_an_instant_is_the_loss_that_the_next_segment_reports(
    as_of: int, lost_before: int | None, alone: bool
) -> None:
    """In an earlier version, a read as of an instant before two losses of hosts did not say that items were lost.

    `alone`: the note of the loss is in a segment without items, because a later owner has written them again.
    """
    gap, _ = encode_gap(2, 2, (1, 1), 200)
    note, own = [PlacedBlock(0, gap)], [PlacedBlock(gap.length, encode_items([run(20), run(21)])[0])]
    blocks = {1: placed(1, [run(1)], 2)[1], 2: SegmentBlocks(note), 3: SegmentBlocks(own)}
    if not alone:
        blocks = {1: blocks[1], 2: SegmentBlocks([*note, *own])}
    segments = [summary(number, 500, one) for number, one in blocks.items()]
    all_segments = [one for one in segments if one is not None]

    def runs_of(segment: Segment, _: PlacedBlock) -> Sequence[ArchivedRun]:
        return [run(1)] if segment.number == 1 else [run(20), run(21)]

    past = past_of(all_segments, lambda one: blocks[one.number], runs_of, lambda *_: (), as_of)
    assert past.lost_before == lost_before
    facts = PastFacts(Policy(), 7, None, 500, 300)
    moment = past_moment(facts, past, span_of(past.segments), as_of)
    assert (moment.lost_before, moment.lost_from) == ((200, 1) if lost_before else (None, None))
