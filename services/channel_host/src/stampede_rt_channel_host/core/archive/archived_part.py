"""Reads the items of a subscription that have left memory from an archive, part by part, in the order of seqs. Pure."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise, takewhile
from typing import NamedTuple

from stampede_rt.values.model import Reason
from stampede_rt.values.seq_starts import given_between
from stampede_rt_channel_host.core.archive.segment import PlacedBlock, Segment
from stampede_rt_channel_host.core.archive.window import BlocksOf, choose_by_seq
from stampede_rt_channel_host.core.channel.index import ChannelIndex
from stampede_rt_channel_host.core.channel.item_keys import FIRST_KEY, ItemKey
from stampede_rt_channel_host.core.channel.owed_ranges import Range
from stampede_rt_channel_host.core.channel.run import Run, Slice
from stampede_rt_channel_host.core.channel.subscribing import AllCursor
from stampede_rt_channel_host.core.channel.values import DeliveredSlice, Gap, SubscriptionBatch

REMOVED = Reason("COLLECTED", "the limits of the channel or of its archive have removed the items")
LACKED = Reason(
    "LOST",
    "the archive lacks the items: max_bytes collected them before they were archived, or their block or file "
    "is damaged or removed",
)
STRADDLING_MAX = 16
"""A part loads at most this many blocks of other seqs, whose items have times between the times of the part."""


class ChosenPart(NamedTuple):
    """The blocks to load for the next part of a subscription.

    `blocks` have the items of the next seqs, up to `end_seq`, exclusive. `among` are blocks of other seqs: their items
    have times between the times of `blocks`, so they end spans there. `following`: the time of the first bucket after
    all these blocks, or None. `ends`: the end seqs of segments after which an owner began at a higher seq.
    """

    blocks: Sequence[tuple[Segment, PlacedBlock]]
    among: Sequence[tuple[Segment, PlacedBlock]]
    end_seq: int
    following: int | None
    ends: Sequence[int]


class ArchivedPart(NamedTuple):
    """The loaded items of a `ChosenPart`: those of the next seqs, and those with times between them."""

    items: ChannelIndex
    end_seq: int
    following: int | None
    ends: Sequence[int] = ()


def choose_part(segments: Sequence[Segment], blocks_of: BlocksOf, missing: Range, bytes_max: int) -> ChosenPart:
    """Choose blocks of about `bytes_max` for the first of the seqs `missing`."""
    blocks = choose_by_seq(segments, blocks_of, missing[0], bytes_max)
    blocks = [one for one in blocks if one[1].head.first_seq < missing[1]]
    ends = [before.end_seq for before, after in pairwise(segments) if after.begin > before.end_seq]
    if not blocks:
        return ChosenPart((), (), missing[1], None, ends)
    first = min(block.head.low for _, block in blocks)
    last = max(block.head.high for _, block in blocks)
    among, following = _among(segments, blocks_of, first, last)
    taken = {(segment.number, block.offset) for segment, block in blocks}
    among = [(segment, block) for segment, block in among if (segment.number, block.offset) not in taken]
    end_seq = min(missing[1], max(block.head.end_seq for _, block in blocks))
    return ChosenPart(blocks, among[:STRADDLING_MAX], end_seq, following, ends)


def _among(
    segments: Sequence[Segment], blocks_of: BlocksOf, first: ItemKey, last: ItemKey
) -> tuple[list[tuple[Segment, PlacedBlock]], int | None]:
    """The blocks with keys between two keys, and the time of the first block after the later key."""
    among: list[tuple[Segment, PlacedBlock]] = []
    later: list[int] = []
    for segment in segments:
        if segment.high is None or segment.low is None or segment.high <= first:
            continue
        if segment.low[0] > last[0]:
            later.append(segment.low[0])
            continue
        blocks = blocks_of(segment)
        for block in takewhile(lambda one: one.head.low[0] <= last[0], blocks.up(first)):
            if block.head.high > first:
                among.append((segment, block))
        start = blocks.first_start_after(last[0])
        later += [] if start is None else [start]
    return among, min(later, default=None)


def part_of(runs: Iterable[Run], chosen: ChosenPart) -> ArchivedPart:
    """The loaded part. `runs` are the runs of all its blocks."""
    items = ChannelIndex()
    for run in sorted(runs, key=lambda one: one.first_seq):
        items.insert(run)
    return ArchivedPart(items, chosen.end_seq, chosen.following, chosen.ends)


def deliver(
    cursor: AllCursor,
    missing: Range,
    part: ArchivedPart,
    next_held: Callable[[int], int | None],
    kept_from: int,
    limit_bytes: int,
) -> SubscriptionBatch:
    """Take the next items of a subscription from a part, and move the cursor.

    `missing` are the first seqs that the cursor wants and memory does not have. `next_held` returns the next time of an
    item in memory. `kept_from` is the first seq of the archive's segments.
    """
    first, end = missing[0], min(missing[1], part.end_seq)
    slices: list[DeliveredSlice] = []
    for piece in part.items.slices_by_seq(first, end, FIRST_KEY):
        if piece.first_seq > first or limit_bytes <= 0:
            break
        first = piece.end_seq
        wanted = _belonging(piece, cursor)
        if wanted is not None:
            wanted = wanted.within(limit_bytes)
            slices.append(DeliveredSlice(wanted, next_time_of(part, next_held, wanted.last_time)))
            limit_bytes -= wanted.charge_bytes
            cursor.delivered += wanted.items
            first = wanted.end_seq
    if first > missing[0]:
        cursor.mark_done(first)
        return SubscriptionBatch(slices=slices, more=not slices)
    found = next(part.items.slices_by_seq(first, end, FIRST_KEY), None)
    return _gap(cursor, first, end if found is None else found.first_seq, kept_from, part.ends)


def lacked(cursor: AllCursor, missing: Range) -> SubscriptionBatch:
    """The gap of seqs that neither memory nor the archive has. Moves the cursor."""
    return _gap(cursor, *missing, missing[0], ())


def _gap(cursor: AllCursor, first: int, end: int, kept_from: int, ends: Sequence[int]) -> SubscriptionBatch:
    """The gap of seqs that the archive does not have. A later call gives the part from `kept_from` on."""
    end = next((one for one in ends if first < one < end), end)
    reason = REMOVED if first < kept_from else LACKED
    end = min(end, kept_from) if first < kept_from else end
    cursor.mark_done(end)
    missing_items = given_between(first, end)
    if not missing_items:  # an owner has begun here without the seqs of the former owners
        return SubscriptionBatch(more=True)
    cursor.dropped += missing_items
    return SubscriptionBatch(
        gap=Gap(first_seq=end - missing_items, last_seq=end - 1, items=missing_items, reason=reason), more=True
    )


def _belonging(piece: Slice, cursor: AllCursor) -> Slice | None:
    """The items of a slice that belong to the subscription, or None. The earliest items may not belong to it."""
    lo = piece.lo
    while lo < piece.hi and not cursor.belongs(piece.run.times[lo], piece.run.first_seq + lo):
        lo += 1
    return Slice(piece.run, lo, piece.hi) if lo < piece.hi else None


def next_time_of(part: ArchivedPart, next_held: Callable[[int], int | None], time: int) -> int | None:
    """The time of the next bucket after `time` in a part or in memory, or None."""
    found = (part.items.next_time(time), part.following, next_held(time))
    return min((one for one in found if one is not None and one > time), default=None)
