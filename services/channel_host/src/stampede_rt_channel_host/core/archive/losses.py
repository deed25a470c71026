"""Finds the losses of owners that an archive shows, for subscriptions. Reads find them as holes. Pure."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

from stampede_rt.values.seq_starts import begin_of, given_between
from stampede_rt_channel_host.core.archive.holes import begins_anew
from stampede_rt_channel_host.core.archive.segment import Segment
from stampede_rt_channel_host.core.archive.segment_blocks import SegmentBlocks


class ArchivedLoss(NamedTuple):
    """An owner was lost with items that it had accepted before the instant `before`. The next owner began at the seq
    `begin`.
    """

    begin: int
    before: int


def losses_in(
    segments: Sequence[Segment], blocks_of: Callable[[Segment], SegmentBlocks], since: int
) -> list[ArchivedLoss]:
    """The losses that have an instant `before` after `since`, in the order of the seqs.

    Looks only at segments in which an owner began, and which have items that the host accepted after `since`.
    """
    found: dict[int, int | None] = {}
    for begin, before in _owners(segments, blocks_of, since):
        found.setdefault(begin, before)
    known = [ArchivedLoss(begin, before) for begin, before in found.items() if before is not None]
    return sorted(one for one in known if one.before > since)


def _owners(
    segments: Sequence[Segment], blocks_of: Callable[[Segment], SegmentBlocks], since: int
) -> Iterator[tuple[int, int | None]]:
    """The first seqs of owners, each with the instant of the loss before it; None: the former owner stopped cleanly."""
    end_seq = _end_before(segments)
    for segment in segments:
        has_begin = begin_of(end_seq, max(segment.end_seq, segment.begin + 1)) > end_seq
        if has_begin and (segment.last_accepted > since or not segment.items):
            blocks = blocks_of(segment)
            if blocks.records_loss:
                yield segment.begin, blocks.lost_before
            yield from _begins(blocks, end_seq)
        end_seq = segment.end_seq if segment.items else end_seq


def _end_before(segments: Sequence[Segment]) -> int:
    """The seq after the items that the archive had before its first segment; 1: it had none, as far as it shows."""
    first_seq = segments[0].first_seq if segments else 1
    return first_seq if given_between(1, first_seq) else 1


def _begins(blocks: SegmentBlocks, end_seq: int) -> Iterator[tuple[int, int]]:
    """The first seqs of the owners that began in these blocks, and the acceptance of the first item of each.

    `end_seq`: the seq after the items before these blocks; 1: there are none.
    """
    first = blocks.items_at(0)
    pairs = [(before.end_seq, after) for before, after in blocks.breaks()]
    if first is not None and end_seq > 1:  # no file shows a loss before the first item, unless it records the loss
        pairs.insert(0, (end_seq, first.head))
    for end, after in pairs:
        if begins_anew(end, after.first_seq):
            yield begin_of(end, after.first_seq + 1), after.first_accepted
