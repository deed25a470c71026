"""The blocks of one segment in compact columns, sorted by time, by seq and by acceptance. Pure."""

from __future__ import annotations

from array import array
from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Iterator, Sequence
from itertools import accumulate
from typing import Any, NamedTuple, overload

from stampede_rt_channel_host.core.archive.block import (
    ADVANCES,
    GAP,
    ITEMS,
    NO_KEY,
    NOTHING_LOST,
    OPENING,
    PACKED_HEAD_BYTES,
    BlockHead,
    pack_head,
    unpack_head,
)
from stampede_rt_channel_host.core.archive.segment import PlacedBlock
from stampede_rt_channel_host.core.channel.item_keys import ItemKey

BLOCK_INDEX_BYTES = 192
"""About how many bytes of memory the facts about one block take."""


class _Columns(NamedTuple):
    """Columns in the order of the file. `heads` and `offsets` have all blocks.

    `advances` has the positions of the blocks of advances among all blocks, and `places` the positions of the blocks
    with items. The columns after `places` have only the blocks with items.
    """

    heads: bytes
    offsets: array[int]
    advances: array[int]
    places: array[int]
    lows: array[int]
    highs: array[int]
    first_seqs: array[int]
    end_seqs: array[int]
    accepted: array[int]


class SegmentBlocks(Sequence[PlacedBlock]):
    """The blocks of a segment, or its first blocks, in the order of the file. Immutable."""

    __slots__ = (
        "_accepted", "_breaks", "_by_high", "_by_low", "_columns", "_high_times", "_least", "_low_times", "_reach",
    )  # fmt: skip

    def __init__(self, blocks: Iterable[PlacedBlock] = ()) -> None:
        self._sort(_columns_of([*blocks], 0))

    def _sort(self, columns: _Columns) -> None:
        self._columns = columns
        lows, highs = columns.lows, columns.highs
        # at equal times the order of the file is the order of the seqs, and sorting keeps it
        self._by_low = array("I", sorted(range(len(lows)), key=lows.__getitem__))
        self._low_times = array("q", (lows[at] for at in self._by_low))
        # The greatest time of each block of `_by_low` and all blocks before it.
        self._reach = array("q", accumulate((highs[at] for at in self._by_low), max))
        self._by_high = array("I", sorted(range(len(highs)), key=highs.__getitem__))
        self._high_times = array("q", (highs[at] for at in self._by_high))
        # The least time of each block of `_by_high` and all blocks after it.
        self._least = array("q", accumulate((lows[at] for at in reversed(self._by_high)), min))
        self._least.reverse()
        self._accepted = array("q", accumulate(columns.accepted, max))
        pairs = zip(columns.end_seqs, columns.first_seqs[1:], strict=False)
        self._breaks = array("I", (at for at, (end, first) in enumerate(pairs) if end != first))

    def followed_by(self, blocks: Iterable[PlacedBlock]) -> SegmentBlocks:
        """These blocks, and then others."""
        more = _columns_of([*blocks], len(self))
        pairs: Iterable[Any] = zip(self._columns, more, strict=True)
        return _from_columns(_Columns(*(one + other for one, other in pairs)))

    def up_to(self, count: int) -> SegmentBlocks:
        """The first `count` blocks."""
        heads, offsets, advances, *item_columns = self._columns
        items = bisect_left(self._columns.places, count)
        kept = (heads[: count * PACKED_HEAD_BYTES], offsets[:count], advances[: bisect_left(advances, count)])
        return _from_columns(_Columns(*kept, *(one[:items] for one in item_columns)))

    def before(self, offset: int) -> SegmentBlocks:
        """The blocks that begin before `offset`."""
        count = bisect_left(self._columns.offsets, offset)
        return self if count == len(self) else self.up_to(count)

    def __len__(self) -> int:
        return len(self._columns.offsets)

    @overload
    def __getitem__(self, at: int) -> PlacedBlock: ...
    @overload
    def __getitem__(self, at: slice) -> Sequence[PlacedBlock]: ...
    def __getitem__(self, at: int | slice) -> PlacedBlock | Sequence[PlacedBlock]:
        if isinstance(at, slice):
            return [self[one] for one in range(*at.indices(len(self)))]
        offset = self._columns.offsets[at]
        return PlacedBlock(offset, unpack_head(self._columns.heads, at % len(self) * PACKED_HEAD_BYTES))

    def items_at(self, at: int) -> PlacedBlock | None:
        """The block at position `at` among the blocks that have items; -1: the last one. None: there is none."""
        places = self._columns.places
        return self[places[at]] if -len(places) <= at < len(places) else None

    def breaks(self) -> Iterator[tuple[BlockHead, BlockHead]]:
        """The pairs of neighbouring blocks of items between which seqs are missing."""
        for at in self._breaks:
            yield self._item_block(at).head, self._item_block(at + 1).head

    def position(self, offset: int) -> int:
        """The position of the block at `offset` among the blocks that have items."""
        return bisect_left(self._columns.places, bisect_left(self._columns.offsets, offset))

    def up(self, low: ItemKey) -> Iterator[PlacedBlock]:
        """Yield the blocks of items that end at `low` or later, in the order of their least keys."""
        for at in range(bisect_left(self._reach, low[0]), len(self._by_low)):
            block = self._item_block(self._by_low[at])
            if block.head.high >= low:
                yield block

    def down(self, low: ItemKey, high: ItemKey) -> Iterator[PlacedBlock]:
        """Yield the blocks of items with keys from `low` up to `high`, by their greatest keys, downwards."""
        for at in reversed(range(bisect_right(self._least, high[0]))):
            block = self._item_block(self._by_high[at])
            if block.head.high < low:
                return
            if block.head.low < high:
                yield block

    def from_seq(self, first_seq: int) -> Iterator[PlacedBlock]:
        """The blocks of items that have `first_seq` or later seqs, in the order of the seqs."""
        for at in range(bisect_right(self._columns.end_seqs, first_seq), len(self._columns.places)):
            yield self._item_block(at)

    def last_end_before(self, time: int) -> int | None:
        """The greatest time at which a block of items ends before `time`, or None."""
        at = bisect_left(self._high_times, time)
        return self._high_times[at - 1] if at else None

    def last_start_before(self, time: int) -> int | None:
        """The greatest time at which a block of items begins before `time`, or None."""
        at = bisect_left(self._low_times, time)
        return self._low_times[at - 1] if at else None

    def first_start_after(self, time: int) -> int | None:
        """The least time at which a block of items begins after `time`, or None."""
        at = bisect_right(self._low_times, time)
        return self._low_times[at] if at < len(self._low_times) else None

    def first_accepted_after(self, instant: int) -> int | None:
        """The position of the first block with an item that the host accepted after `instant`, or None."""
        at = bisect_right(self._accepted, instant)
        return self._columns.places[at] if at < len(self._columns.places) else None

    @property
    def lost_before(self) -> int | None:
        """The former owner was lost with items from before this instant. None: the segment records no such loss.

        A gap before the first block of items records the loss. A later gap revokes this record, if the host has learned
        that the former owner stopped cleanly.
        """
        reported = self._recorded
        if reported is None or any(_records_loss(one.head) and one.head.first_accepted == NOTHING_LOST for one in self):
            return None
        return reported

    @property
    def records_loss(self) -> bool:
        """Whether the segment records the loss of the former owner, even if a later gap revokes this record."""
        return self._recorded is not None

    @property
    def _recorded(self) -> int | None:
        places = self._columns.places
        first = (self[at].head for at in range(places[0] if places else len(self)))
        return next((one.first_accepted for one in first if _records_loss(one)), None)

    @property
    def earlier_to(self) -> int | None:
        """The greatest time of the items that the channel had accepted before this segment; None: it is not known."""
        opening = self[0].head if len(self) else None
        is_known = opening is not None and opening.kind == OPENING and opening.high != NO_KEY
        return opening.high[0] if opening is not None and is_known else None

    @property
    def advance_blocks(self) -> Sequence[PlacedBlock]:
        """The blocks of advances."""
        return [self[at] for at in self._columns.advances]

    def _item_block(self, at: int) -> PlacedBlock:
        return self[self._columns.places[at]]


def _records_loss(head: BlockHead) -> bool:
    return head.kind == GAP and head.first_seq == head.end_seq


def _from_columns(columns: _Columns) -> SegmentBlocks:
    blocks = SegmentBlocks.__new__(SegmentBlocks)
    blocks._sort(columns)
    return blocks


def _columns_of(blocks: Sequence[PlacedBlock], first: int) -> _Columns:
    """The columns of blocks, the first of which has the position `first`."""
    with_items = [(at, one.head) for at, one in enumerate(blocks, first) if one.head.kind == ITEMS]
    heads = [head for _, head in with_items]
    return _Columns(
        heads=b"".join(pack_head(one.head) for one in blocks),
        offsets=array("Q", (one.offset for one in blocks)),
        advances=array("I", (at for at, one in enumerate(blocks, first) if one.head.kind == ADVANCES)),
        places=array("I", (at for at, _ in with_items)),
        lows=array("q", (head.low[0] for head in heads)),
        highs=array("q", (head.high[0] for head in heads)),
        first_seqs=array("Q", (head.first_seq for head in heads)),
        end_seqs=array("Q", (head.end_seq for head in heads)),
        accepted=array("q", (head.last_accepted for head in heads)),
    )
