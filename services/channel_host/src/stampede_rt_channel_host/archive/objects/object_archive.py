"""The object store of a host's archive, with its cache and the mover of segments."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from typing import NamedTuple

from stampede_rt_channel_host.archive.archive_folder import ArchiveFolder
from stampede_rt_channel_host.archive.kept_blocks import KeptBlocks
from stampede_rt_channel_host.archive.objects.chunk_cache import ChunkCache
from stampede_rt_channel_host.archive.objects.guarded_store import GuardedStore
from stampede_rt_channel_host.archive.objects.leftovers import Leftovers
from stampede_rt_channel_host.archive.objects.moving_files import MovingFiles
from stampede_rt_channel_host.archive.objects.segment_mover import SegmentMover
from stampede_rt_channel_host.archive.objects.segment_store import LaterOwner, SegmentStore
from stampede_rt_channel_host.archive.objects.stored_segments import StoredSegments
from stampede_rt_channel_host.archive.segment_files import OpenedArchive
from stampede_rt_channel_host.core.archive import CutRun
from stampede_rt_channel_host.core.archive.stored_segment import StoredSegment
from stampede_rt_channel_host.core.records import RecordedChannel

LISTING_SECONDS_MAX = 3.0
"""If a listing takes longer and the disk has a list of the objects, the host opens the files with this list. The mover
lists the store later.
"""
UNKNOWN_SECONDS_MAX = 4.0
"""The time in seconds that the host waits longer for a listing if the disk has no list.

Both waits fit into a call of a client, because the wait begins again if the call ends.
"""


class ObjectSettings(NamedTuple):
    """The store, the most bytes of the cache on disk, and after how many seconds an open file is closed."""

    store: SegmentStore
    cache_bytes_max: int
    move_after_seconds: int


class ObjectArchive:
    """The part of an archive that is in an object store. `folder`: the open folder of the archive."""

    def __init__(self, settings: ObjectSettings, folder: ArchiveFolder, cut: CutRun, now: Callable[[], int]) -> None:
        """Blocks its thread. Raises OSError."""
        self.store = GuardedStore(settings.store)
        self._folder, self._cut = folder, cut
        self._cache = ChunkCache(self.store, folder.path / "cache", settings.cache_bytes_max)
        self._cache.open()
        leftovers = Leftovers(folder.channels, self.store, lambda channel_id: self.files_of(channel_id, {}))
        leftovers.look()
        close_after_nanos = settings.move_after_seconds * 10**9
        self.mover = SegmentMover(self.store, self._cache, leftovers, close_after_nanos, now)

    def files_of(self, channel_id: bytes, facts: dict[str, str | int], kept: KeptBlocks | None = None) -> MovingFiles:
        """The files of a channel, which the caller opens. `kept`: see `SegmentReads`."""
        path = self._folder.of_channel(channel_id)
        return MovingFiles(path, facts, StoredSegments(path, self._cache, self.store), self._cut, kept)

    async def open(
        self, files: MovingFiles, record: RecordedChannel, readers: Executor, writer: Executor, *, may_be_unknown: bool
    ) -> OpenedArchive:
        """Open the files of a channel. If the store is unreachable, uses the list of its objects on the disk.

        If the disk has no list either, opens the files without one, if they `may_be_unknown`. Otherwise raises OSError.
        """
        # before the listing: a leftover that moved during the listing would be neither in it nor on the disk
        self.mover.reopening(record.channel_id)
        try:
            found, files.is_listed = await self._found(files, record, readers, writer, may_be_unknown)
            loop = asyncio.get_running_loop()
            if found is None:
                return await loop.run_in_executor(writer, files.open_unknown, record.epoch, record.incarnation)
            return await loop.run_in_executor(writer, files.open_found, record.epoch, record.incarnation, found)
        except BaseException:
            self.mover.not_reopened(record.channel_id)
            raise

    async def _found(
        self, files: MovingFiles, record: RecordedChannel, readers: Executor, writer: Executor, may_be_unknown: bool
    ) -> tuple[Mapping[int, StoredSegment] | None, bool]:
        """The segments in the store, and whether they come from a listing of the store. None: they are not known now.

        Raises OSError.
        """
        loop = asyncio.get_running_loop()
        listing = loop.run_in_executor(readers, files.stored.find, record.epoch)
        listing.add_done_callback(_look)
        if not await _fails(listing, LISTING_SECONDS_MAX):
            return listing.result(), True
        known = await loop.run_in_executor(writer, files.known, record.epoch, record.incarnation)
        if known is not None or (may_be_unknown and await _fails(listing, UNKNOWN_SECONDS_MAX)):
            return known, False
        return await listing, True


async def _fails(listing: asyncio.Future[dict[int, StoredSegment]], seconds_max: float) -> bool:
    """Whether a listing fails, or takes longer than `seconds_max`. Raises LaterOwner."""
    await asyncio.wait({listing}, timeout=seconds_max)
    failure = listing.exception() if listing.done() else None
    if isinstance(failure, LaterOwner):
        raise failure
    return failure is not None or not listing.done()


def _look(listing: asyncio.Future[dict[int, StoredSegment]]) -> None:
    """Retrieve the error of a listing, because possibly no caller waits for it any more."""
    if not listing.cancelled():
        listing.exception()
