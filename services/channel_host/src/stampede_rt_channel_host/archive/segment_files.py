"""The segments of one channel as files. Its methods block: only the threads of the archive call them."""

from __future__ import annotations

import json
import os
from collections import OrderedDict
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from threading import Lock
from typing import NamedTuple

from stampede_rt_channel_host.archive.stable_writes import sync_folder, write_all
from stampede_rt_channel_host.core.archive import (
    HEAD_BYTES,
    ArchivedPart,
    ArchivedRun,
    ArchiveWindow,
    BlockHead,
    Hole,
    Past,
    PlacedBlock,
    Segment,
    WantedWindow,
    choose,
    choose_part,
    decode_items,
    encode_gap,
    encode_items,
    encode_opening,
    grown,
    holes,
    is_whole,
    part_of,
    past_of,
    scan,
    summary,
    window_of,
)
from stampede_rt_channel_host.core.channel import Run

BLOCK_BYTES = 2**18
SEGMENT_BYTES = 64 * 2**20
SEGMENTS_KEPT = 64  # the most segments whose block lists stay in memory
SEGMENTS_PER_AGE = 16  # a segment ends after this part of the archive's age, so that the age can be kept
_SUFFIX = ".segment"
_CLEAN_FILE = "stopped-cleanly"


class SeqGap(NamedTuple):
    """Seqs whose items are not archived, from `first_seq` up to `end_seq`, exclusive."""

    first_seq: int
    end_seq: int


class ArchiveLimits(NamedTuple):
    """How long and how much the archive keeps; None: without a limit."""

    age_nanos: int | None
    bytes_max: int | None


class OpenedArchive(NamedTuple):
    """The archive that a host finds in the folder of a channel.

    `stopped_cleanly`: the last host process archived all that it had accepted. `torn_bytes` were cut off the end.
    """

    segments: tuple[Segment, ...]
    stopped_cleanly: bool
    torn_bytes: int
    damaged_blocks: int


class SegmentFiles:
    """Reads and writes the segments of one channel. One thread writes; any threads read at the same time."""

    def __init__(self, folder: Path, facts: dict[str, str | int]) -> None:
        """`facts` go into each new segment, for people who look into the file."""
        self._folder = folder
        self._facts = facts
        self._segments: tuple[Segment, ...] = ()
        self._file: int | None = None  # the segment to which blocks are appended
        self._begun_at = 0  # the acceptance instant of its first block
        self._lock = Lock()
        self._kept: OrderedDict[int, Sequence[PlacedBlock]] = OrderedDict()
        self._near = (0, 0)
        self._epoch = 0
        self.damaged_blocks = 0
        """The blocks that reads found damaged."""

    def open(self, epoch: int) -> OpenedArchive:
        """Find the segments, and cut the torn tail off the last one. `epoch`: of the channel now."""
        self._epoch = epoch
        self._folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        clean = self._folder / _CLEAN_FILE
        # The directory has raised the epoch once since then: no other host has had the channel.
        stopped_cleanly = clean.exists() and clean.read_bytes().strip() in (b"%d" % (epoch - 1), b"%d" % epoch)
        numbers = sorted(int(path.stem) for path in self._folder.glob(f"*{_SUFFIX}") if path.stem.isdecimal())
        found, torn_bytes, damaged = [], 0, 0
        following: int | None = None
        for number in reversed(numbers):
            segment, torn, bad = self._open_one(number, following)
            torn_bytes, damaged = torn_bytes + torn, damaged + bad
            if segment is not None:
                found.append(segment)
                following = segment.first_seq
        clean.unlink(missing_ok=True)
        self._segments = tuple(reversed(found))
        return OpenedArchive(self._segments, stopped_cleanly and not torn_bytes, torn_bytes, damaged)

    def _open_one(self, number: int, following: int | None) -> tuple[Segment | None, int, int]:
        """Open a segment. `following`: the first seq of the next segment. Blocks from this seq on do not count: a write
        that failed left them behind, and their items were written again. None: the segment is the last one.
        """
        path, is_last = self._path(number), following is None
        file = os.open(path, os.O_RDWR if is_last else os.O_RDONLY)
        try:
            length = os.fstat(file).st_size
            scanned = scan(lambda offset, size: os.pread(file, size, offset), length, check_contents=is_last)
            if is_last and scanned.end < length:
                os.ftruncate(file, scanned.end)
                os.fsync(file)
        finally:
            os.close(file)
        torn = length - scanned.end if is_last else 0
        blocks = [one for one in scanned.blocks if following is None or one.head.first_seq < following]
        segment = summary(number, blocks[-1].end if blocks else 0, blocks)
        if segment is None:
            path.unlink()
        return segment, torn, len(scanned.damaged)

    def write(self, parts: Sequence[Sequence[ArchivedRun] | SeqGap], limits: ArchiveLimits) -> tuple[Segment, ...]:
        """Append runs and gaps, in seq order, and bring them to stable storage. Returns all segments.

        Drops whole segments that the limits do not keep. Raises OSError if nothing was written: the caller tries the
        same parts again.
        """
        before = self._segments
        try:
            for part in parts:
                self._append(part, limits)
            if self._file is not None:
                os.fsync(self._file)
        except OSError:
            self._undo(before)
            raise
        self._drop_old(limits, self._segments[-1].last_accepted if self._segments else 0)
        return self._segments

    def drop_outdated(self, limits: ArchiveLimits, now: int) -> tuple[Segment, ...]:
        """Delete the segments that the limits do not keep at `now`, but for the last one. Returns the others."""
        self._drop_old(limits, now)
        return self._segments

    def _append(self, part: Sequence[ArchivedRun] | SeqGap, limits: ArchiveLimits) -> None:
        if isinstance(part, SeqGap):
            self._append_block(*encode_gap(part.first_seq, part.end_seq, self._near, self._begun_at), limits)
            return
        waiting: list[ArchivedRun] = []
        size = 0
        for one in part:
            waiting.append(one)
            size += len(one.run.body)
            if size >= BLOCK_BYTES:
                self._append_block(*encode_items(waiting), limits)
                waiting, size = [], 0
        if waiting:
            self._append_block(*encode_items(waiting), limits)

    def _append_block(self, head: BlockHead, buffers: list[bytes], limits: ArchiveLimits) -> None:
        if self._file is None or self._is_full(head, limits):
            self._begin_segment(head)
        file, segment = self._file, self._segments[-1]
        assert file is not None, "a segment is open"
        write_all(file, buffers)
        self._segments = (*self._segments[:-1], grown(segment, head))
        self._near = head.high

    def _is_full(self, head: BlockHead, limits: ArchiveLimits) -> bool:
        segment = self._segments[-1]
        least = SEGMENT_BYTES if limits.bytes_max is None else min(SEGMENT_BYTES, limits.bytes_max // 8)
        span = head.last_accepted - self._begun_at
        is_old = limits.age_nanos is not None and span > limits.age_nanos // SEGMENTS_PER_AGE
        return segment.length >= least or (is_old and segment.items > 0)

    def _begin_segment(self, head: BlockHead) -> None:
        """End the present segment, and begin the next one, whose name no other segment has had."""
        self._end_segment()
        number = self._segments[-1].number + 1 if self._segments else 1
        self._delete_leftovers(number)
        self._file = os.open(self._path(number), os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_APPEND, 0o600)
        sync_folder(self._folder)
        opening = encode_opening(json.dumps(self._facts).encode(), head.first_seq)
        write_all(self._file, opening)
        length = sum(map(len, opening))
        self._begun_at = head.first_accepted
        fresh = Segment(number, length, 0, head.first_seq, head.first_seq, None, None, 0)
        self._segments = (*self._segments, fresh)

    def _end_segment(self) -> None:
        if self._file is not None:
            os.fsync(self._file)
            os.close(self._file)
            self._file = None

    def _undo(self, before: tuple[Segment, ...]) -> None:
        """Take back the bytes that a failed write has appended. The next write begins a new segment.

        What cannot be taken back now is left over: `_delete_leftovers` and `open` find it.
        """
        file, self._file = self._file, None
        self._segments = before
        with suppress(OSError):
            if file is not None:
                os.close(file)
        with suppress(OSError):
            if before:
                os.truncate(self._path(before[-1].number), before[-1].length)
        with suppress(OSError):
            self._delete_leftovers(before[-1].number + 1 if before else 1)

    def _delete_leftovers(self, number: int) -> None:
        """Delete the segments from this number on, which failed writes have left. Raises OSError."""
        while self._path(number).exists():
            self._path(number).unlink()
            number += 1

    def _drop_old(self, limits: ArchiveLimits, now: int) -> None:
        """Delete the oldest segments as long as the limits are kept without them. Never deletes the last segment.

        A segment that cannot be deleted now stays in the archive until a later write.
        """
        size = sum(one.length for one in self._segments)
        while len(self._segments) > 1:
            oldest = self._segments[0]
            too_old = limits.age_nanos is not None and oldest.last_accepted < now - limits.age_nanos
            if not too_old and (limits.bytes_max is None or size <= limits.bytes_max):
                return
            try:
                self._path(oldest.number).unlink(missing_ok=True)
            except OSError:
                return
            size -= oldest.length
            self._segments = self._segments[1:]

    def raise_epoch(self, epoch: int) -> None:
        """The channel has a higher epoch now, at the same host."""
        self._epoch = max(self._epoch, epoch)

    def close(self, *, stopped_cleanly: bool) -> None:
        """End the present segment. `stopped_cleanly`: all accepted items are in it. Deletes a folder without files."""
        self._end_segment()
        if not self._segments:
            with suppress(OSError):
                self._folder.rmdir()
        if stopped_cleanly and self._folder.is_dir():
            with (self._folder / _CLEAN_FILE).open("w") as file:
                file.write(str(self._epoch))
                file.flush()
                os.fsync(file.fileno())
            sync_folder(self._folder)

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
        window = window_of(runs, chosen, wanted.low, wanted.high, down=wanted.wanted.down)
        return window._replace(holes=missing)

    def past(self, segments: Sequence[Segment], as_of: int, decode: Callable[[bytes], Run]) -> Past:
        """The segments as they were at an earlier instant."""
        return past_of(segments, self._blocks_of, partial(self._archived_runs_of, decode), as_of)

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

    def _archived_runs_of(
        self, decode: Callable[[bytes], Run], segment: Segment, block: PlacedBlock
    ) -> list[ArchivedRun]:
        with self._path(segment.number).open("rb", buffering=0) as file:
            content = os.pread(file.fileno(), block.head.content_bytes, block.offset + HEAD_BYTES)
        if not is_whole(block.head, content):
            self.damaged_blocks += 1
            return []
        return decode_items(block.head, content, decode)

    def _blocks_of(self, segment: Segment) -> Sequence[PlacedBlock]:
        """The blocks of a segment, as far as it had grown when the read began."""
        with self._lock:
            blocks = self._kept.get(segment.number)
            if blocks is not None and blocks and blocks[-1].end >= segment.length:
                self._kept.move_to_end(segment.number)
                return blocks if blocks[-1].end == segment.length else [b for b in blocks if b.end <= segment.length]
        with self._path(segment.number).open("rb", buffering=0) as file:
            found = scan(lambda at, size: os.pread(file.fileno(), size, at), segment.length, check_contents=False)
        with self._lock:
            self._kept[segment.number] = found.blocks
            if len(self._kept) > SEGMENTS_KEPT:
                self._kept.popitem(last=False)
        return found.blocks

    def _path(self, number: int) -> Path:
        return self._folder / f"{number:012}{_SUFFIX}"
