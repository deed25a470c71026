"""The archive of one host, on its event loop: writes the items that the channels accept, and reads archived items."""

from __future__ import annotations

import asyncio
import logging
import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import TypeVar

from stampede_rt_channel_host.archive.archive_end import ArchiveEnd
from stampede_rt_channel_host.archive.archive_folder import ArchiveFolder
from stampede_rt_channel_host.archive.disk_use import DiskUse, FoundFolder
from stampede_rt_channel_host.archive.kept_blocks import KeptBlocks
from stampede_rt_channel_host.archive.objects.object_archive import ObjectArchive
from stampede_rt_channel_host.archive.recorder import ChannelRecorder, WriteJob
from stampede_rt_channel_host.archive.segment_files import OpenedArchive, SegmentFiles
from stampede_rt_channel_host.archive.task_defects import log_defect
from stampede_rt_channel_host.core.archive import ArchivedPart, ArchiveWindow, PastArchive, Segment, WantedWindow
from stampede_rt_channel_host.core.channel import Run
from stampede_rt_channel_host.core.records import RecordedChannel
from stampede_rt_runtime.working_threads import WorkingThreads

Result = TypeVar("Result")
logger = logging.getLogger(__name__)

READERS, READERS_OF_STORE = 2, 8  # threads; the readers of an object store mostly wait for the network
WRITE_AFTER_SECONDS = 0.2  # the time for which the archive gathers small writes
RETRY_SECONDS = 1.0
CLOSE_SECONDS_MAX = 5.0  # the limit for the last work of a host that stops; its process may end the work earlier
_PAUSE_SECONDS = 0.0002  # a reader gives the other threads their turn after each block


class HostArchive:
    """Writes with one thread, and reads with other threads, so that the event loop never waits for the disk.

    After new items have come, the archive waits WRITE_AFTER_SECONDS for more, unless a channel has enough for a write.
    Then it writes the items of all channels, one channel after the other. For items that come meanwhile, it waits
    again. `decode` makes a run from a stored body. `join` joins neighbouring runs for readers. `on_written` is called
    after each write of a channel that succeeds. `disk` counts the bytes of the files. `now` is the host's clock.
    """

    def __init__(
        self,
        folder: ArchiveFolder,
        decode: Callable[[bytes], Run],
        disk: DiskUse | None = None,
        now: Callable[[], int] = time.time_ns,
        objects: ObjectArchive | None = None,
        join: Callable[[Sequence[Run]], Sequence[Run]] | None = None,
    ) -> None:
        """`objects`: the part in an object store; None: all files stay in the folder."""
        self.folder = folder
        self.objects = objects
        self.disk = disk or DiskUse()
        self.disk.on_full = self._make_room
        self._decode, self._join, self.now = decode, join, now
        self._kept = KeptBlocks()
        self._recorders: set[ChannelRecorder] = set()
        self._making_room: asyncio.Task[None] | None = None
        self._writer = WorkingThreads(1, "archive-writer")
        self._readers = WorkingThreads(READERS if objects is None else READERS_OF_STORE, "archive-reader")
        if objects is not None:
            objects.mover.writer = self._writer
        self._due: dict[ChannelRecorder, Callable[[], None]] = {}  # each with the function to call after its write
        self._task: asyncio.Task[None] | None = None
        self._wakeup = asyncio.Event()
        self._hurry = asyncio.Event()  # a put waits for stable storage
        self._is_closing = False
        self._failing: dict[ChannelRecorder, str] = {}  # the channels whose last write failed, and why
        mover = None if objects is None else objects.mover
        self._end = ArchiveEnd(folder, self._in_writer, self._write_rest, self._note_failure, mover)

    @property
    def failure(self) -> str:
        """Why the last write of a channel failed; empty if no write failed."""
        return next(iter(self._failing.values()), "")

    @property
    def store_failure(self) -> str:
        """Why the last call of the object store failed; empty: it succeeded, or there is no object store."""
        return "" if self.objects is None else self.objects.mover.failure or self.objects.store.failure

    @property
    def place(self) -> str:
        """The folder, and the URL of the object store."""
        return self.folder.place_text(None if self.objects is None else self.objects.store.url)

    @property
    def failing_channels(self) -> int:
        """The number of channels whose last write failed."""
        return len(self._failing)

    async def open(
        self, record: RecordedChannel, *, may_be_unknown: bool = False, is_move: bool = False
    ) -> tuple[SegmentFiles, OpenedArchive]:
        """Open the files of a channel, and look at them. Raises OSError.

        `may_be_unknown`: if the object store is unreachable, the host may open them without knowing what the store has.
        `is_move`: another host still owns the channel.
        """
        channel_id, name = record.channel_id, record.name
        facts: dict[str, str | int] = {"channel_id": channel_id.hex(), "channel": name, "created_by": record.created_by}
        if self.objects is None:
            files = SegmentFiles(self.folder.of_channel(channel_id), facts, self._kept)
            files.is_moving_here = is_move
            found = await self._in_writer(files.open, record.epoch, record.incarnation)
        else:
            files, found = await self._open_stored(self.objects, record, facts, may_be_unknown, is_move)
        if self._join is not None:
            files.join = self._join
        if found.torn_bytes or found.damaged_blocks:
            logger.warning(
                "the archive of a channel was damaged",
                extra={
                    "event": "archive_damaged",
                    "channel": name,
                    "torn_bytes": found.torn_bytes,
                    "damaged_blocks": found.damaged_blocks,
                },
            )
        return files, found

    async def _open_stored(
        self,
        objects: ObjectArchive,
        record: RecordedChannel,
        facts: dict[str, str | int],
        may_be_unknown: bool,
        is_move: bool,
    ) -> tuple[SegmentFiles, OpenedArchive]:
        """The files of a channel, with its files in the object store. Raises OSError."""
        files = objects.files_of(record.channel_id, facts, self._kept)
        files.is_moving_here = is_move
        opened = await objects.open(files, record, self._readers, self._writer, may_be_unknown=may_be_unknown)
        return files, opened

    async def _in_writer(self, call: Callable[..., Result], *arguments: object) -> Result:
        return await asyncio.get_running_loop().run_in_executor(self._writer, call, *arguments)

    def give_up(self, files: SegmentFiles) -> None:
        """Close the files of a channel that is not recorded here after all."""
        self._writer.submit(files.close, None)

    def start(self) -> None:
        """Move closed files to the object store from now on, if there is one. Idempotent."""
        if self.objects is not None:
            self.objects.mover.start()

    def record(self, recorder: ChannelRecorder, *, has_moved: bool = False) -> None:
        """Record a channel from now on, until `forget`. `has_moved`: another host recorded it until now."""
        self._recorders.add(recorder)
        if self.objects is not None:
            self.objects.mover.record(recorder)
            if has_moved:
                self.objects.mover.expect_former(recorder)

    def touch(self, recorder: ChannelRecorder, on_written: Callable[[], None]) -> None:
        """Note that this channel has items to write."""
        self._due[recorder] = on_written
        if recorder.fills_a_write:
            self._hurry.set()
        if self._task is None or self._task.done():
            self._task = asyncio.create_task(self._write_on(), name="archive")
            self._task.add_done_callback(log_defect)
        self._wakeup.set()

    def hurry(self) -> None:
        """Write immediately, because a put waits for stable storage.

        Items that come during a write share the next write.
        """
        self._hurry.set()

    def forget(self, recorder: ChannelRecorder) -> None:
        """Stop writing items of this channel. A write that is under way ends first."""
        recorder.stop()
        self._due.pop(recorder, None)
        self._failing.pop(recorder, None)
        self._recorders.discard(recorder)
        self._writer.submit(recorder.files.close, None)
        if self.objects is not None:
            self.objects.mover.forget(recorder)

    def delete(self, channel_id: bytes) -> None:
        """Delete the objects and files of a deleted channel. Without an object store its files stay."""
        if self.objects is not None:
            self.objects.mover.delete(channel_id)

    async def _write_on(self) -> None:
        """Write while there is something to write, until the archive closes."""
        while not self._is_closing:
            await self._wakeup.wait()
            self._wakeup.clear()
            if not self._is_closing:
                await self._gather()
            await self._write_due()
        await self.write_all()

    async def _gather(self) -> None:
        """Wait for more items, unless a put waits for stable storage."""
        try:
            async with asyncio.timeout(WRITE_AFTER_SECONDS):
                await self._hurry.wait()
        except TimeoutError:
            pass
        self._hurry.clear()

    async def write_all(self) -> None:
        """Write all items that the channels have accepted, also those that come meanwhile."""
        while self._due:
            await self._write_due()

    async def _write_due(self) -> None:
        """Write the items of each channel that has some now. If the write of a channel fails, its items stay in memory,
        and the archive tries again a second later. The other channels do not wait for it.
        """
        waiting = deque(self._due)
        while waiting:
            if waiting[0] in self._due and not waiting[0].begin():
                await asyncio.sleep(0)
                continue
            recorder = waiting.popleft()
            on_written = self._due.pop(recorder, None)  # None: the host has given the channel up meanwhile
            if on_written is not None and (job := recorder.take()).parts:
                await self._write(recorder, on_written, job)

    async def _write(self, recorder: ChannelRecorder, on_written: Callable[[], None], job: WriteJob) -> None:
        loop = asyncio.get_running_loop()
        try:
            segments = await loop.run_in_executor(self._writer, job.files.write, job.parts, job.limits)
        except OSError as error:
            self._note_failure(recorder, error)
            loop.call_later(RETRY_SECONDS, self._write_later, recorder, on_written)
            return
        self._note_success(recorder)
        recorder.written(job, segments)
        if recorder.backlog_items:
            self._write_later(recorder, on_written)
        on_written()

    def _write_later(self, recorder: ChannelRecorder, on_written: Callable[[], None]) -> None:
        if not recorder.is_stopped:
            self._due.setdefault(recorder, on_written)
            if recorder.fills_a_write:
                self._hurry.set()
            self._wakeup.set()

    def _note_failure(self, recorder: ChannelRecorder, error: OSError) -> None:
        if not self._failing:
            logger.error(
                "the archive cannot be written; items stay in memory as long as max_bytes allows",
                extra={"event": "archive_failed", "folder": str(self.folder.path), "why": error.strerror or str(error)},
            )
        why = error.strerror or str(error)
        if not recorder.is_stopped:
            self._failing[recorder] = why
        recorder.note_end(why)

    def _note_success(self, recorder: ChannelRecorder) -> None:
        if self._failing.pop(recorder, None) and not self._failing:
            logger.warning(
                "the archive is written again", extra={"event": "archive_recovered", "folder": str(self.folder.path)}
            )

    def _make_room(self) -> None:
        """Delete outdated files, because the limit of the disk has refused a write. At most once in RETRY_SECONDS."""
        if self._making_room is None or self._making_room.done():
            self._making_room = asyncio.create_task(self._delete_outdated(), name="archive-room")
            self._making_room.add_done_callback(log_defect)

    async def _delete_outdated(self) -> None:
        """Delete outdated files, and count the files again: an operator may have deleted some."""
        for recorder in [*self._recorders]:
            with suppress(OSError):  # the other channels may have files to delete, too
                recorder.keep(await self._in_writer(recorder.files.drop_outdated, recorder.limits, self.now()))
        with suppress(OSError):
            folders = await self._in_writer(self._folders)
            self.disk.update(folders, left_out={one.disk.channel_id for one in self._recorders})
        await asyncio.sleep(RETRY_SECONDS)

    def _folders(self) -> list[FoundFolder]:
        return [*self.folder.of_channels()]

    async def load(
        self, files: SegmentFiles, segments: tuple[Segment, ...], wanted: WantedWindow, past: PastArchive | None = None
    ) -> ArchiveWindow:
        """Load a window, in a thread unless it is short and in memory.

        Raises OSError, for example if the archive's limits have removed a segment.
        """
        found = files.load_at_hand(segments, wanted, self._decode, past)
        if found is not None:
            return found
        return await self.in_reader(files.load, segments, wanted, self._decode, _pause, past)

    async def past(self, files: SegmentFiles, segments: tuple[Segment, ...], as_of: int) -> PastArchive:
        """The segments as they were at an earlier instant. Looks at them in a thread. Raises OSError as `load`."""
        return await self.in_reader(files.past, segments, as_of, self._decode)

    async def load_part(
        self, files: SegmentFiles, segments: tuple[Segment, ...], missing: tuple[int, int], bytes_max: int
    ) -> ArchivedPart:
        """Load items in the order of their seqs, in a thread. Raises OSError as `load`."""
        return await self.in_reader(files.load_part, segments, missing, bytes_max, self._decode, _pause)

    async def in_reader(self, call: Callable[..., Result], *arguments: object) -> Result:
        """Call a function that reads files, in a thread. Raises OSError as `load`."""
        return await asyncio.get_running_loop().run_in_executor(self._readers, call, *arguments)

    async def finish(
        self, recorders: Sequence[ChannelRecorder], boot_incarnation: int = 0, seconds_max: float = CLOSE_SECONDS_MAX
    ) -> None:
        """Write the remaining items, and move the files to the object store.

        A folder with all items of its channel gets a note of this. See `ArchiveEnd.finish`.
        """
        self._is_closing = True
        if self._making_room is not None:
            self._making_room.cancel()
        await self._end.finish(recorders, boot_incarnation, seconds_max)

    async def close(self, recorders: Sequence[ChannelRecorder], boot_incarnation: int = 0) -> None:
        """Finish. After CLOSE_SECONDS_MAX, or a cancellation, ends the work, and lets other processes use the
        folder.
        """
        ends_s = time.monotonic() + CLOSE_SECONDS_MAX
        try:
            await self._end.waited(CLOSE_SECONDS_MAX)
            await self.finish(recorders, boot_incarnation, ends_s - time.monotonic())
        finally:
            if self._task is not None:
                self._task.cancel()
            self._end.cut()
            self._writer.shutdown(wait=False)
            self._readers.shutdown(wait=False)
            self.folder.close()

    async def _write_rest(self, recorders: Sequence[ChannelRecorder]) -> None:
        """Write the remaining items. A write that is under way ends first, so that its items are not written twice."""
        for recorder in recorders:
            if recorder.backlog_items and recorder not in self._due:
                self.touch(recorder, lambda: None)
        self._hurry.set()
        self._wakeup.set()
        if self._task is not None:
            await asyncio.wait([self._task])


def _pause() -> None:
    time.sleep(_PAUSE_SECONDS)
