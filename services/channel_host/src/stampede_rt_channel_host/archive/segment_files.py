"""The segments of one channel as files. Its methods block: only the threads of the archive call them."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from contextlib import suppress
from itertools import chain
from pathlib import Path
from typing import NamedTuple

from stampede_rt_channel_host.archive.clean_stop import CleanStop, OwnPart, read_stop, remove_stop, write_stop
from stampede_rt_channel_host.archive.kept_blocks import FoundBlocks, KeptBlocks
from stampede_rt_channel_host.archive.segment_folder import SegmentFolder, reads_of
from stampede_rt_channel_host.archive.segment_reads import SegmentReads
from stampede_rt_channel_host.archive.stable_writes import start_flush, sync_folder, write_all
from stampede_rt_channel_host.archive.written_parts import Advances, MissingSeqs, WrittenPart, by_instants
from stampede_rt_channel_host.core.archive import (
    ADVANCE_BYTES,
    HEAD_BYTES,
    ROW_BYTES,
    ArchivedAdvance,
    ArchivedRun,
    BlockHead,
    Segment,
    SegmentBlocks,
    encode_advances,
    encode_gap,
    encode_items,
    encode_opening,
    grown,
    rest_of,
    scan,
    summary,
)
from stampede_rt_channel_host.core.archive.stored_segment import below, first_number

BLOCK_BYTES = 2**18
GATHERED_BYTES = 2 * 2**20
"""Blocks are written together up to this length.

After each write the thread waits for the interpreter lock, which the event loop holds. While the thread prepares a
longer write, the disk has no work.
"""
SEGMENT_BYTES = 64 * 2**20
SEGMENTS_PER_AGE = 16  # a segment ends after 1/16 of the archive's age, because the archive drops only whole segments


class ArchiveLimits(NamedTuple):
    """The age and the size up to which the archive keeps items; None: without a limit."""

    age_nanos: int | None
    bytes_max: int | None


class OpenedArchive(NamedTuple):
    """The archive in the folder of a channel. `stop`: the note that the last host process had archived all accepted
    items, or None. `torn_bytes` were cut off the end. `own`: the last items, if the host knows no others.
    """

    segments: tuple[Segment, ...]
    stop: CleanStop | None
    torn_bytes: int
    damaged_blocks: int
    own: OwnPart | None = None


class SegmentFiles(SegmentReads):
    """Reads and writes the segments of one channel. One thread writes; any threads read at the same time.

    `run_bytes_max`: the most bytes that a run, or some advances, take on the disk besides their own bytes: a head of
    a block, a gap before it, and the beginning of a segment.
    """

    def __init__(
        self,
        folder: Path,
        facts: dict[str, str | int],
        kept: KeptBlocks | None = None,
        files: SegmentFolder | None = None,
    ) -> None:
        """`facts` go into each new segment, for people who look into the file. `kept`: see `SegmentReads`. `files`: the
        segments in `folder`.
        """
        self._files = files or SegmentFolder(folder)
        super().__init__(self._files, kept)
        self._folder = folder
        self.run_bytes_max = ROW_BYTES + 4 * HEAD_BYTES + ADVANCE_BYTES + len(json.dumps(facts))
        self._facts = facts
        self.is_shared = False
        """Whether the other hosts of the cluster read the closed segments, too."""
        self.is_known = True
        """Whether the host knows all segments: False until the first listing after an opening without one."""
        self.is_moving_here = False
        """Whether the channel moves to this host, and another host still owns it. Then no note of this host counts."""
        self._file: int | None = None  # the segment to which blocks are appended
        self._gathered: list[bytes] = []  # the parts of blocks that are still to be written to it
        self._written_to = self._flushed_to = 0  # the offsets up to which it is written, and coming to the disk
        self._begun_at = 0  # the acceptance instant of its first block
        self._near = (0, 0)
        self._advance: ArchivedAdvance | None = None  # the latest one
        self._epoch = 0
        self._follows_damage = False  # the archive begins with a segment that was set aside

    def open(self, epoch: int, incarnation: int = 0, stored: Sequence[Segment] = ()) -> OpenedArchive:
        """Find the segments of the channel with this epoch and incarnation. Cut the torn tail off the last one.

        After a clean stop nothing can be torn, and a last block that is not whole is a damaged one. `stored`: the
        segments that are only in an object store.
        """
        self._epoch = epoch
        self._folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        stop = read_stop(self._folder)
        opened = self._find(stored, stop)
        remove_stop(self._folder)
        is_true = stop is not None and stop.is_of(incarnation, epoch) and not self.is_moving_here
        return opened._replace(stop=stop if is_true and not opened.torn_bytes else None)

    def open_left(self) -> None:
        """Find the segments of a channel that this host does not serve. The note of a clean stop stays."""
        self._find((), read_stop(self._folder))

    def _find(self, stored: Sequence[Segment], stop: CleanStop | None) -> OpenedArchive:
        found, torn_bytes, damaged = [], 0, 0
        may_be_torn = stop is None or not stop.end_seq
        following: int | None = None
        others, numbers = {one.number: one for one in stored}, self._files.numbers()
        for number in sorted((*numbers, *others), reverse=True):
            if number in others:
                segment, torn, bad = self._without(others[number], following), 0, 0
                if segment is None and others[number].first_seq >= (following or 0):  # otherwise a damaged block stays
                    self._files.remove(number)
            else:
                last = number == numbers[-1]
                segment, torn, bad = self._open_one(number, following, is_last=last, may_be_torn=last and may_be_torn)
            torn_bytes, damaged = torn_bytes + torn, damaged + bad
            if segment is not None:
                found.append(segment)
                following = segment.begin
        found.reverse()
        self._follows_damage = self._files.follows_damage(found[0].number if found else None)
        if found and self._follows_damage:
            found[0] = found[0]._replace(first_seq=1)
        self._segments = tuple(found)
        return OpenedArchive(self._segments, None, torn_bytes, damaged)

    def _without(self, segment: Segment, following: int | None) -> Segment | None:
        """A closed segment without the items from the seq `following` on, which the next segment has; None: it has no
        others.
        """
        if following is None or segment.end_seq <= following:
            return segment
        return rest_of(segment, below(self._files.blocks(segment), segment.length, following), following)

    def _open_one(
        self, number: int, following: int | None, *, is_last: bool, may_be_torn: bool
    ) -> tuple[Segment | None, int, int]:
        """Open a segment of the folder. `following`: the first seq of the next segment, or None. Blocks
        from that seq on come from a failed write, whose items were written again. The archive drops a file that has no
        other blocks.
        """
        path = self._files.file_of(number)
        file = os.open(path, os.O_RDWR if is_last else os.O_RDONLY)
        try:
            length = os.fstat(file).st_size
            scanned = scan(reads_of(file), length, check_contents=is_last, may_be_torn=may_be_torn)
            if scanned.end < length:
                os.ftruncate(file, scanned.end)
                os.fsync(file)
        finally:
            os.close(file)
        blocks = scanned.blocks if following is None else below(scanned.blocks, length, following)
        whole = summary(number, scanned.end, scanned.blocks)
        segment = None if whole is None else rest_of(whole, blocks, following)
        if segment is None and scanned.damaged:
            self._files.set_aside(number)
        elif segment is None:
            path.unlink()
        else:
            self._kept.keep(self, number, FoundBlocks(segment.length, SegmentBlocks(blocks)))
        return segment, length - scanned.end, len(scanned.damaged)

    def write(self, parts: Sequence[WrittenPart], limits: ArchiveLimits) -> tuple[Segment, ...]:
        """Append runs and gaps, in seq order, and bring them to stable storage. Returns all segments.

        Drops whole segments that the limits do not keep. Raises OSError if nothing was written: the caller tries the
        same parts again.
        """
        before = self._segments
        try:
            for part in parts:
                self._append(part, limits)
            self._sync()
        except OSError:
            self._undo(before)
            raise
        self._drop_old(limits, self._segments[-1].last_accepted if self._segments else 0)
        return self._segments

    def drop_outdated(self, limits: ArchiveLimits, now: int) -> tuple[Segment, ...]:
        """Delete the segments that the limits do not keep at `now`, except the last one. Returns the others."""
        self._drop_old(limits, now)
        return self._segments

    def _append(self, part: WrittenPart, limits: ArchiveLimits) -> None:
        if isinstance(part, Advances):
            self._append_block(*encode_advances(part.rows, part.seq, self._near), limits)
            self._advance = part.rows[-1]
            return
        if isinstance(part, MissingSeqs):
            accepted = self._begun_at if part.lost_before is None else part.lost_before
            self._append_block(*encode_gap(part.first_seq, part.end_seq, self._near, accepted), limits)
            return
        waiting, size = list[ArchivedRun](), 0
        for one in chain.from_iterable(map(by_instants, part)):
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
        segment = grown(self._segments[-1], head)
        self._gathered += buffers
        self._segments = (*self._segments[:-1], segment)
        self._near = head.high
        if segment.length - self._written_to >= GATHERED_BYTES:
            self._write_gathered()

    def _write_gathered(self) -> None:
        """Write the gathered blocks, and let the system begin to bring them to the disk."""
        assert self._file is not None, "a segment is open"
        buffers, self._gathered = self._gathered, []
        write_all(self._file, buffers)
        self._written_to = self._segments[-1].length
        self._flushed_to = start_flush(self._file, self._flushed_to, self._written_to)

    def _sync(self) -> None:
        """Bring everything that was appended to the present segment to stable storage."""
        if self._file is not None:
            self._write_gathered()
            os.fsync(self._file)
            self._flushed_to = self._written_to
            self._files.check_file(self._segments[-1].number, self._file)

    def _is_full(self, head: BlockHead, limits: ArchiveLimits) -> bool:
        segment = self._segments[-1]
        least = SEGMENT_BYTES if limits.bytes_max is None else min(SEGMENT_BYTES, limits.bytes_max // 8)
        span = head.last_accepted - self._begun_at
        is_old = limits.age_nanos is not None and span > limits.age_nanos // SEGMENTS_PER_AGE
        return segment.length >= least or (is_old and segment.items > 0)

    def _begin_segment(self, head: BlockHead) -> None:
        """End the present segment, and begin the next one under a name that no segment has had before."""
        self._end_segment()
        self._files.make_again()
        number = self._next_number()
        self._delete_leftovers(number)
        self._file = os.open(self._files.file_of(number), os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_APPEND, 0o600)
        sync_folder(self._folder)
        sync_folder(self._folder.parent)  # the folder may be new
        self.earlier = max([self.earlier, *(one.high for one in self._segments if one.high is not None)])
        opening = encode_opening(json.dumps(self._facts).encode(), head.first_seq, self.earlier)
        write_all(self._file, opening)
        if self._advance is not None:  # a segment begins with the latest advance, for reads as of an instant
            advance = encode_advances([self._advance], head.first_seq, self._near)[1]
            write_all(self._file, advance)
            opening += advance
        length = sum(map(len, opening))
        self._begun_at, self._written_to, self._flushed_to = head.first_accepted, length, 0
        first_seq = 1 if self._follows_damage and not self._segments else head.first_seq
        self._segments = (*self._segments, Segment(number, length, 0, first_seq, head.first_seq, None, None, 0))

    def _end_segment(self) -> None:
        if self._file is not None:
            try:
                self._sync()
            finally:
                os.close(self._file)
                self._file = None

    def _undo(self, before: tuple[Segment, ...]) -> None:
        """Take back the bytes that a failed write has appended. The next write begins a new segment.

        If some bytes cannot be taken back now, `_delete_leftovers` or `open` deletes them later.
        """
        file, self._file, self._gathered = self._file, None, []
        self._segments = before
        with suppress(OSError):
            if file is not None:
                os.close(file)
        with suppress(OSError):
            if before:
                os.truncate(self._files.file_of(before[-1].number), before[-1].length)
        with suppress(OSError):
            self._delete_leftovers(self._next_number())

    def _next_number(self) -> int:
        """The number of the next segment. Two owners of a channel never give their segments the same number."""
        return max(self._segments[-1].number + 1 if self._segments else 1, first_number(self._epoch))

    def _delete_leftovers(self, number: int) -> None:
        """Delete the segments from this number on, which failed writes have left. Raises OSError."""
        while self._files.file_of(number).exists():
            self._files.file_of(number).unlink()
            number += 1

    def _drop_old(self, limits: ArchiveLimits, now: int) -> None:
        """Delete the oldest segments that the limits do not keep. Never deletes the last segment.

        A segment that cannot be deleted now stays in the archive until a later write.
        """
        size, outdated = sum(one.length for one in self._segments), list[int]()
        for segment in self._segments[:-1]:
            too_old = limits.age_nanos is not None and segment.last_accepted < now - limits.age_nanos
            if not too_old and (limits.bytes_max is None or size <= limits.bytes_max):
                break
            outdated.append(segment.number)
            size -= segment.length
        if outdated:  # off the list first: a read must not report a deleted file as lost
            highs = [one.high[0] for one in self._segments[: len(outdated)] if one.high is not None]
            self.dropped_to = max([self.dropped_to, *highs])
            before, self._segments = self._segments, self._segments[len(outdated) :]
            self._segments = before[self._files.remove_all(outdated) :]

    @property
    def epoch(self) -> int:
        """The epoch of the channel at this host."""
        return self._epoch

    def local_bytes(self) -> int:
        """The bytes of the segments in the folder."""
        return sum(one.length for one in self._segments)

    def raise_epoch(self, epoch: int) -> None:
        """Note that the channel has a higher epoch now, at the same host."""
        self._epoch = max(self._epoch, epoch)

    def close(self, stop: CleanStop | None) -> None:
        """End the present segment. `stop`: all accepted items are in the archive.

        With `stop`, the folder stays, because it holds the note. Without it, deletes the folder if it has no files.
        """
        self._end_segment()
        if stop is not None and self._folder.is_dir():
            write_stop(self._folder, stop.at_end(self._segments, self._epoch))
        else:
            with suppress(OSError):  # the folder still has files
                self._folder.rmdir()
