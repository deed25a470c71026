"""The last work of an archive whose host stops: the last writes, the notes of a clean stop, the last moves."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable, Sequence
from typing import Protocol

from stampede_rt.values.seq_starts import given_between
from stampede_rt_channel_host.archive.archive_folder import ArchiveFolder
from stampede_rt_channel_host.archive.objects.segment_mover import SegmentMover
from stampede_rt_channel_host.archive.recorder import ChannelRecorder

logger = logging.getLogger(__name__)


class WriterCall(Protocol):
    """A function that performs a call in the thread of the writes."""

    def __call__(self, call: Callable[..., None], *arguments: object) -> Awaitable[None]:
        """Return the result of the call."""
        ...


class ArchiveEnd:
    """`finish` does the work, `cut` ends it.

    `write` writes the items that the channels have accepted. `note_failure` gets the errors of files. `mover` moves the
    files to the object store; None: there is no object store.
    """

    def __init__(
        self,
        folder: ArchiveFolder,
        in_writer: WriterCall,
        write: Callable[[Sequence[ChannelRecorder]], Awaitable[None]],
        note_failure: Callable[[ChannelRecorder, OSError], None],
        mover: SegmentMover | None,
    ) -> None:
        self._folder, self._in_writer, self._write, self._note_failure = folder, in_writer, write, note_failure
        self._mover = mover
        self._work: asyncio.Task[None] | None = None
        self._recorders: Sequence[ChannelRecorder] = ()  # the recorders of the last work
        self._closed: set[ChannelRecorder] = set()  # recorders whose folders have the note of a clean stop
        self._noted = 0  # the boot incarnation in the folder of the host

    async def finish(self, recorders: Sequence[ChannelRecorder], boot_incarnation: int, seconds_max: float) -> None:
        """Do the work, or the part that an earlier call has left. After `seconds_max` the work goes on without the
        caller.

        Call it when the channels no longer accept anything. If the folders of all `recorders` have all items, this
        method also notes the `boot_incarnation` of the host, unless that is 0.
        """
        if self._work is None or self._work.done():
            self._recorders = recorders
            self._work = asyncio.create_task(self._finish(recorders, boot_incarnation), name="archive-end")
            self._work.add_done_callback(_log_defect)
        await asyncio.wait([self._work], timeout=max(0.0, seconds_max))

    async def waited(self, seconds_max: float) -> None:
        """Wait for the work of an earlier call of `finish`, `seconds_max` at most."""
        if self._work is not None:
            await asyncio.wait([self._work], timeout=seconds_max)

    def cut(self) -> None:
        """End the work. Logs the items that the archive lacks, because the time is over or the disk fails."""
        if self._work is not None:
            self._work.cancel()
        lacking = [one for one in self._recorders if one.backlog_items]
        if lacking:
            items = sum(given_between(one.archived_to, one.archived_to + one.backlog_items) for one in lacking)
            why = next((one.failure for one in lacking if one.failure), "the disk is too slow")
            logger.error(
                "the host stops, and its archive lacks %d accepted items of %d channels: %s", items, len(lacking), why,
                extra={"event": "archive_cut_short", "items": items, "channels": len(lacking), "why": why},
            )  # fmt: skip
        if self._mover is not None:
            self._mover.close()

    async def _finish(self, recorders: Sequence[ChannelRecorder], boot_incarnation: int) -> None:
        await self._write(recorders)
        await self._close_files(recorders)
        if boot_incarnation:
            await self._note_stop(boot_incarnation if all(one.has_all_items for one in recorders) else 0)
        if self._mover is not None:
            await self._mover.finish()

    async def _close_files(self, recorders: Sequence[ChannelRecorder]) -> None:
        for recorder in recorders:
            if recorder in self._closed and recorder.has_all_items:
                continue
            stop = recorder.clean_stop()
            try:
                await self._in_writer(recorder.files.close, stop)
            except OSError as error:
                self._note_failure(recorder, error)
                continue
            if stop is not None:
                self._closed.add(recorder)

    async def _note_stop(self, boot_incarnation: int) -> None:
        """Note the boot incarnation of this process, which has archived everything. 0 takes back an earlier note."""
        if boot_incarnation == self._noted:
            return
        try:
            await self._in_writer(self._folder.note_stop, boot_incarnation)
            self._noted = boot_incarnation
        except OSError as error:
            logger.error(
                "the host cannot note that its archive has all items; its recorded channels get new incarnations",
                extra={"event": "archive_stop_unnoted", "folder": str(self._folder.path), "why": error.strerror},
            )


def _log_defect(task: asyncio.Task[None]) -> None:
    if not task.cancelled() and (failure := task.exception()) is not None:
        logger.error(
            "a task of the host ended with a defect",
            exc_info=failure,
            extra={"event": "task_defect", "task": task.get_name()},
        )
