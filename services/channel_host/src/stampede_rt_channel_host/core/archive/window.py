"""Chooses the blocks of an archive that a read needs next, and makes their items readable. Pure.

A read takes the archive in windows: ranges of whole buckets, in the direction of the read, of a bounded number of
bytes. A bucket is all items of one time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from heapq import heappop, heappush
from typing import NamedTuple

from stampede_rt.errors import Overloaded
from stampede_rt.values.timeline import format_instant
from stampede_rt_channel_host.core.archive.block import BlockHead, TimeRange
from stampede_rt_channel_host.core.archive.doubts import Doubt
from stampede_rt_channel_host.core.archive.holes import Hole
from stampede_rt_channel_host.core.archive.segment import PlacedBlock, Segment
from stampede_rt_channel_host.core.archive.segment_blocks import SegmentBlocks
from stampede_rt_channel_host.core.channel.acceptances import AcceptedRows
from stampede_rt_channel_host.core.channel.index import ChannelIndex
from stampede_rt_channel_host.core.channel.item_keys import FIRST_KEY, LAST_KEY, SEQ_END, ItemKey
from stampede_rt_channel_host.core.channel.run import Run

WINDOW_BYTES_MAX = 64 * 2**20
"""The most bytes of blocks that a read loads in one step, if there is more than one block."""
BlocksOf = Callable[[Segment], SegmentBlocks]
"""Returns the blocks of a segment. The shell keeps the blocks of the segments that reads used last."""


AT_HAND_BYTES, AT_HAND_BLOCKS = 2**19, 8
"""If a window has at most this many bytes and blocks, the host reads it without a thread."""


class WindowNeedsThread(Exception):
    """The next window is too long to be read without a thread, or its blocks are not known yet."""


class WantedItems(NamedTuple):
    """The items that a read wants from an archive: those from `start` on and below `high`, and the last bucket before
    `start`, whose spans may reach `start`.

    `overlap` is the overlap of the channel in nanoseconds. `from_time`: the read continues at this time, and wants no
    earlier item. `down`: the read wants the latest items first. `bytes_max`: about how many bytes one window may have.
    If a window needs more than `bytes_limit`, the read fails; this happens only with very many items of one time.
    `at_hand`: the read fails with WindowNeedsThread if the window is too long to be read without a thread.
    """

    start: int
    high: ItemKey
    overlap: int
    bytes_max: int
    from_time: int | None = None
    down: bool = False
    bytes_limit: int = WINDOW_BYTES_MAX
    at_hand: bool = False

    @property
    def times(self) -> TimeRange:
        """The times whose items the read wants."""
        return TimeRange(self.start, self.high[0], self.overlap)


class ChosenBlocks(NamedTuple):
    """The blocks that a read loads for its next window, with their segments.

    `edge`: the time at which the read continues. In a read upwards, all buckets of this window are before `edge`; in a
    read downwards, all are after it. None: the blocks have all wanted items. `following` is the time of the first
    bucket after the blocks, or None.
    """

    blocks: Sequence[tuple[Segment, PlacedBlock]]
    edge: int | None
    following: int | None


class ArchiveWindow(NamedTuple):
    """The items of some blocks, in time order: whole buckets, without a gap between them.

    `edge` and `following`: see `ChosenBlocks`. `end`: the items of this window and of all later windows are below
    this key; None: the items in memory come after the window. `holes`: the items that the archive lacks here. `doubts`:
    where it may lack items. `earlier_to`: see `SegmentBlocks`; of the first segment, if it is known.
    `accepted`: when the host accepted the items, if the reader has asked for it.
    """

    items: ChannelIndex
    edge: int | None
    following: int | None
    end: ItemKey | None
    holes: Sequence[Hole] = ()
    doubts: Sequence[Doubt] = ()
    earlier_to: int | None = None
    accepted: AcceptedRows | None = None


def choose(segments: Sequence[Segment], blocks_of: BlocksOf, wanted: WantedItems) -> ChosenBlocks:
    """The blocks that the read loads next."""
    low = (_low_time(segments, blocks_of, wanted), 0)
    scan = _down(segments, blocks_of, low, wanted.high) if wanted.down else _up(segments, blocks_of, low)
    growing, edge = _GrowingWindow(wanted, low[0]), None
    for segment, block in scan:
        head = block.head
        if not wanted.down and head.low >= wanted.high:
            return ChosenBlocks(growing.taken, None, head.low[0])
        if growing.size >= wanted.bytes_max and growing.may_end(head):
            edge = head.high[0] if wanted.down else head.low[0]
            break
        growing.take(segment, block)
    following = _next_low(segments, blocks_of, wanted.high[0]) if wanted.down else edge
    return ChosenBlocks(growing.taken, edge, following)


class _GrowingWindow:
    """The blocks chosen for a window so far: `taken`, of `size` bytes together.

    A window ends only after a whole bucket. A bucket may be very large, so `bytes_limit` bounds the window.
    """

    def __init__(self, wanted: WantedItems, low: int) -> None:
        """`low`: the earliest time at which the read needs items."""
        self.taken: list[tuple[Segment, PlacedBlock]] = []
        self.size = 0
        self._wanted = wanted
        self._first = low if wanted.overlap else wanted.start if wanted.from_time is None else wanted.from_time
        # the earliest time from `_first` on, and the last key below `high`: see `may_end`
        self._least, self._greatest = LAST_KEY[0], FIRST_KEY

    def take(self, segment: Segment, block: PlacedBlock) -> None:
        """Add a block. Raises Overloaded if the window becomes too large."""
        self.taken.append((segment, block))
        self.size += block.head.length
        if self._wanted.at_hand and (self.size > AT_HAND_BYTES or len(self.taken) > AT_HAND_BLOCKS):
            raise WindowNeedsThread
        for key in (block.head.low, block.head.high):
            if key[0] >= self._first:
                self._least = min(self._least, key[0])
            if key < self._wanted.high:
                self._greatest = max(self._greatest, key)
        if self.size > self._wanted.bytes_limit and len(self.taken) > 1:
            when = format_instant(block.head.low[0])
            raise Overloaded(
                f"more than {self._wanted.bytes_limit} bytes of archived items around {when} have one time, so the "
                "host cannot read them together; subscribe with start= to read them in the order of their acceptance"
            )

    def may_end(self, following: BlockHead) -> bool:
        """Whether the window may end before the block `following`.

        It may end only after a whole bucket. Without overlap it does not end among the items before `start`, because
        the read needs only one bucket of them.
        """
        start = FIRST_KEY[0] if self._wanted.overlap else self._wanted.start
        if self._wanted.down:
            edge = following.high[0]
            return edge >= start and self._greatest > (edge, SEQ_END)
        edge = following.low[0]
        return edge > start and self._least < edge


def _low_time(segments: Sequence[Segment], blocks_of: BlocksOf, wanted: WantedItems) -> int:
    """The earliest time at which the read needs items.

    The read needs also the last bucket before `start`, because the spans of this bucket may reach `start`.
    """
    start = wanted.start
    before = FIRST_KEY[0]
    for segment in segments:
        if segment.high is None or segment.low is None or segment.low[0] >= start:
            continue
        if segment.high[0] < start:
            before = max(before, segment.high[0])
        else:
            blocks = blocks_of(segment)
            found = (blocks.last_end_before(start), blocks.last_start_before(start))
            # both are None if each block extends over `start`
            before = max([before, *(one for one in found if one is not None)])
    low = min(start - wanted.overlap, start if before == FIRST_KEY[0] else before)
    return low if wanted.from_time is None else max(low, wanted.from_time)


def _up(segments: Sequence[Segment], blocks_of: BlocksOf, low: ItemKey) -> Iterator[tuple[Segment, PlacedBlock]]:
    """Yield the blocks that end at `low` or later, in the order of their least keys.

    Loads the blocks of a segment only when the caller needs the first one of them.
    """
    due = sorted((one for one in segments if one.high is not None and one.high >= low), key=_least)
    merging = _BlockMerge(lambda block: block.head.low)
    for at, segment in enumerate(due):
        merging.begin(segment, blocks_of(segment).up(low))
        yield from merging.below(_least(due[at + 1]) if at + 1 < len(due) else LAST_KEY)


def _down(
    segments: Sequence[Segment], blocks_of: BlocksOf, low: ItemKey, high: ItemKey
) -> Iterator[tuple[Segment, PlacedBlock]]:
    """Yield the blocks with keys from `low` up to `high`, in the order of their greatest keys, the greatest first."""
    due = [one for one in segments if one.high is not None and one.high >= low and _least(one) < high]
    due.sort(key=_greatest, reverse=True)
    merging = _BlockMerge(lambda block: _mirrored(block.head.high))
    for at, segment in enumerate(due):
        merging.begin(segment, blocks_of(segment).down(low, high))
        yield from merging.below(_mirrored(_greatest(due[at + 1]) if at + 1 < len(due) else FIRST_KEY))


def _mirrored(key: ItemKey) -> ItemKey:
    """A key that sorts in the reverse order."""
    return -key[0], -key[1]


class _BlockMerge:
    """Merges the blocks of several segments into one order. `key` returns the place of a block in this order."""

    def __init__(self, key: Callable[[PlacedBlock], ItemKey]) -> None:
        self._key = key
        self._next: list[tuple[ItemKey, int, PlacedBlock, Segment, Iterator[PlacedBlock]]] = []  # a heap

    def begin(self, segment: Segment, blocks: Iterator[PlacedBlock]) -> None:
        """Add the blocks of one more segment."""
        block = next(blocks, None)
        if block is not None:
            heappush(self._next, (self._key(block), segment.number, block, segment, blocks))

    def below(self, bound: ItemKey) -> Iterator[tuple[Segment, PlacedBlock]]:
        """Yield the next blocks, as long as their keys are below `bound`."""
        while self._next and self._next[0][0] < bound:
            _, _, block, segment, blocks = heappop(self._next)
            self.begin(segment, blocks)
            yield segment, block


def _least(segment: Segment) -> ItemKey:
    return LAST_KEY if segment.low is None else segment.low


def _greatest(segment: Segment) -> ItemKey:
    return FIRST_KEY if segment.high is None else segment.high


def _next_low(segments: Sequence[Segment], blocks_of: BlocksOf, time: int) -> int | None:
    """The time of the first block that begins after `time`, or None."""
    first: int | None = None
    for segment in segments:
        if segment.low is None or segment.high is None or segment.high[0] <= time:
            continue
        if first is None or segment.low[0] < first:
            start = blocks_of(segment).first_start_after(time)
            if start is not None:
                first = start if first is None else min(first, start)
    return first


def window_of(runs: Iterable[Run], chosen: ChosenBlocks, low: ItemKey, high: ItemKey, *, down: bool) -> ArchiveWindow:
    """The items of the chosen blocks at or above `low` and below `high`, without incomplete buckets.

    `runs` ascend in their seqs.
    """
    whole, edge = ChannelIndex(), chosen.edge
    for run in runs:
        whole.insert(run)
    if edge is None:
        return ArchiveWindow(whole.copy_of(low, high), None, chosen.following, None)
    if down:
        return ArchiveWindow(whole.copy_of(max(low, (edge, SEQ_END)), high), edge, chosen.following, None)
    end = min(high, (edge, 0))
    return ArchiveWindow(whole.copy_of(low, end), edge, chosen.following, end)


def choose_by_seq(
    segments: Sequence[Segment], blocks_of: BlocksOf, first_seq: int, bytes_max: int
) -> list[tuple[Segment, PlacedBlock]]:
    """The blocks of the items from `first_seq` on, in seq order, of about `bytes_max`."""
    taken: list[tuple[Segment, PlacedBlock]] = []
    size = 0
    for segment, block in _from_seq(segments, blocks_of, first_seq):
        if size >= bytes_max:
            break
        taken.append((segment, block))
        size += block.head.length
    return taken


def _from_seq(
    segments: Sequence[Segment], blocks_of: BlocksOf, first_seq: int
) -> Iterator[tuple[Segment, PlacedBlock]]:
    for segment in segments:
        if segment.end_seq > first_seq and segment.items:
            yield from ((segment, one) for one in blocks_of(segment).from_seq(first_seq))
