"""An archive as it was at an earlier instant: it has the items that the host had accepted by then. Pure.

A host accepts items in the order of their seqs. So the items of an instant are all items below one seq.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

from stampede_rt.values.model import Policy, Reason
from stampede_rt.values.seq_starts import given_between
from stampede_rt.values.timeline import MIN_INSTANT, ResolvedInterval, format_instant
from stampede_rt_channel_host.core.archive.block import (
    ITEMS,
    ArchivedAdvance,
    ArchivedRun,
    BlockHead,
    highest,
    lowest,
)
from stampede_rt_channel_host.core.archive.holes import begins_anew
from stampede_rt_channel_host.core.archive.recorded_items import ArchiveSpan
from stampede_rt_channel_host.core.archive.segment import PlacedBlock, Segment, summary
from stampede_rt_channel_host.core.archive.segment_blocks import SegmentBlocks
from stampede_rt_channel_host.core.archive.window import BlocksOf
from stampede_rt_channel_host.core.channel.channel import ChannelCore
from stampede_rt_channel_host.core.channel.channel_snapshot import ChannelSnapshot
from stampede_rt_channel_host.core.channel.pieces import Pieces
from stampede_rt_channel_host.core.channel.reading import QueryReader
from stampede_rt_channel_host.core.channel.values import Query, ReadAnswer

RunsOf = Callable[[Segment, PlacedBlock], Sequence[ArchivedRun]]
"""Returns the runs of a block; none if the block is damaged."""


AdvancesOf = Callable[[Segment, PlacedBlock], Sequence[ArchivedAdvance]]
"""Returns the advances of a block; none if the block is damaged."""


class NextItems(NamedTuple):
    """The items that the host accepted next, at one instant: their first seq, and their least and greatest time."""

    accepted: int
    first_seq: int
    start: int
    end: int


class PastArchive(NamedTuple):
    """An archive's segments with only the items that the host had accepted by an instant.

    `changed` has, by the number of the segment, the blocks of each segment that was cut off, or that lacks items of its
    last block. The head of a cut block describes only its first items. `next_items`: None if the archive has no later
    items. `advance` is the highest advance at that instant, and `next_advance` the time at which the host accepted a
    higher one; each may be None. `as_of` is the instant. `lost_before`: a former owner had accepted items after these,
    and was lost with them before this instant; None: the archive reports no such loss.
    """

    segments: tuple[Segment, ...]
    changed: Mapping[int, SegmentBlocks]
    next_items: NextItems | None
    advance: int | None = None
    next_advance: int | None = None
    as_of: int = MIN_INSTANT
    lost_before: int | None = None

    @property
    def next_seq(self) -> int:
        """The seq after the last of these items."""
        return max((one.end_seq for one in self.segments), default=1)

    def blocks_of(self, whole: BlocksOf) -> BlocksOf:
        """The blocks of these segments. `whole` returns all blocks of a segment."""
        changed = self.changed
        return lambda segment: changed[segment.number] if segment.number in changed else whole(segment)


def past_of(
    segments: Sequence[Segment], blocks_of: BlocksOf, runs_of: RunsOf, advances_of: AdvancesOf, as_of: int
) -> PastArchive:
    """The archive as it was at the instant `as_of`. Reads two blocks of runs and one block of advances.

    Some segments end with a block whose later items are also in the next segment. Reads these blocks, too.
    """
    before, changed, reached = list[Segment](), dict[int, SegmentBlocks](), segments
    past: PastArchive | None = None
    lost_before: int | None = None  # a loss after the items of `before`
    for at, segment in enumerate(segments):
        if segment.last_accepted > as_of:
            all_blocks = blocks_of(segment)
            blocks, runs = _first_after(segment, all_blocks, runs_of, as_of)
            if runs is not None:
                past, reached = _cut(before, segment, blocks, runs, as_of, lost_before), segments[: at + 1]
                break
            if blocks is not all_blocks:
                segment, changed[segment.number] = _with_blocks(segment, blocks), blocks
        before.append(segment)
        lost_before = None if segment.items else lost_before or blocks_of(segment).lost_before
    past = past or PastArchive(tuple(before), {}, None)
    advance, next_advance = _advances(reached, blocks_of, advances_of, as_of)
    changed.update(past.changed)
    return past._replace(changed=changed, advance=advance, next_advance=next_advance, as_of=as_of)


def _first_after(
    segment: Segment, blocks: SegmentBlocks, runs_of: RunsOf, as_of: int
) -> tuple[SegmentBlocks, Sequence[ArchivedRun] | None]:
    """The blocks of a segment up to the first one with items that the host accepted after the instant, and the runs of
    this block. If there is no such block: all blocks, and None.

    If a block is cut off because the next segment has its later items, only these may be later than the instant. The
    next segment may be without them at that instant. So the head of such a block gets the bounds of its own items.
    """
    place = blocks.first_accepted_after(as_of)
    while place is not None:
        runs = runs_of(segment, blocks[place])
        if not runs or any(one.accepted > as_of for one in runs):
            return blocks.up_to(place + 1), runs
        short = _shortened(blocks[place], runs)
        blocks = blocks.up_to(place).followed_by([short, *blocks[place + 1 :]])
        place = next((at for at in range(place + 1, len(blocks)) if blocks[at].head.kind == ITEMS), None)
    return blocks, None


def _with_blocks(segment: Segment, blocks: SegmentBlocks) -> Segment:
    """The segment with the bounds of these blocks, and its own seqs."""
    found = summary(segment.number, segment.length, blocks)
    assert found is not None, "the blocks have items"
    return found._replace(first_seq=segment.first_seq, end_seq=segment.end_seq)


def _shortened(block: PlacedBlock, kept: Sequence[ArchivedRun]) -> PlacedBlock:
    """The block with a head that describes only the runs `kept`, its first ones."""
    head = block.head._replace(
        items=sum(len(one.run) for one in kept),
        end_seq=kept[-1].run.first_seq + len(kept[-1].run),
        low=min(lowest(one.run) for one in kept),
        high=max(highest(one.run) for one in kept),
        last_accepted=max(one.accepted for one in kept),
    )
    return PlacedBlock(block.offset, head)


def _cut(
    before: Sequence[Segment], segment: Segment, blocks: SegmentBlocks, runs: Sequence[ArchivedRun], as_of: int,
    lost_before: int | None,
) -> PastArchive:  # fmt: skip
    """The archive up to the instant. The last of `blocks` has the first items that the host accepted after it. `runs`:
    the items of this block. `lost_before`: the instant of a loss between `before` and the segment, or None.
    """
    kept, last = blocks.up_to(len(blocks) - 1), blocks[-1]
    first, following = _part(last, runs, as_of)
    if first is not None:
        kept = kept.followed_by([first])
    short = summary(segment.number, segment.length, kept)
    lost_before = None if short is not None and short.items else lost_before or blocks.lost_before
    former = None if short is not None and short.items else next((one for one in reversed(before) if one.items), None)
    if former is not None and lost_before is None and not blocks.records_loss:
        lost_before = following.accepted if begins_anew(former.end_seq, following.first_seq) else None
    # the archive lacks the items between the kept items and the next items, if there are any
    if short is not None:
        short = short._replace(first_seq=segment.first_seq, end_seq=max(short.end_seq, following.first_seq))
        return PastArchive((*before, short), {segment.number: kept}, following, lost_before=lost_before)
    if before:
        before = [*before[:-1], before[-1]._replace(end_seq=max(before[-1].end_seq, following.first_seq))]
    return PastArchive(tuple(before), {}, following, lost_before=lost_before)


def _part(block: PlacedBlock, runs: Sequence[ArchivedRun], as_of: int) -> tuple[PlacedBlock | None, NextItems]:
    """The part of the block with the items that were accepted by `as_of`, or None; and the items accepted next."""
    head: BlockHead = block.head
    if not runs:  # the block is damaged
        found = NextItems(head.last_accepted, head.first_seq, head.low[0], head.high[0])
        return (block if head.first_accepted <= as_of else None), found
    kept = [one for one in runs if one.accepted <= as_of]
    accepted = runs[len(kept)].accepted
    following = [one.run for one in runs[len(kept) :] if one.accepted == accepted]
    found = NextItems(accepted, following[0].first_seq, min(map(lowest, following))[0], max(map(highest, following))[0])
    return (_shortened(block, kept) if kept else None), found


def _advances(
    segments: Sequence[Segment], blocks_of: BlocksOf, advances_of: AdvancesOf, as_of: int
) -> tuple[int | None, int | None]:
    """The highest advance at that instant, and the time at which the host accepted the next one.

    A segment begins with the latest advance. So the last segment has no advance only if the channel had none.
    """
    following: int | None = None
    for segment in reversed(segments):
        blocks = blocks_of(segment).advance_blocks
        count = sum(one.head.first_accepted <= as_of for one in blocks)
        if count < len(blocks):
            following = blocks[count].head.first_accepted
        if count:
            rows = advances_of(segment, blocks[count - 1])
            known = max((one.instant for one in rows if one.accepted <= as_of), default=None)
            return known, next((one.accepted for one in rows if one.accepted > as_of), following)
        if not blocks:
            break
    return None, following


class PastFacts(NamedTuple):
    """The facts about a channel at an earlier instant that reads need in addition to its items.

    `advance` was the highest instant of an advance. `lost_before` and `lost_from`: see `QueryReader`.
    """

    policy: Policy
    incarnation: int
    advance: int | None
    lost_before: int | None
    lost_from: int | None


def past_moment(facts: PastFacts, past: PastArchive, span: ArchiveSpan, clock: int) -> ChannelSnapshot:
    """The channel as it was at `clock`, without items in memory, because the archive has all of them.

    `span`: the span of the archive `past`.
    """
    channel = ChannelCore(facts.policy, incarnation=facts.incarnation)
    channel.restore((), after=span.newest, next_seq=past.next_seq, loss=(None, None))
    moment = channel.snapshot(clock)
    moment.advanced_to = facts.advance
    if facts.lost_before is not None and _may_have_lost(past, facts.lost_before, clock):
        moment.lost_before, moment.lost_from = facts.lost_before, facts.lost_from
    if past.lost_before is not None:  # an earlier loss than the latest one
        moment.lost_before, moment.lost_from = past.lost_before, _lost_since(past.segments)
    return moment


def _lost_since(segments: Sequence[Segment]) -> int | None:
    """The earliest time that a lost item after these segments may have, unless it came late; None: any time."""
    highs = [one.high[0] for one in segments if one.high is not None]
    return min(max(highs), max(one.last_accepted for one in segments)) if highs else None


def _may_have_lost(past: PastArchive, lost_before: int, clock: int) -> bool:
    """Whether the host may have lost an item that it accepted by `clock`.

    It may if it had lost items by then, or if it accepted items before `clock` and lost them later.
    """
    following = [past.next_advance] if past.next_items is None else [past.next_items.accepted, past.next_advance]
    known = min((one for one in following if one is not None), default=None)
    return lost_before <= clock or known is None or known >= lost_before


def read_nothing(moment: ChannelSnapshot, query: Query, within: ResolvedInterval | None) -> Pieces[ReadAnswer]:
    """Answer a query about a channel that had no item at the instant of the query."""
    held, retention = moment.look(moment.clock)
    reading = QueryReader(held, retention, moment.incarnation, moment.lost_before)
    reading.lost_from, reading.advance = moment.lost_from, moment.advanced_to
    return (yield from reading.answer(query, within, moment.clock))


def nothing_left(
    segments: Sequence[Segment], past: PastArchive, within: ResolvedInterval | None, as_of: int, incarnation: int
) -> ReadAnswer:
    """The answer if the archive, which has the `segments`, has dropped or lost all items that the host had accepted by
    `as_of`.
    """
    lost_items = _count_missing_first(segments, past)
    what, name = (f"lacks {lost_items} of", "LOST") if lost_items else ("has dropped", "COLLECTED")
    detail = f"the archive {what} the items that the host had accepted by {format_instant(as_of)}"
    return ReadAnswer(
        slices=(), next_time=None, interval=within, complete=False, truncated=True, more=False,
        reason=Reason(name, detail), incarnation=incarnation,
    )  # fmt: skip


def is_nothing_left(segments: Sequence[Segment], past: PastArchive, *, has_dropped: bool) -> bool:
    """Whether the archive, which has the `segments`, has dropped or lost all items of that instant.

    `has_dropped`: it has dropped items (`ArchiveSpan.has_dropped`).
    """
    has_items = any(one.items for one in past.segments)
    return not has_items and (has_dropped or _count_missing_first(segments, past) > 0)


def _count_missing_first(segments: Sequence[Segment], past: PastArchive) -> int:
    """The number of items that the archive lacks before the next items, if it has no item of that instant."""
    if not segments:
        return 0
    next_seq = past.next_seq if past.next_items is None else past.next_items.first_seq
    return given_between(segments[0].first_seq, next_seq)
