"""Chooses the blocks of an archive that a read needs next, and makes the items of them readable. Pure.

A read takes the archive in windows: stretches of whole buckets, in the direction of the read, of a bounded number of
bytes. A bucket is all items of one time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from heapq import heappop, heappush
from typing import NamedTuple

from stampede_rt.errors import Overloaded
from stampede_rt.values.timeline import format_instant
from stampede_rt_channel_host.core.archive.block import ITEMS, BlockHead
from stampede_rt_channel_host.core.archive.segment import Hole, PlacedBlock, Segment
from stampede_rt_channel_host.core.channel.index import ChannelIndex
from stampede_rt_channel_host.core.channel.item_keys import FIRST_KEY, LAST_KEY, SEQ_END, ItemKey
from stampede_rt_channel_host.core.channel.run import Run

WINDOW_BYTES_MAX = 64 * 2**20
"""The most bytes of blocks that a read loads at once, if there is more than one block."""
BlocksOf = Callable[[Segment], Sequence[PlacedBlock]]
"""Returns the blocks of a segment. The shell keeps the blocks of the segments that reads used last."""


class Wanted(NamedTuple):
    """The items that a read wants from an archive: the items from `start` on, with the bucket before it, below `high`.

    `overlap` is the overlap of the channel in nanoseconds. `from_time`: the read continues at this time, and wants no
    earlier item. `down`: the read wants the latest items first. `bytes_max`: about how many bytes one window may have.
    Beyond `bytes_limit`, which only very many items of one time reach, the read fails.
    """

    start: int
    high: ItemKey
    overlap: int
    bytes_max: int
    from_time: int | None = None
    down: bool = False
    bytes_limit: int = WINDOW_BYTES_MAX


class Chosen(NamedTuple):
    """The blocks to load, with their segments.

    `edge`: the time at which the read continues. A read upwards has no bucket from `edge` on in this window, and a read
    downwards none up to `edge`. None: the blocks have all that the read wants. `following` is the time of the first
    bucket after the blocks, or None.
    """

    blocks: Sequence[tuple[Segment, PlacedBlock]]
    edge: int | None
    following: int | None


class ArchiveWindow(NamedTuple):
    """The items of some blocks, in time order: whole buckets, without a gap between them.

    `edge` and `following`: see `Chosen`. `end`: no item at or above this key belongs to the window or comes after it;
    None: the items in memory come after the window. `holes`: the items that the archive lacks here.
    """

    items: ChannelIndex
    edge: int | None
    following: int | None
    end: ItemKey | None
    holes: Sequence[Hole] = ()


def choose(segments: Sequence[Segment], blocks_of: BlocksOf, wanted: Wanted) -> Chosen:
    """The blocks that the read loads next."""
    low = (_low_time(segments, blocks_of, wanted), 0)
    walk = _down(segments, blocks_of, low, wanted.high) if wanted.down else _up(segments, blocks_of, low)
    growing, edge = _Growing(wanted, low[0]), None
    for segment, block in walk:
        head = block.head
        if not wanted.down and head.low >= wanted.high:
            return Chosen(growing.taken, None, head.low[0])
        if growing.size >= wanted.bytes_max and growing.may_end(head):
            edge = head.high[0] if wanted.down else head.low[0]
            break
        growing.take(segment, block)
    following = _next_low(segments, blocks_of, wanted.high[0]) if wanted.down else edge
    return Chosen(growing.taken, edge, following)


class _Growing:
    """A window while blocks come in: `taken`, of `size` bytes.

    A window cannot end within a bucket, so `bytes_limit` bounds it.
    """

    def __init__(self, wanted: Wanted, low: int) -> None:
        """`low`: the time from which on the read needs items."""
        self.taken: list[tuple[Segment, PlacedBlock]] = []
        self.size = 0
        self._wanted = wanted
        self._first = low if wanted.overlap else wanted.start if wanted.from_time is None else wanted.from_time
        self._least, self._greatest = LAST_KEY[0], FIRST_KEY  # of the keys with which a window may end

    def take(self, segment: Segment, block: PlacedBlock) -> None:
        """Add a block. Raises Overloaded if the window becomes too large."""
        self.taken.append((segment, block))
        self.size += block.head.length
        for key in (block.head.low, block.head.high):
            if key[0] >= self._first:
                self._least = min(self._least, key[0])
            if key < self._wanted.high:
                self._greatest = max(self._greatest, key)
        if self.size > self._wanted.bytes_limit and len(self.taken) > 1:
            when = format_instant(block.head.low[0])
            raise Overloaded(
                f"more than {self._wanted.bytes_limit} bytes of archived items around {when} have one time, so the "
                "host cannot read them at once; subscribe with start= to read them in the order of their acceptance"
            )

    def may_end(self, following: BlockHead) -> bool:
        """Whether the window may end before the block `following`.

        It has a whole bucket then. Without overlap it does not end among the items before `start`: that is one bucket.
        """
        start = FIRST_KEY[0] if self._wanted.overlap else self._wanted.start
        if self._wanted.down:
            edge = following.high[0]
            return edge >= start and self._greatest > (edge, SEQ_END)
        edge = following.low[0]
        return edge > start and self._least < edge


def _low_time(segments: Sequence[Segment], blocks_of: BlocksOf, wanted: Wanted) -> int:
    """The time from which on the read needs items: that of the bucket before `start`, whose spans may reach there."""
    start = wanted.start
    before = FIRST_KEY[0]
    for segment in segments:
        if segment.high is None or segment.low is None or segment.low[0] >= start:
            continue
        if segment.high[0] < start:
            before = max(before, segment.high[0])
        else:
            ends = (one.head.high[0] for one in item_blocks(blocks_of(segment)))
            before = max(before, max((end for end in ends if end < start), default=before))
    low = min(start - wanted.overlap, start if before == FIRST_KEY[0] else before)
    return low if wanted.from_time is None else max(low, wanted.from_time)


def item_blocks(blocks: Iterable[PlacedBlock]) -> Iterator[PlacedBlock]:
    """The blocks that have items."""
    return (one for one in blocks if one.head.kind == ITEMS)


def _up(segments: Sequence[Segment], blocks_of: BlocksOf, low: ItemKey) -> Iterator[tuple[Segment, PlacedBlock]]:
    """The blocks that reach to `low` or beyond, by their least key. Asks for a segment's blocks only when it is due."""
    due = sorted((one for one in segments if one.high is not None and one.high >= low), key=_least)
    waiting: list[tuple[ItemKey, int, int, Segment, PlacedBlock]] = []
    for at, segment in enumerate(due):
        for block in item_blocks(blocks_of(segment)):
            if block.head.high >= low:
                heappush(waiting, (block.head.low, segment.number, block.offset, segment, block))
        bound = _least(due[at + 1]) if at + 1 < len(due) else LAST_KEY
        while waiting and waiting[0][0] < bound:
            yield heappop(waiting)[3:]


def _down(
    segments: Sequence[Segment], blocks_of: BlocksOf, low: ItemKey, high: ItemKey
) -> Iterator[tuple[Segment, PlacedBlock]]:
    """The blocks with keys from `low` up to `high`, by their greatest key, the last one first."""
    due = [one for one in segments if one.high is not None and one.high >= low and _least(one) < high]
    due.sort(key=_greatest, reverse=True)
    waiting: list[tuple[int, int, int, int, Segment, PlacedBlock]] = []
    for at, segment in enumerate(due):
        for block in item_blocks(blocks_of(segment)):
            if block.head.high >= low and block.head.low < high:
                time, seq = block.head.high
                heappush(waiting, (-time, -seq, segment.number, block.offset, segment, block))
        bound = _greatest(due[at + 1]) if at + 1 < len(due) else FIRST_KEY
        while waiting and (-waiting[0][0], -waiting[0][1]) > bound:
            yield heappop(waiting)[4:]


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
            lows = [one.head.low[0] for one in item_blocks(blocks_of(segment)) if one.head.low[0] > time]
            first = min(lows if first is None else [*lows, first], default=None)
    return first


def window_of(runs: Iterable[Run], chosen: Chosen, low: ItemKey, high: ItemKey, *, down: bool) -> ArchiveWindow:
    """The items of the chosen blocks at or above `low` and below `high`, without buckets that are there only in part.

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
            blocks = item_blocks(blocks_of(segment))
            yield from ((segment, one) for one in blocks if one.head.end_seq > first_seq)
