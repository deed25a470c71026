"""An archive as it was at an earlier instant: it has the items that the host had accepted by then. Pure.

A host accepts items in the order of their seqs. So the items of an instant are all items below one seq.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
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

    `last_blocks` are the blocks of the last segment if it was cut off; otherwise None. The head of a cut block
    describes only its first items. `next_items`: None if the archive has no later items. `advance` is the highest
    advance at that instant, and `next_advance` the time at which the host accepted a higher one; each may be None.
    `as_of` is the instant.
    """

    segments: tuple[Segment, ...]
    last_blocks: SegmentBlocks | None
    next_items: NextItems | None
    advance: int | None = None
    next_advance: int | None = None
    as_of: int = MIN_INSTANT

    @property
    def next_seq(self) -> int:
        """The seq after the last of these items."""
        return max((one.end_seq for one in self.segments), default=1)

    def blocks_of(self, whole: BlocksOf) -> BlocksOf:
        """The blocks of these segments. `whole` returns all blocks of a segment."""
        if self.last_blocks is None:
            return whole
        number, blocks = self.segments[-1].number, self.last_blocks
        return lambda segment: blocks if segment.number == number else whole(segment)


def past_of(
    segments: Sequence[Segment], blocks_of: BlocksOf, runs_of: RunsOf, advances_of: AdvancesOf, as_of: int
) -> PastArchive:
    """The archive as it was at the instant `as_of`. Reads at most two blocks of runs and one block of advances."""
    past, reached = PastArchive(tuple(segments), None, None), segments
    for at, segment in enumerate(segments):
        found = _first_after(segment, blocks_of(segment), runs_of, as_of) if segment.last_accepted > as_of else None
        if found is not None:
            past, reached = _cut(segments[:at], segment, *found, as_of), segments[: at + 1]
            break
    advance, next_advance = _advances(reached, blocks_of, advances_of, as_of)
    return past._replace(advance=advance, next_advance=next_advance, as_of=as_of)


def _first_after(
    segment: Segment, blocks: SegmentBlocks, runs_of: RunsOf, as_of: int
) -> tuple[SegmentBlocks, Sequence[ArchivedRun]] | None:
    """The blocks of a segment up to the first one with items that the host accepted after the instant, and the runs of
    this block; None: there is no such block.

    If a block is cut off because the next segment has its later items, only these may be later than the instant.
    """
    place = blocks.first_accepted_after(as_of)
    while place is not None:
        runs = runs_of(segment, blocks[place])
        if not runs or any(one.accepted > as_of for one in runs):
            return blocks.up_to(place + 1), runs
        place = next((at for at in range(place + 1, len(blocks)) if blocks[at].head.kind == ITEMS), None)
    return None


def _cut(
    before: Sequence[Segment], segment: Segment, blocks: SegmentBlocks, runs: Sequence[ArchivedRun], as_of: int
) -> PastArchive:
    """The archive up to the instant. The last of `blocks` has the first items that the host accepted after it. `runs`:
    the items of this block.
    """
    kept, last = blocks.up_to(len(blocks) - 1), blocks[-1]
    first, following = _part(last, runs, as_of)
    if first is not None:
        kept = kept.followed_by([first])
    short = summary(segment.number, segment.length, kept)
    # the archive lacks the items between the kept items and the next items, if there are any
    if short is not None:
        short = short._replace(first_seq=segment.first_seq, end_seq=max(short.end_seq, following.first_seq))
        return PastArchive((*before, short), kept, following)
    if before:
        before = [*before[:-1], before[-1]._replace(end_seq=max(before[-1].end_seq, following.first_seq))]
    return PastArchive(tuple(before), None, following)


def _part(block: PlacedBlock, runs: Sequence[ArchivedRun], as_of: int) -> tuple[PlacedBlock | None, NextItems]:
    """The part of the block with the items that were accepted by `as_of`, or None; and the items accepted next."""
    head: BlockHead = block.head
    if not runs:  # the block is damaged
        found = NextItems(head.last_accepted, head.first_seq, head.low[0], head.high[0])
        return (block if head.first_accepted <= as_of else None), found
    kept = [one.run for one in runs if one.accepted <= as_of]
    accepted = runs[len(kept)].accepted
    following = [one.run for one in runs[len(kept) :] if one.accepted == accepted]
    found = NextItems(accepted, following[0].first_seq, min(map(lowest, following))[0], max(map(highest, following))[0])
    if not kept:
        return None, found
    head = head._replace(
        items=sum(map(len, kept)),
        end_seq=kept[-1].first_seq + len(kept[-1]),
        low=min(map(lowest, kept)),
        high=max(map(highest, kept)),
        last_accepted=runs[len(kept) - 1].accepted,
    )
    return PlacedBlock(block.offset, head), found


def _advances(
    segments: Sequence[Segment], blocks_of: BlocksOf, advances_of: AdvancesOf, as_of: int
) -> tuple[int | None, int | None]:
    """The highest advance at that instant, and the time at which the host accepted the next one.

    A segment begins with the latest advance. So the last segment has no advance only if the channel had none.
    """
    following: int | None = None
    for segment in reversed(segments):
        blocks = blocks_of(segment).of_advances
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
    return moment


def _may_have_lost(past: PastArchive, lost_before: int, clock: int) -> bool:
    """Whether the host may have lost an item that it accepted by `clock`.

    It may if it had lost items by then, or if it accepted items before `clock` and lost them later.
    """
    following = [past.next_advance] if past.next_items is None else [past.next_items.accepted, past.next_advance]
    known = min((one for one in following if one is not None), default=None)
    return lost_before <= clock or known is None or known >= lost_before


def read_nothing(moment: ChannelSnapshot, query: Query, within: ResolvedInterval | None) -> Pieces[ReadAnswer]:
    """The answer of a channel that had no item yet."""
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
    """How many items the archive lacks before the next items, if it has no item of that instant."""
    if not segments:
        return 0
    next_seq = past.next_seq if past.next_items is None else past.next_items.first_seq
    return given_between(segments[0].first_seq, next_seq)
