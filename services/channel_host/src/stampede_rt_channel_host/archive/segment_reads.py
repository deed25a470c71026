"""Reads of the segments of one channel. Its methods block: only the threads of the archive call them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from functools import partial

from stampede_rt.values.timeline import MIN_INSTANT
from stampede_rt_channel_host.archive.kept_blocks import FoundBlocks, KeptBlocks
from stampede_rt_channel_host.archive.segment_folder import SegmentPlace
from stampede_rt_channel_host.core.archive import (
    HEAD_BYTES,
    NO_KEY,
    ArchivedAdvance,
    ArchivedLoss,
    ArchivedPart,
    ArchivedRun,
    ArchiveWindow,
    BlocksOf,
    CutRun,
    Hole,
    PastArchive,
    PlacedBlock,
    ReadAt,
    Segment,
    SegmentBlocks,
    TimeRange,
    WantedWindow,
    WindowNeedsThread,
    WindowReach,
    border_holes,
    choose,
    choose_part,
    decode_advances,
    decode_items,
    doubts_in,
    holes,
    is_whole,
    losses_in,
    part_of,
    past_of,
    reach_of,
    window_of,
)
from stampede_rt_channel_host.core.archive.stored_segment import up_to
from stampede_rt_channel_host.core.channel import AcceptedRows, ItemKey, Run

Opened = Callable[[int], AbstractContextManager[ReadAt]]
"""Opens a segment. The context gives a function that reads its bytes."""


class SegmentReads:
    """Reads the segments in a place. Any threads read at the same time, while one thread writes."""

    def __init__(self, place: SegmentPlace, kept: KeptBlocks | None = None) -> None:
        """`kept`: the blocks that the reads of all channels have found."""
        self.place = place
        self._segments: tuple[Segment, ...] = ()
        self._kept = KeptBlocks() if kept is None else kept
        self.earlier: ItemKey = NO_KEY
        """The greatest key of the items that the channel has accepted before the next segment, if it is known."""
        self.cut: CutRun | None = None
        """Cuts the last run of a block whose later items are in the next segment, too; None: there is no such block."""
        self.join: Callable[[Sequence[Run]], Sequence[Run]] = _as_they_are
        """Joins neighbouring runs of one item, because the read takes several steps for each run."""
        self.is_listed = True
        """Whether the segments are known from a listing of their store, and not from a list on the disk."""
        self.dropped_to = MIN_INSTANT
        """The greatest time of the items that this process has dropped from the archive."""
        self._earlier_to: int | None = None  # see `SegmentBlocks`; of the first segment; None: no read has found it
        self.damaged_blocks = 0
        """The blocks that reads found damaged."""

    def has(self, number: int) -> bool:
        """Whether the archive still has a segment. If it has, and its bytes are nowhere, somebody has removed them."""
        return any(one.number == number for one in self._segments)

    def load(
        self,
        segments: Sequence[Segment],
        wanted: WantedWindow,
        decode: Callable[[bytes], Run],
        rest: Callable[[], None],
        past: PastArchive | None = None,
    ) -> ArchiveWindow:
        """Load a window of `segments`, which may be the segments of `past`.

        Calls `rest` between two blocks, for other threads.
        """
        return self._load(segments, wanted, decode, rest, past, self._blocks_of, self.place.opened)

    def load_at_hand(
        self,
        segments: Sequence[Segment],
        wanted: WantedWindow,
        decode: Callable[[bytes], Run],
        past: PastArchive | None = None,
    ) -> ArchiveWindow | None:
        """The window if it is short and all its bytes are in memory; otherwise None. Does not block."""
        at_hand = wanted._replace(wanted=wanted.wanted._replace(at_hand=True))
        try:
            return self._load(segments, at_hand, decode, _do_not_rest, past, self._known_blocks_of, self.place.at_hand)
        except (WindowNeedsThread, OSError):
            return None

    def _load(
        self,
        segments: Sequence[Segment],
        wanted: WantedWindow,
        decode: Callable[[bytes], Run],
        rest: Callable[[], None],
        past: PastArchive | None,
        all_blocks_of: BlocksOf,
        opened: Opened,
    ) -> ArchiveWindow:
        blocks_of = all_blocks_of if past is None else past.blocks_of(all_blocks_of)
        chosen = choose(segments, blocks_of, wanted.wanted)
        runs: list[Run] = []
        accepted: list[tuple[int, int]] = []
        missing: list[Hole] = []
        taken: dict[Segment, set[int]] = {}
        for at, (segment, block) in enumerate(sorted(chosen.blocks, key=lambda one: one[1].head.first_seq)):
            if at:
                rest()
            found = self._archived_runs_of(decode, segment, block, wanted.wanted.times, opened)
            runs += self.join([one.run for one in found or ()])
            if wanted.with_instants:
                accepted += [(one.run.first_seq + len(one.run), one.accepted) for one in found or ()]
            taken.setdefault(segment, set()).add(block.offset)
            if found is None:
                missing.append(Hole(block.head.low[0], block.head.high[0], block.head.items))
        for segment, offsets in taken.items():
            missing += holes(blocks_of(segment), offsets)
        reach = reach_of(wanted, chosen)
        doubts = doubts_in(segments, blocks_of, taken, reach, wanted.limits, None if past is None else past.as_of)
        if past is not None:  # the host had accepted the missing items by that instant
            reach = reach._replace(border=max(reach.border, past.as_of))
        missing += border_holes(segments, blocks_of, taken, reach)
        window = window_of(runs, chosen, wanted.low, wanted.high, down=wanted.wanted.down)
        rows = AcceptedRows(*zip(*accepted, strict=True)) if accepted else None
        earlier_to = self._last_dropped(segments, blocks_of, reach)
        return window._replace(holes=missing, doubts=doubts, earlier_to=earlier_to, accepted=rows)

    def _last_dropped(self, segments: Sequence[Segment], blocks_of: BlocksOf, reach: WindowReach) -> int | None:
        """The greatest time of the items before the first segment; None: there are none, or it is not known.

        If the object store may be unreachable, a read of later segments does not need the first one.
        """
        first = next((one for one in segments if one.items), None)
        if first is None or segments[0].first_seq == 1:
            return None
        is_readable = self.is_listed or reach.meets(first) or not self.place.is_stored(first.number)
        if self._earlier_to is None and is_readable:
            found = blocks_of(first).earlier_to
            self._earlier_to = MIN_INSTANT if found is None else found
        last = max(self._earlier_to or MIN_INSTANT, self.dropped_to)
        return last if last > MIN_INSTANT else None

    def past(self, segments: Sequence[Segment], as_of: int, decode: Callable[[bytes], Run]) -> PastArchive:
        """The segments as they were at an earlier instant."""
        return past_of(segments, self._blocks_of, partial(self._all_runs_of, decode), self._advances_of, as_of)

    def losses(self, segments: Sequence[Segment], since: int) -> list[ArchivedLoss]:
        """The losses of owners with items that they had accepted after the instant `since`."""
        return losses_in(segments, self._blocks_of, since)

    def load_part(
        self,
        segments: Sequence[Segment],
        missing: tuple[int, int],
        bytes_max: int,
        decode: Callable[[bytes], Run],
        rest: Callable[[], None],
    ) -> ArchivedPart:
        """Load items in the order of their seqs. See `choose_part` and `load`."""
        chosen = choose_part(segments, self._blocks_of, missing, bytes_max)
        runs: list[Run] = []
        for segment, block in (*chosen.blocks, *chosen.among):
            runs += self._runs_of(segment, block, decode)
            rest()
        return part_of(runs, chosen)

    def _runs_of(self, segment: Segment, block: PlacedBlock, decode: Callable[[bytes], Run]) -> list[Run]:
        return [*self.join([one.run for one in self._all_runs_of(decode, segment, block)])]

    def _all_runs_of(self, decode: Callable[[bytes], Run], segment: Segment, block: PlacedBlock) -> list[ArchivedRun]:
        return self._archived_runs_of(decode, segment, block) or []

    def _advances_of(self, segment: Segment, block: PlacedBlock) -> list[ArchivedAdvance]:
        return decode_advances(self._content_of(segment, block, self.place.opened) or b"")

    def _archived_runs_of(
        self,
        decode: Callable[[bytes], Run],
        segment: Segment,
        block: PlacedBlock,
        within: TimeRange | None = None,
        opened: Opened | None = None,
    ) -> list[ArchivedRun] | None:
        """The runs of a block that a read of these times needs, or None if the block is damaged."""
        content = self._content_of(segment, block, opened or self.place.opened)
        if content is None:
            return None
        runs = decode_items(block.head, content, decode, within)
        if runs and self.cut is not None:
            runs[-1] = runs[-1].below(block.head.end_seq, self.cut)
        return runs

    def _content_of(self, segment: Segment, block: PlacedBlock, opened: Opened) -> bytes | None:
        """The content of a block, or None if it is damaged, or if somebody has removed the segment."""
        waits = opened == self.place.opened
        at, size = block.offset + HEAD_BYTES, block.head.content_bytes
        try:
            with opened(segment.number) as read_at:
                content = read_at(at, size)
            if is_whole(block.head, content):
                return content
            reread = self.place.read_again(segment.number, at, size) if waits else None
        except FileNotFoundError:
            if not (waits and self.has(segment.number)):
                raise
            reread = None
        if reread is not None and is_whole(block.head, reread):
            return reread
        self.damaged_blocks += 1
        return None

    def _known_blocks_of(self, segment: Segment) -> SegmentBlocks:
        """Like `_blocks_of`. Raises WindowNeedsThread if no read has found the blocks yet."""
        found = self._kept.get(self, segment.number)
        if found.length < segment.length or found.has_left_out(segment.end_seq):
            raise WindowNeedsThread
        return self._below(found.blocks, segment)

    def _blocks_of(self, segment: Segment) -> SegmentBlocks:
        """The blocks of a segment, as far as it had grown when the read began.

        If somebody has removed its file, only the blocks that earlier reads have found.
        """
        found = self._kept.get(self, segment.number)
        if found.has_left_out(segment.end_seq):  # the read began before the next segment came
            return SegmentBlocks(self.place.blocks(segment))
        if found.length < segment.length:
            try:
                more = self.place.blocks(segment, found.length)
            except FileNotFoundError:
                if not self.has(segment.number):
                    raise
                return found.blocks
            found = FoundBlocks(segment.length, found.blocks.followed_by(more))
            self._kept.keep(self, segment.number, found)
        return self._below(found.blocks, segment)

    def _below(self, found: SegmentBlocks, segment: Segment) -> SegmentBlocks:
        """The blocks that the segment has. An earlier read may have found more of them, before the next segment came
        from the former owner with their last items.
        """
        blocks = found.before(segment.length)
        last = [one for one in (blocks.items_at(-1), blocks[-1] if blocks else None) if one is not None]
        if all(one.head.end_seq <= segment.end_seq for one in last):
            return blocks
        blocks = SegmentBlocks(up_to(blocks, segment.length, segment.end_seq))
        self._kept.keep(self, segment.number, FoundBlocks(segment.length, blocks, segment.end_seq))
        return blocks


def _as_they_are(runs: Sequence[Run]) -> Sequence[Run]:
    return runs


def _do_not_rest() -> None:
    """Does nothing, because a short read lets no other thread run in between."""
