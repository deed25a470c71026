"""An archive as it was at an earlier instant: it has the items that the host had accepted by then. Pure.

A host accepts items in the order of their seqs. So the items of an instant are all items below one seq.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

from stampede_rt.values.model import Policy, Reason
from stampede_rt.values.timeline import ResolvedInterval, format_instant
from stampede_rt_channel_host.core.archive.block import ITEMS, ArchivedRun, BlockHead, highest, lowest
from stampede_rt_channel_host.core.archive.recorded_items import ArchiveSpan
from stampede_rt_channel_host.core.archive.segment import PlacedBlock, Segment, summary
from stampede_rt_channel_host.core.archive.window import BlocksOf
from stampede_rt_channel_host.core.channel.channel import ChannelCore
from stampede_rt_channel_host.core.channel.channel_snapshot import ChannelSnapshot
from stampede_rt_channel_host.core.channel.pieces import Pieces
from stampede_rt_channel_host.core.channel.reading import Reading
from stampede_rt_channel_host.core.channel.values import Query, ReadAnswer

RunsOf = Callable[[Segment, PlacedBlock], Sequence[ArchivedRun]]
"""Returns the runs of a block; none if the block is damaged."""


class Past(NamedTuple):
    """The segments of an archive as far as the host had accepted their items by an instant.

    `last_blocks` are the blocks of the last segment if it was cut off, else None. The head of a block that was cut off
    tells its first items only. `next_accepted`: when the next item of the archive was accepted; None: there is none.
    """

    segments: tuple[Segment, ...]
    last_blocks: Sequence[PlacedBlock] | None
    next_accepted: int | None

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


def past_of(segments: Sequence[Segment], blocks_of: BlocksOf, runs_of: RunsOf, as_of: int) -> Past:
    """The archive as it was at the instant `as_of`. Asks for the runs of one block at most."""
    for at, segment in enumerate(segments):
        blocks = blocks_of(segment) if segment.last_accepted > as_of else ()
        later = (place for place, one in enumerate(blocks) if one.head.kind == ITEMS and one.head.last_accepted > as_of)
        place = next(later, None)
        if place is None:
            continue
        first, accepted = _cut(blocks[place], runs_of(segment, blocks[place]), as_of)
        kept = [*blocks[:place], *([first] if first else [])]
        cut = summary(segment.number, segment.length, kept)
        if cut is None:
            return Past(tuple(segments[:at]), None, accepted)
        return Past((*segments[:at], cut), kept, accepted)
    return Past(tuple(segments), None, None)


def _cut(block: PlacedBlock, runs: Sequence[ArchivedRun], as_of: int) -> tuple[PlacedBlock | None, int]:
    """The block with the items that were accepted by `as_of`, or None, and when the next ones were accepted."""
    count = next((at for at, one in enumerate(runs) if one.accepted > as_of), 0)
    if not runs:  # the block is damaged
        whole = block.head.first_accepted <= as_of
        return (block if whole else None), block.head.last_accepted
    kept = [one.run for one in runs[:count]]
    if not kept:
        return None, runs[0].accepted
    head: BlockHead = block.head._replace(
        items=sum(map(len, kept)),
        end_seq=kept[-1].first_seq + len(kept[-1]),
        low=min(map(lowest, kept)),
        high=max(map(highest, kept)),
        last_accepted=runs[count - 1].accepted,
    )
    return PlacedBlock(block.offset, head), runs[count].accepted


class PastFacts(NamedTuple):
    """The facts about a channel at an earlier instant that reads need beside its items.

    `advance` was the highest instant of an advance. `lost_before` and `lost_from`: see `Reading`.
    """

    policy: Policy
    incarnation: int
    advance: int | None
    lost_before: int | None
    lost_from: int | None


def past_moment(facts: PastFacts, past: Past, span: ArchiveSpan, clock: int) -> ChannelSnapshot:
    """The channel as it was at `clock`, with no item in memory, because the archive has all. `span`: of `past`."""
    channel = ChannelCore(facts.policy, incarnation=facts.incarnation)
    channel.restore((), after=span.newest, next_seq=past.next_seq, lost_from=None)
    moment = channel.snapshot(clock)
    moment.advanced_to = facts.advance
    if facts.lost_before is not None and facts.lost_before <= clock:
        moment.lost_before, moment.lost_from = facts.lost_before, facts.lost_from
    return moment


def read_nothing(moment: ChannelSnapshot, query: Query, within: ResolvedInterval | None) -> Pieces[ReadAnswer]:
    """The answer of a channel that had no item yet."""
    held, retention = moment.look(moment.clock)
    reading = Reading(held, retention, moment.incarnation, moment.lost_before)
    reading.lost_from, reading.advance = moment.lost_from, moment.advanced_to
    return (yield from reading.answer(query, within, moment.clock))


def nothing_left(within: ResolvedInterval | None, as_of: int, incarnation: int) -> ReadAnswer:
    """The answer if the archive has dropped all items that the host had accepted by `as_of`."""
    detail = f"the archive has dropped the items that the host had accepted by {format_instant(as_of)}"
    return ReadAnswer(
        slices=(), next_time=None, interval=within, complete=False, truncated=True, more=False,
        reason=Reason("COLLECTED", detail), incarnation=incarnation,
    )  # fmt: skip
