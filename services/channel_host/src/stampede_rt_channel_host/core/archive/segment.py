"""Finds the blocks of a segment, even after a crash or damage. Pure."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

from stampede_rt.values.seq_starts import begin_of
from stampede_rt_channel_host.core.archive.block import (
    ADVANCES,
    GAP,
    HEAD_BYTES,
    ITEMS,
    MAGIC,
    OPENING,
    BlockHead,
    decode_head,
    is_whole,
)
from stampede_rt_channel_host.core.channel.item_keys import ItemKey

ReadAt = Callable[[int, int], bytes]
"""Reads a file: takes an offset and a number of bytes. Returns the bytes, fewer at the end of the file."""

_SEARCH_BYTES = 2**20  # bytes of one read in the search for the next block after a damaged one


class PlacedBlock(NamedTuple):
    """A block, and the offset at which it begins."""

    offset: int
    head: BlockHead

    @property
    def end(self) -> int:
        """The offset after the block."""
        return self.offset + self.head.length


class SegmentScan(NamedTuple):
    """The blocks of a segment. `end` is the offset after its last whole block: the bytes after it are a torn tail.

    If nothing can be torn, `end` is the end of the file. `damaged` are the ranges of bytes in which no block could
    be found, and the blocks whose content is damaged.
    """

    blocks: Sequence[PlacedBlock]
    end: int
    damaged: Sequence[tuple[int, int]]


class Segment(NamedTuple):
    """The summary of a segment: its number and length, its seqs and keys, and when its items were accepted.

    `low` and `high` are None if it has no items. Its blocks lack some of its seqs if a head is damaged, or if a damaged
    segment was before it.
    """

    number: int
    length: int
    items: int
    first_seq: int
    end_seq: int
    low: ItemKey | None
    high: ItemKey | None
    last_accepted: int

    @property
    def begin(self) -> int:
        """The first seq of its owner in this segment.

        If a former owner was lost, `first_seq` is the seq after the items that this owner found in the archive.
        """
        return begin_of(self.first_seq, self.end_seq)


def scan(
    read_at: ReadAt, length: int, *, check_contents: bool, begin: int = 0, may_be_torn: bool = True
) -> SegmentScan:
    """All blocks of a segment of `length` bytes, or the blocks from the offset `begin` on.

    A block that reaches beyond the end is a torn tail. If a head is damaged, the scan searches for the next head. With
    `check_contents`, last blocks with damaged contents also belong to the torn tail: a host that lost its power may
    have written only a part of them. Without `may_be_torn`, the file was whole once, so a missing part is damage.
    """
    blocks: list[PlacedBlock] = []
    damaged: list[tuple[int, int]] = []
    offset = begin
    while offset < length:
        head = decode_head(read_at(offset, HEAD_BYTES))
        if head is not None and offset + head.length <= length:
            blocks.append(PlacedBlock(offset, head))
            offset += head.length
            continue
        following = _next_head(read_at, offset + 1, length)
        if following is None:
            break
        damaged.append((offset, following))
        offset = following
    if check_contents:
        _check_contents(blocks, read_at, damaged, may_be_torn=may_be_torn)
    end = blocks[-1].end if blocks else begin
    if not may_be_torn and end < length:
        damaged.append((end, length))
        end = length
    return SegmentScan(blocks, end, [one for one in damaged if one[0] < end])


def _next_head(read_at: ReadAt, offset: int, length: int) -> int | None:
    """The offset of the next whole block from `offset` on, or None if there is none."""
    while offset < length:
        raw = read_at(offset, _SEARCH_BYTES + HEAD_BYTES)
        at = raw.find(MAGIC)
        while 0 <= at < _SEARCH_BYTES:
            head = decode_head(raw[at : at + HEAD_BYTES])
            if head is not None and offset + at + head.length <= length:
                return offset + at
            at = raw.find(MAGIC, at + 1)
        offset += _SEARCH_BYTES
    return None


def _check_contents(
    blocks: list[PlacedBlock], read_at: ReadAt, damaged: list[tuple[int, int]], *, may_be_torn: bool
) -> None:
    """Note the blocks with damaged contents. With `may_be_torn`, remove the last blocks up to the last whole one."""
    bad = [one for one in blocks if not is_whole(one.head, read_at(one.offset + HEAD_BYTES, one.head.content_bytes))]
    while may_be_torn and blocks and bad and blocks[-1] is bad[-1]:
        blocks.pop()
        bad.pop()
    damaged += [(one.offset, one.end) for one in bad]


def summary(number: int, length: int, blocks: Iterable[PlacedBlock]) -> Segment | None:
    """The summary of the segment, or None if it has neither items nor gaps."""
    everything = [one.head for one in blocks]
    heads = [head for head in everything if head.kind != OPENING]
    if not heads:
        return None
    first_seq = min(head.first_seq for head in everything)
    with_items = [head for head in heads if head.kind == ITEMS]
    return Segment(
        number=number,
        length=length,
        items=sum(head.items for head in with_items),
        first_seq=first_seq,
        end_seq=max(head.end_seq for head in heads),
        low=min((head.low for head in with_items), default=None),
        high=max((head.high for head in with_items), default=None),
        last_accepted=max(head.last_accepted for head in heads),
    )


def rest_of(whole: Segment, blocks: Sequence[PlacedBlock], following: int | None) -> Segment | None:
    """The summary of the `blocks` of a segment whose items from the seq `following` on are left out; None: no block is
    left.

    If only the note of a loss is left, `begin` stays the first seq of the owner: the seqs before it belong to former
    owners. If only advances are left, `begin` may become `following`: otherwise earlier segments would also have the
    items from `following` on.
    """
    short = summary(whole.number, blocks[-1].end if blocks else 0, blocks)
    if short is None:
        return None
    rest = short._replace(first_seq=whole.first_seq, end_seq=max(short.end_seq, whole.begin))
    return rest if following is None else begun_by(rest, following)


def begun_by(segment: Segment, following: int) -> Segment:
    """The segment, whose owner has begun at the seq `following` or before. If not, the segment has no items left."""
    return segment if segment.begin <= following else segment._replace(first_seq=following, end_seq=following)


def grown(segment: Segment, head: BlockHead) -> Segment:
    """The segment with one more block at its end."""
    length, end_seq = segment.length + head.length, head.end_seq
    accepted = max(segment.last_accepted, head.last_accepted)
    if head.kind in (GAP, ADVANCES):
        return segment._replace(length=length, end_seq=end_seq, last_accepted=accepted)
    return segment._replace(
        length=length,
        items=segment.items + head.items,
        end_seq=end_seq,
        low=head.low if segment.low is None else min(segment.low, head.low),
        high=head.high if segment.high is None else max(segment.high, head.high),
        last_accepted=accepted,
    )
