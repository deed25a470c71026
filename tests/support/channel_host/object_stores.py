"""An object store in memory that fails when a test says so, and channels whose closed segments move to a store."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from stampede_rt.wire.run_slices import slice_run
from stampede_rt_channel_host.archive.objects.chunk_cache import ChunkCache
from stampede_rt_channel_host.archive.objects.moving_files import MovingFiles
from stampede_rt_channel_host.archive.objects.segment_store import FoundObject, SegmentStore, StoreError
from stampede_rt_channel_host.archive.objects.stored_segments import StoredSegments
from stampede_rt_channel_host.core.archive import CutRun

CHANNEL = bytes(range(16))
PREFIX = f"channels/{CHANNEL.hex()}/"


class FakeStore:
    """Objects in a dictionary. `failure`: every call raises StoreError with this text. `calls` has all calls."""

    url = "memory:///"

    def __init__(self) -> None:
        self.objects: dict[str, bytes] = {}
        self.failure = ""
        self.calls: list[str] = []

    def _call(self, what: str) -> None:
        self.calls.append(what)
        if self.failure:
            raise StoreError(self.failure)

    async def create(self, name: str, content: bytes | bytearray) -> bool:
        self._call(f"create {name}")
        return self.objects.setdefault(name, held := bytes(content)) is held

    def read(self, name: str, offset: int, size: int) -> bytes:
        self._call(f"read {name}")
        if name not in self.objects:
            raise FileNotFoundError(name)
        return self.objects[name][offset : offset + size]

    def find(self, prefix: str) -> Iterator[FoundObject]:
        self._call(f"find {prefix}")
        found = sorted((name, len(content)) for name, content in self.objects.items() if name.startswith(prefix))
        yield from (FoundObject(*one) for one in found)

    def delete(self, names: Sequence[str]) -> None:
        self._call(f"delete {len(names)}")
        for name in names:
            self.objects.pop(name, None)


def moving_files(
    host: Path, store: SegmentStore, cut: CutRun = slice_run, *, cache_bytes_max: int = 2**24
) -> MovingFiles:
    """The files of CHANNEL at the host with this folder. The caller opens them (`opened_files`)."""
    cache = ChunkCache(store, host / "cache", cache_bytes_max)
    cache.open()
    folder = host / "channels" / CHANNEL.hex()
    return MovingFiles(folder, {}, StoredSegments(folder, cache, store), cut)


def opened_files(host: Path, store: SegmentStore, epoch: int, cut: CutRun = slice_run) -> MovingFiles:
    """The files of CHANNEL, opened as the host that owns the channel opens them."""
    files = moving_files(host, store, cut)
    files.open(epoch, stored=files.stored.adopt(files.stored.find(epoch)))
    return files


async def move(files: MovingFiles, store: SegmentStore, *, steps: int = 3) -> None:
    """Move all closed segments, or only the first `steps` steps of each move."""
    files.look(0, 2**62, None)
    for segment in files.waiting:
        packed = files.stored.pack(segment) if steps > 0 else None
        if packed is not None and steps > 1 and not await store.create(packed.name, packed.content):
            files.check_same(packed)
        if packed is not None and steps > 2:
            files.settle(packed)
