"""Reads of the segments of one channel. Its methods block: only the threads of the archive call them."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Sequence
from functools import partial
from threading import Lock

from stampede_rt_channel_host.archive.segment_folder import SegmentPlace
from stampede_rt_channel_host.core.archive import (
    HEAD_BYTES,
    ArchivedAdvance,
    ArchivedPart,
    ArchivedRun,
    ArchiveWindow,
    Hole,
    Past,
    PlacedBlock,
    Segment,
    WantedWindow,
    border_holes,
    choose,
    choose_part,
    decode_advances,
    decode_items,
    holes,
    is_whole,
    part_of,
    past_of,
    window_of,
)
from stampede_rt_channel_host.core.channel import Run

SEGMENTS_KEPT, BLOCKS_KEPT = 64, 2**16  # the most segments, and blocks of them, whose heads stay in memory


class SegmentReads:
    """Reads the segments in a place. Any threads read at the same time, while one thread writes."""

    def __init__(self, place: SegmentPlace) -> None:
        self.place = place
        self._lock = Lock()
        self._kept: OrderedDict[int, Sequence[PlacedBlock]] = OrderedDict()
        self.damaged_blocks = 0
        """The blocks that reads found damaged."""

    def load(
        self,
        segments: Sequence[Segment],
        wanted: WantedWindow,
        decode: Callable[[bytes], Run],
        rest: Callable[[], None],
        past: Past | None = None,
    ) -> ArchiveWindow:
        """Load a window of `segments`, perhaps those of `past`. Calls `rest` after each block, for other threads."""
        blocks_of = self._blocks_of if past is None else past.blocks_of(self._blocks_of)
        chosen = choose(segments, blocks_of, wanted.wanted)
        runs: list[Run] = []
        missing: list[Hole] = []
        taken: dict[Segment, set[int]] = {}
        for segment, block in sorted(chosen.blocks, key=lambda one: one[1].head.first_seq):
            found = self._runs_of(segment, block, decode)
            runs += found
            taken.setdefault(segment, set()).add(block.offset)
            if not found:
                missing.append(Hole(block.head.low[0], block.head.high[0], block.head.items))
            rest()
        for segment, offsets in taken.items():
            missing += holes(blocks_of(segment), offsets)
        missing += border_holes(segments, blocks_of, taken)
        window = window_of(runs, chosen, wanted.low, wanted.high, down=wanted.wanted.down)
        return window._replace(holes=missing)

    def past(self, segments: Sequence[Segment], as_of: int, decode: Callable[[bytes], Run]) -> Past:
        """The segments as they were at an earlier instant."""
        return past_of(segments, self._blocks_of, partial(self._archived_runs_of, decode), self._advances_of, as_of)

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
        return [one.run for one in self._archived_runs_of(decode, segment, block)]

    def _advances_of(self, segment: Segment, block: PlacedBlock) -> list[ArchivedAdvance]:
        return decode_advances(self._content_of(segment, block) or b"")

    def _archived_runs_of(
        self, decode: Callable[[bytes], Run], segment: Segment, block: PlacedBlock
    ) -> list[ArchivedRun]:
        content = self._content_of(segment, block)
        return [] if content is None else decode_items(block.head, content, decode)

    def _content_of(self, segment: Segment, block: PlacedBlock) -> bytes | None:
        """The content of a block, or None if it is damaged."""
        with self.place.opened(segment.number) as read_at:
            content = read_at(block.offset + HEAD_BYTES, block.head.content_bytes)
        if is_whole(block.head, content):
            return content
        self.damaged_blocks += 1
        return None

    def _blocks_of(self, segment: Segment) -> Sequence[PlacedBlock]:
        """The blocks of a segment, as far as it had grown when the read began."""
        with self._lock:
            blocks = self._kept.get(segment.number)
            if blocks is not None and blocks and blocks[-1].end >= segment.length:
                self._kept.move_to_end(segment.number)
                return blocks if blocks[-1].end == segment.length else [b for b in blocks if b.end <= segment.length]
        found = self.place.blocks(segment)
        with self._lock:
            self._kept[segment.number] = found
            while len(self._kept) > SEGMENTS_KEPT or (
                len(self._kept) > 1 and sum(map(len, self._kept.values())) > BLOCKS_KEPT
            ):
                self._kept.popitem(last=False)
        return found
