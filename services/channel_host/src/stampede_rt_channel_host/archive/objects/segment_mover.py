"""Moves the closed segments of recorded channels to an object store, on the event loop, with work in threads."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable, Mapping
from concurrent.futures import Executor
from typing import NamedTuple, TypeVar

from stampede_rt_channel_host.archive.objects.chunk_cache import ChunkCache
from stampede_rt_channel_host.archive.objects.leftovers import Leftovers
from stampede_rt_channel_host.archive.objects.listing_schedule import ListingSchedule
from stampede_rt_channel_host.archive.objects.moving_files import MovingFiles
from stampede_rt_channel_host.archive.objects.segment_store import SegmentStore, StoreError
from stampede_rt_channel_host.archive.objects.stored_segments import PackedSegment
from stampede_rt_channel_host.archive.recorder import ChannelRecorder
from stampede_rt_channel_host.archive.segment_files import ArchiveLimits
from stampede_rt_channel_host.archive.task_defects import log_defect
from stampede_rt_channel_host.core.archive import Segment
from stampede_rt_runtime.working_threads import WorkingThreads

logger = logging.getLogger(__name__)
Result = TypeVar("Result")

LOOK_SECONDS_MIN, LOOK_SECONDS_MAX = 0.05, 5.0
BACK_OFF_SECONDS_MIN, BACK_OFF_SECONDS_MAX = 1.0, 60.0
OBJECTS_PER_DELETION = 100
UPLOAD_SECONDS_LEAST, UPLOAD_BYTES_PER_SECOND = 30.0, 10**5  # a slower upload has failed
STOP_TEXT = b"Stampede RT: the owner of the channel stopped, and the archive has all of its items.\n"
STOPS_IN_PARALLEL = 8  # objects that report clean stops
LOOKS_PER_DROP = 12  # after this many looks, outdated segments of idle channels leave the archive


class MovedCounts(NamedTuple):
    """The objects of the channels that this host records, and the events since the start.

    `waiting_bytes`: in closed segments that have not moved yet. `moved_bytes` and `failures` count since the start.
    """

    objects: int
    bytes: int
    waiting_bytes: int
    moved_bytes: int
    failures: int
    cache_bytes: int
    fetched_bytes: int


class SegmentMover:
    """Moves one segment at a time. While the store fails, tries again after 1 to 60 s; the files stay in their folders.

    A segment goes through three steps: `pack` reads its file, `create`
    makes the object, and `settle` notes it and deletes the file. A host that is killed between two of them moves it
    again, and finds the object.
    """

    def __init__(
        self,
        store: SegmentStore,
        cache: ChunkCache,
        leftovers: Leftovers,
        close_after_nanos: int,
        now: Callable[[], int],
    ) -> None:
        """`close_after_nanos`: the age at which the mover closes an open segment."""
        self.store, self.cache = store, cache
        self.failure = ""
        """Why the last call of the store failed; empty: it succeeded."""
        self._leftovers, self._close_after_nanos, self._now = leftovers, close_after_nanos, now
        self._recorders: dict[MovingFiles, ChannelRecorder] = {}
        # the files of channels that are not recorded here any more, and whether a look has found their waiting segments
        self._leaving: dict[MovingFiles, bool] = {}
        self._listings = ListingSchedule()
        self._store_fails = False
        self._moved_bytes = self._failures = self._looks = 0
        self._threads = WorkingThreads(1, "archive-mover")
        self.writer: Executor = self._threads
        """The thread of the archive's writes, the only thread that changes files."""
        self._task: asyncio.Task[None] | None = None
        self._wake = asyncio.Event()
        self._reported: set[str] = set()  # the objects that report clean stops
        self._moving = asyncio.Lock()  # held during the moves

    def start(self) -> None:
        """Begin to move segments. Idempotent."""
        if self._task is None:
            self._task = asyncio.create_task(self._run(), name="archive-mover")
            self._task.add_done_callback(log_defect)

    def record(self, recorder: ChannelRecorder) -> None:
        """Move the closed segments of a channel that this host records."""
        if isinstance(recorder.files, MovingFiles):
            self._recorders[recorder.files] = recorder
            if not recorder.files.is_listed:
                self._listings.expect(recorder.files, is_former=False)
                self._wake.set()

    def own(self, epochs: Mapping[bytes, int]) -> None:
        """Note the channels that the host owns now, by their ids, with their epochs."""
        self._leftovers.own(epochs)

    def expect_former(self, recorder: ChannelRecorder) -> None:
        """Note that a channel has moved here, and that its former owner still moves its last files to the store."""
        if isinstance(recorder.files, MovingFiles):
            recorder.former.expect()
            self._listings.expect(recorder.files)
            self._note_former(recorder, recorder.files)
            self._wake.set()

    def forget(self, recorder: ChannelRecorder) -> None:
        """Note that the host no longer records the channel. Its closed segments still move to the store."""
        if isinstance(recorder.files, MovingFiles) and self._recorders.pop(recorder.files, None) is not None:
            self._listings.forget(recorder.files)
            recorder.files.is_given_up = True
            self._leaving[recorder.files] = False
            self._wake.set()

    def reopening(self, channel_id: bytes) -> None:
        """Note that another `MovingFiles` opens the folder of a channel now."""
        self._leftovers.take(channel_id)
        for files in [one for one in self._leaving if one.stored.channel_id == channel_id]:
            files.is_left = True
            del self._leaving[files]

    def not_reopened(self, channel_id: bytes) -> None:
        """Note that the folder could not be opened. Its closed files still move to the store."""
        self._leftovers.give_back(channel_id)
        self._wake.set()

    def delete(self, channel_id: bytes) -> None:
        """Delete the files and objects of a deleted channel, now or after the next start of the host."""
        for files in (*self._recorders, *self._leaving):
            if files.stored.channel_id == channel_id:
                files.is_left = True
        self.reopening(channel_id)
        self._leftovers.condemn(channel_id)
        self._wake.set()

    def counts(self) -> MovedCounts:
        """The numbers for the metrics."""
        places = [one.stored for one in self._recorders]
        waiting = sum(one.length for files in (*self._recorders, *self._leaving) for one in files.waiting)
        return MovedCounts(
            sum(one.stored_objects for one in places), sum(one.stored_bytes for one in places), waiting,
            self._moved_bytes, self._failures, self.cache.used_bytes, self.cache.fetched_bytes,
        )  # fmt: skip

    async def _run(self) -> None:
        back_off = BACK_OFF_SECONDS_MIN
        while True:
            async with self._moving:
                failure = await self.move_all()
            self._note(failure)
            wait_s, back_off = self._pause(failure, back_off)
            try:
                async with asyncio.timeout(wait_s):
                    await self._wake.wait()
            except TimeoutError:
                pass
            self._wake.clear()
            if failure:
                await asyncio.sleep(BACK_OFF_SECONDS_MIN)

    def _pause(self, failure: str, back_off: float) -> tuple[float, float]:
        """The waits in seconds before the next look, and after the next failure."""
        if failure:
            return back_off, min(2 * back_off, BACK_OFF_SECONDS_MAX)
        look_s = min(LOOK_SECONDS_MAX, self._close_after_nanos / 4e9, self._listings.due_s())
        return max(LOOK_SECONDS_MIN, look_s), BACK_OFF_SECONDS_MIN

    def _note(self, failure: str) -> None:
        if failure and not self.failure:
            logger.error(
                "the object store of the archive fails; closed files stay on the disk of the host",
                extra={"event": "archive_store_failed", "why": failure},
            )
        if self.failure and not failure:
            logger.warning("the object store of the archive works again", extra={"event": "archive_store_recovered"})
        self._failures += bool(failure)
        self.failure = failure

    async def move_all(self) -> str:
        """Do all work that is due now. Returns the reason of a failure, or an empty text."""
        self._store_fails = False
        if self.failure:  # a look without work would not notice that the store fails
            self._listings.hurry()
        failures = [await self._tried(self._look())]
        for files in (*self._recorders, *self._leaving):
            failures.append(await self._tried(self._move_waiting(files)))
            if self._store_fails:  # the other calls would fail, too, perhaps after a long wait
                break
            if self._leftovers_done(files):
                failures.append(await self._tried(self.in_writer(files.leave)))
                self._leaving.pop(files, None)
        for files in self._listings.take_due():
            failures.append(await self._tried(self._find_again(files)))
        failures.append(await self._tried(self._leftovers.delete_condemned(self.in_thread)))
        return next((one for one in failures if one), "")

    async def _move_waiting(self, files: MovingFiles) -> None:
        for segment in files.waiting:
            await self._move(files, segment)
        await self._delete_outdated(files)

    def _leftovers_done(self, files: MovingFiles) -> bool:
        return self._leaving.get(files, False) and (files.is_left or not (files.waiting or files.stored.has_outdated))

    async def _tried(self, work: Awaitable[None]) -> str:
        try:
            await work
        except OSError as error:
            self._store_fails = self._store_fails or isinstance(error, StoreError)
            return error.strerror or str(error)
        return ""

    async def _look(self) -> None:
        self._looks += 1
        drops = self._looks % LOOKS_PER_DROP == 0
        recorders, leaving = [*self._recorders.items()], [*self._leaving]

        def look() -> list[OSError]:
            failures = [
                _failed(one, self._now(), self._close_after_nanos, of.limits if drops else None)
                for one, of in recorders
            ]
            return [one for one in (*failures, *(_failed(files, self._now(), 0, None) for files in leaving)) if one]

        failures = await self.in_writer(look)
        opened = await self.in_writer(self._leftovers.open_next)
        for files, recorder in recorders if drops else ():
            recorder.keep(files.segments)
        for files in leaving:
            if files in self._leaving:
                self._leaving[files] = True
        for files in opened:
            if not self._leftovers.is_taken(files.stored.channel_id):  # the channel may have been opened meanwhile
                self._leaving[files] = True
                self._wake.set()
        for failure in failures:
            raise failure

    async def _move(self, files: MovingFiles, segment: Segment) -> None:
        """Move one segment. Raises OSError."""
        if files.is_left:
            return
        packed = await self.in_thread(lambda: files.stored.pack(segment))
        if not await self._create(packed):
            await self.in_thread(lambda: files.check_same(packed))
        segments = await self.in_writer(lambda: files.settle(packed))
        self._moved_bytes += segment.length
        files.waiting = tuple(one for one in files.waiting if one.number != segment.number)
        recorder = self._recorders.get(files)
        if recorder is not None:
            recorder.keep(segments)

    async def _create(self, packed: PackedSegment) -> bool:
        """Make the object of a segment. Raises StoreError, also if this takes too long for its size."""
        seconds_max = UPLOAD_SECONDS_LEAST + len(packed.content) / UPLOAD_BYTES_PER_SECOND
        try:
            async with asyncio.timeout(seconds_max):
                return await self.store.create(packed.name, packed.content)
        except TimeoutError:
            url = self.store.url
            raise StoreError(f"the object store {url} has not taken an object in {seconds_max:.0f} s") from None

    async def _find_again(self, files: MovingFiles) -> None:
        """Look for files of the former owner. Raises OSError."""
        epoch = files.epoch
        local = (one.begin for one in files.segments if not files.stored.is_stored(one.number))
        following = next(local, None)
        found = await self.in_thread(lambda: files.stored.find(epoch, following))
        recorder = self._recorders.get(files)
        if recorder is None:  # the host has given the channel up meanwhile
            return
        archived_to = recorder.archived_to
        recorder.keep(await self.in_writer(lambda: files.find_again(found, archived_to)))
        self._listings.note_listed(files, lacks_items=files.lacks_items(archived_to))
        self._note_former(recorder, files)
        recorder.on_listed(files.former_stop)

    def _note_former(self, recorder: ChannelRecorder, files: MovingFiles) -> None:
        """Let readers of the archive go on, if it has the last files of the former owner."""
        if recorder.moved_items is None and not files.lacks_former(recorder.archived_to):
            recorder.former.note_complete()

    async def _delete_outdated(self, files: MovingFiles) -> None:
        names = files.stored.outdated[:OBJECTS_PER_DELETION]
        if names and not files.is_left:
            await self.in_thread(lambda: self.store.delete(names))
            del files.stored.outdated[: len(names)]
        elif files.stored.has_more_outdated and not files.is_left:
            await self.in_thread(files.stored.find_outdated)

    async def _note_stops(self) -> None:
        """Make an object for each channel that has stopped cleanly, unless the store fails. Raises OSError."""
        if self._store_fails:
            return
        served = [name for files in self._recorders if (name := await self.in_writer(files.name_of_stop)) is not None]
        stops: dict[str, Callable[[], None]] = dict.fromkeys(served, _nothing)
        stops.update(await self.in_writer(self._leftovers.stops))
        unreported_stops = [one for one in stops.items() if one[0] not in self._reported]
        for at in range(0, len(unreported_stops), STOPS_IN_PARALLEL):
            some = unreported_stops[at : at + STOPS_IN_PARALLEL]
            ends = await asyncio.gather(*(self._note_stop(*one) for one in some), return_exceptions=True)
            for failure in (one for one in ends if isinstance(one, BaseException)):
                raise failure

    async def _note_stop(self, name: str, then: Callable[[], None]) -> None:
        """Make the object of a clean stop, and then call `then` in the thread of the writes. Raises OSError."""
        await self.store.create(name, STOP_TEXT)
        self._reported.add(name)
        await self.in_writer(then)

    async def in_thread(self, call: Callable[[], Result]) -> Result:
        """Have a thread ask the store."""
        return await asyncio.get_running_loop().run_in_executor(self._threads, call)

    async def in_writer(self, call: Callable[[], Result]) -> Result:
        """Have the thread of writes do something with the files."""
        return await asyncio.get_running_loop().run_in_executor(self.writer, call)

    async def finish(self) -> None:
        """Move the closed segments, and tell the next owners about clean stops, because the host stops.

        A move that is under way ends first. From now on files move only when `finish` or `move_all` is called again.
        """
        async with self._moving:
            if self._task is not None:
                self._task.cancel()
            failure = await self.move_all()
            self._note(failure or await self._tried(self._note_stops()))

    def close(self) -> None:
        """End the moves. Logs if closed files have not moved."""
        if self._task is not None:
            self._task.cancel()
        if any(files.waiting and not files.is_left for files in (*self._recorders, *self._leaving)):
            logger.warning("closed files of the archive stay on the disk", extra={"event": "archive_store_unfinished"})
        self._threads.shutdown(wait=False)


def _failed(files: MovingFiles, now: int, close_after_nanos: int, limits: ArchiveLimits | None) -> OSError | None:
    """Look at the files of a channel. Returns the error: the look at the other channels goes on."""
    try:
        files.look(now, close_after_nanos, limits)
    except OSError as error:
        return error
    return None


def _nothing() -> None:
    """Does nothing, because the note of a stop is on the disk already."""
