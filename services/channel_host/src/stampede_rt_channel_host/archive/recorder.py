"""Records one channel: chooses the items that the archive writes next, and knows which items it has."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import suppress
from itertools import islice
from typing import NamedTuple

from stampede_rt.values.seq_starts import given_between
from stampede_rt_channel_host.archive.clean_stop import CleanStop
from stampede_rt_channel_host.archive.disk_use import FOLDER_BYTES, ChannelDiskUse, DiskUse
from stampede_rt_channel_host.archive.former_files import FormerFiles
from stampede_rt_channel_host.archive.moved_items import MovedItems, lacks_from
from stampede_rt_channel_host.archive.segment_files import ArchiveLimits, SegmentFiles
from stampede_rt_channel_host.archive.waiting_puts import WaitingPuts
from stampede_rt_channel_host.archive.written_parts import Advances, MissingSeqs
from stampede_rt_channel_host.core.archive import (
    ADVANCE_BYTES,
    NOTHING_LOST,
    ArchivedAdvance,
    ArchivedRun,
    ArchiveSpan,
    Segment,
    span_of,
)
from stampede_rt_channel_host.core.channel import ChannelCore, Run
from stampede_rt_channel_host.core.channel.acceptances import Acceptances, AcceptedAdvance

RUNS_PER_WRITE = SLICES_PER_NOTE = 2048  # to gather this many runs takes about 2 ms, to look at as many slices 1 ms
BYTES_PER_WRITE, WRITE_FROM_BYTES = 16 * 2**20, 4 * 2**20  # the most in a write; the waiting bytes that begin a write
GAPS_KEPT, ADVANCES_MAX = 64, 4096  # if so many advances wait for the archive, a new one replaces the latest of them
SETTLE_SECONDS_MAX = 1.0  # the longest wait of a reader for a write that has items which have left memory
Part = list[ArchivedRun] | MissingSeqs | Advances


class WriteJob(NamedTuple):
    """The items that one write appends to the files of one channel. `end_seq`: the seq after them."""

    files: SegmentFiles
    parts: list[Part]
    limits: ArchiveLimits
    end_seq: int
    bytes: int


class ChannelRecorder:
    """One recorded channel, on the event loop. Other objects write and read its files."""

    span: ArchiveSpan
    """The times between which the archive has items."""

    def __init__(
        self,
        channel: ChannelCore,
        files: SegmentFiles,
        segments: tuple[Segment, ...],
        disk: ChannelDiskUse | None = None,
        *,
        from_memory: bool = False,
    ) -> None:
        """`disk` counts the bytes of the files. `from_memory`: see `Recording`."""
        self.files = files
        self.disk = disk or DiskUse().of_channel(b"", "")
        self.keep(segments)
        self.named = 0
        """The number of items that max_bytes collected before the archive had them. Its files name them as missing."""
        self.is_stopped = False  # whether the host has given the channel up: the archive no longer writes its items
        self.failure = ""
        """Why the last write failed; empty: it succeeded."""
        self._gaps: list[MissingSeqs] = []  # seqs that the archive will never have; the earliest gaps are joined
        self._moved = asyncio.Event()  # is set, and replaced, when a write has ended
        self.limits = ArchiveLimits(None, None)
        self.encoded_retries: Callable[[], bytes] = bytes
        """Returns the encoded retry window of the producers."""
        self.on_listed: Callable[[CleanStop | None], None] = lambda stop: None
        """The archive calls it when the object store has listed its segments, with the clean stop of the last owner."""
        self.former = FormerFiles()
        self._channel = channel
        self._accepted = channel.acceptances = channel.acceptances or Acceptances()
        self.moved_items = MovedItems(channel) if from_memory and files.is_shared else None
        """The items that came with a move, while it is not known which of them to write first; otherwise None."""
        self.archived_to = lacks_from(channel, segments) if from_memory else channel.next_seq
        """All seqs below `archived_to` are on stable storage, or lost to the archive."""
        self._puts = WaitingPuts(files.run_bytes_max)
        self._advances: list[ArchivedAdvance] = []  # the advances that are not archived yet
        self._advances_taken = 0  # the number of these advances, from the first on, in the write under way
        self._advance: int | None = None  # the latest advance
        self._lost_before: int | None = None  # see `note_loss`; None: no loss is to be written
        self._found_to: int | None = None
        self._has_reported_loss = False
        channel.record(self.archived_to)
        self.begin()

    def begin(self) -> bool:
        """Search for the first items to write, for about 1 ms. Returns whether the search is over. If not, the archive
        calls this method again before it calls `take`.

        In a shared archive, the items before the last hole in memory come from the former owner (see `MovedItems`).
        """
        if (moved := self.moved_items) is not None:
            moved.look()
            if moved.is_known:
                self.moved_items = None
            if moved.lacks_from > self.archived_to:
                self._end_puts(moved.lacks_from)
        return self.moved_items is None

    def _note_advance(self, now: int) -> bool:
        """Note the highest advance of the channel, if it has risen. Returns whether it has."""
        instant = self._channel.advanced_to
        if instant is None or instant == self._advance:
            return False
        self._advance, known = instant, self._accepted.advance
        if known is None or known.instant != instant:  # otherwise the former owner accepted it
            known = self._accepted.advance = AcceptedAdvance(now, instant)
        if len(self._advances) - self._advances_taken >= ADVANCES_MAX:
            self._advances.pop()
        self._advances.append(ArchivedAdvance(*known))
        return True

    def note(self, now: int) -> bool:
        """Note that the channel has accepted items or an advance at `now`. Returns whether to write something."""
        has_advance = self._note_advance(now)
        end_seq, noted = self._channel.next_seq, self._puts.end_seq or self.archived_to
        self._accepted.note(end_seq, now, self._channel.held)
        size = 0
        if end_seq > noted:
            sized_to, size = self._size_from(noted)
            self._add_put(sized_to, now, size)
        self._expect(size)
        return has_advance or end_seq > self.archived_to

    def _add_put(self, end_seq: int, now: int, size: int) -> None:
        if self._puts.add(end_seq, now, size):
            held = next(iter(self._channel.accepted_from(self.archived_to)), None)
            self._puts.join(self._channel.next_seq if held is None else held.run.first_seq)

    def _size_from(self, seq: int) -> tuple[int, int]:
        """Count items from `seq` on. Returns the seq after them, and the most bytes that they take on the disk.

        Looks at SLICES_PER_NOTE slices at most. A channel that has moved here may have more; later calls count the
        others.
        """
        slices = [*islice(self._channel.accepted_from(seq), SLICES_PER_NOTE)]
        runs = {id(one.run): one.run for one in slices}.values()
        sized_to = slices[-1].end_seq if len(slices) == SLICES_PER_NOTE else self._channel.next_seq
        return sized_to, sum(len(run.body) for run in runs) + self.files.run_bytes_max * max(1, len(runs))

    def _expect(self, largest: int) -> None:
        """Report the bytes that are still to be written. `largest`: the bytes of the latest put."""
        rows = len(self._advances)
        advance_bytes = rows * ADVANCE_BYTES + self.files.run_bytes_max if rows else 0
        self.disk.set_unwritten(0 if self.is_stopped else self._puts.bytes + advance_bytes, largest)

    @property
    def waiting_since(self) -> int | None:
        """The acceptance instant of the first item or advance that is not archived, or None."""
        first = self._accepted.at(self.archived_to) if self._puts.instants else None
        found = (first, *self._puts.instants[:1], *(one.accepted for one in self._advances[:1]))
        return min((one for one in found if one is not None), default=None)

    @property
    def fills_a_write(self) -> bool:
        """Whether WRITE_FROM_BYTES wait, or a fourth of a limit (`is_a_fourth`). False while writes fail."""
        is_much = self._channel.limits.is_a_fourth(self._puts.bytes, self.backlog_items)
        return (is_much or self._puts.bytes >= WRITE_FROM_BYTES) and not self.failure

    @property
    def backlog_items(self) -> int:
        """The number of accepted items that are not archived."""
        return self._channel.next_seq - self.archived_to

    @property
    def waiting_items(self) -> int:
        """The number of accepted items that the archive has still to write."""
        return given_between(self.archived_to, self._channel.next_seq) - self._channel.backlog.lost

    @property
    def unarchived(self) -> int:
        """The number of items that max_bytes collected before the archive had them."""
        return self.named + self._channel.backlog.lost

    @property
    def lost_items(self) -> int:
        """The number of items that neither memory nor the archive has, and that no file names as missing yet."""
        return self._channel.backlog.lost + self._channel.backlog.at_risk

    @property
    def readable_segments(self) -> tuple[Segment, ...]:
        """The segments for reads. The last one also has the seqs of items that neither memory nor a file has, and that
        no file names as missing. These items are lost, or in a file of the former owner that has not come."""
        if not self.segments:
            return ()
        last, held = self.segments[-1], next(self._channel.accepted_from(self.archived_to), None)
        held_from = self._channel.next_seq if held is None else held.first_seq
        end_seq = max(max(last.end_seq, self.archived_to) + self.lost_items, held_from)
        return (*self.segments[:-1], last._replace(end_seq=end_seq))

    @property
    def has_all_items(self) -> bool:
        """Whether the archive has all items that the channel holds."""
        channel = self._channel
        first = next(iter(channel.accepted_from(0)), None)
        archived_from = self.segments[0].first_seq if self.segments else channel.next_seq
        is_whole = first is None or first.run.first_seq >= archived_from
        return is_whole and not self.backlog_items and not self.failure

    def clean_stop(self) -> CleanStop | None:
        """The note for the folder; None if the archive lacks held items. Call it when the channel accepts no more."""
        if not self.has_all_items:
            return None
        channel = self._channel
        losses = channel.lost_from, channel.lost_before
        return CleanStop(channel.incarnation, channel.advanced_to, *losses, self.encoded_retries())

    def note_loss(self, lost_before: int, found_to: int | None = None) -> None:
        """Note that the former owner was lost with items before this instant. The next write adds this to the files.

        `found_to`: the seq after the former owner's items that the archive had; None: the first seq of this owner.
        """
        self._lost_before, self._found_to = lost_before, found_to

    def withdraw_loss(self) -> bool:
        """Note that the former owner stopped cleanly. Returns whether the next write must revoke a written loss."""
        self._lost_before, self._found_to = NOTHING_LOST if self._has_reported_loss else None, None
        return self._has_reported_loss

    def take(self) -> WriteJob:
        """The next items to write, in seq order, with gaps where memory has lost items."""
        parts: list[Part] = []
        if self._lost_before is not None:
            seq = self.archived_to if self._found_to is None else self._found_to
            self._has_reported_loss = True
            parts.append(MissingSeqs(seq, seq, self._lost_before))
        if self._advances:  # before the items that the host accepted after them
            parts.append(Advances(self.archived_to, tuple(self._advances)))
            self._advances_taken = len(self._advances)
        expected, size, last = self.archived_to, 0, None
        unheld = 0  # the items of the taken runs that have left memory
        for slice_ in self._channel.accepted_from(self.archived_to):
            run = slice_.run
            if run is last:
                unheld -= slice_.items
                continue
            if size >= BYTES_PER_WRITE or sum(len(one) for one in parts if isinstance(one, list)) >= RUNS_PER_WRITE:
                break
            last = run
            if run.first_seq > expected:
                parts.append(MissingSeqs(expected, run.first_seq))
            expected = self._add(parts, run)
            unheld += len(run) - slice_.items
            size += len(run.body)
        else:
            if expected < self._channel.next_seq:
                parts.append(MissingSeqs(expected, self._channel.next_seq))
                expected = self._channel.next_seq
        self._channel.backlog.note_archived(expected, unheld)
        return WriteJob(self.files, parts, self.limits, expected, size)

    def _add(self, parts: list[Part], run: Run) -> int:
        if not parts or not isinstance(parts[-1], list):
            parts.append([])
        runs = parts[-1]
        assert isinstance(runs, list), "the last part is a list of runs"
        begin, end_seq = max(run.first_seq, self.archived_to), run.first_seq + len(run)
        rows = self._accepted.between(begin, end_seq) if len(run) > 1 else None  # None: one put
        if rows is not None and begin == run.first_seq and len(rows.ends) < 2:
            rows = None
        runs.append(ArchivedRun(self._accepted.at(begin) or 0, run, rows, begin))
        return end_seq

    def keep(self, segments: tuple[Segment, ...]) -> None:
        """Note the segments that the archive has now."""
        self.segments, self.span = segments, span_of(segments)
        self.disk.set_bytes(FOLDER_BYTES + self.files.local_bytes() if segments else 0)

    def limit(self, limits: ArchiveLimits) -> None:
        """Set the limits of the channel's archive."""
        self.limits = limits
        self.disk.archive_bytes = limits.bytes_max

    def check_room(self, body_bytes: int = 0) -> None:
        """Raises Overloaded if the archive has no room for a run of `body_bytes`, or for an advance."""
        self.disk.check(body_bytes + self.files.run_bytes_max)

    def written(self, job: WriteJob, segments: tuple[Segment, ...]) -> None:
        """Note that a job is on stable storage."""
        self.keep(segments)
        missing = [one for one in job.parts if isinstance(one, MissingSeqs)]
        if any(one.lost_before is not None and one.lost_before == self._lost_before for one in missing):
            self._has_reported_loss = self._lost_before != NOTHING_LOST
            self._lost_before = None
        gaps = [one for one in job.parts if isinstance(one, MissingSeqs) and one.lost_before is None]
        named = sum(given_between(one.first_seq, one.end_seq) for one in gaps)
        self.named += named
        self._gaps += gaps
        if len(over := self._gaps[:-GAPS_KEPT]):  # the earliest gaps become one
            self._gaps[: len(over) + 1] = [MissingSeqs(self._gaps[0].first_seq, self._gaps[len(over)].end_seq)]
        del self._advances[: sum(len(one.rows) for one in job.parts if isinstance(one, Advances))]
        self._advances_taken = 0
        self._end_puts(job.end_seq, named)
        self.note_end("")

    def _end_puts(self, end_seq: int, named: int = 0) -> None:
        """Note that the archive has all items below `end_seq`, or will never have them. `named`: see
        `ChannelCore.record`.
        """
        self.archived_to = end_seq
        self._puts.end(end_seq)
        self._expect(0)
        self._channel.record(end_seq, named)

    def note_end(self, failure: str) -> None:
        """Note that a write has ended, with a `failure` or without one. Wakes the puts that wait for stable storage."""
        self.failure = failure
        if failure:
            self._channel.backlog.write_failed()
        moved, self._moved = self._moved, asyncio.Event()
        moved.set()

    def stop(self) -> None:
        """Note that the archive no longer writes items of the channel. Idempotent."""
        self.is_stopped = True
        self.former.note_complete()
        self._expect(0)
        self.note_end(self.failure)

    async def settle(self, end_seq: int) -> None:
        """Wait until the archive has the items below `end_seq` that memory has lost, or names them as missing.

        Waits SETTLE_SECONDS_MAX at most, and not while the disk fails.
        """
        with suppress(TimeoutError):
            async with asyncio.timeout(SETTLE_SECONDS_MAX):
                while self.lost_items and self.archived_to < end_seq and not self.failure and not self.is_stopped:
                    await self._moved.wait()

    async def stored(self, first_seq: int, end_seq: int, seconds_max: float | None) -> str:
        """Wait until these items are on stable storage, `seconds_max` at most; None: without a limit.

        Returns an empty text, or the reason why they are not.
        """
        try:
            async with asyncio.timeout(seconds_max):
                while self.archived_to < end_seq and not self.failure and not self.is_stopped:
                    await self._moved.wait()
        except TimeoutError:
            pass
        if self.archived_to < end_seq:
            return self.failure or ("the host gave the channel up" if self.is_stopped else "the disk is too slow")
        is_lost = any(one.first_seq < end_seq and one.end_seq > first_seq for one in self._gaps)
        return "max_bytes collected items before they were written" if is_lost else ""
