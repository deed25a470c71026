"""The object store of a host's archive, with its cache and the mover of segments."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from stampede_rt_channel_host.archive.archive_folder import ArchiveFolder
from stampede_rt_channel_host.archive.kept_blocks import KeptBlocks
from stampede_rt_channel_host.archive.objects.chunk_cache import ChunkCache
from stampede_rt_channel_host.archive.objects.leftovers import Leftovers
from stampede_rt_channel_host.archive.objects.moving_files import MovingFiles
from stampede_rt_channel_host.archive.objects.segment_mover import SegmentMover
from stampede_rt_channel_host.archive.objects.segment_store import SegmentStore
from stampede_rt_channel_host.archive.objects.stored_segments import StoredSegments
from stampede_rt_channel_host.core.archive import CutRun


class ObjectSettings(NamedTuple):
    """The store, the most bytes of the cache on disk, and after how many seconds an open file is closed."""

    store: SegmentStore
    cache_bytes_max: int
    move_after_seconds: int


class ObjectArchive:
    """The part of an archive that is in an object store. `folder`: the open folder of the archive."""

    def __init__(self, settings: ObjectSettings, folder: ArchiveFolder, cut: CutRun, now: Callable[[], int]) -> None:
        """Blocks. Raises OSError."""
        self.store = settings.store
        self._folder, self._cut = folder, cut
        self._cache = ChunkCache(settings.store, folder.path / "cache", settings.cache_bytes_max)
        self._cache.open()
        leftovers = Leftovers(folder.channels, settings.store, lambda channel_id: self.files_of(channel_id, {}))
        leftovers.look()
        seal_nanos = settings.move_after_seconds * 10**9
        self.mover = SegmentMover(settings.store, self._cache, leftovers, seal_nanos, now)

    def files_of(self, channel_id: bytes, facts: dict[str, str | int], kept: KeptBlocks | None = None) -> MovingFiles:
        """The files of a channel, which the caller opens. `kept`: see `SegmentReads`."""
        path = self._folder.of_channel(channel_id)
        return MovingFiles(path, facts, StoredSegments(path, self._cache, self.store), self._cut, kept)
