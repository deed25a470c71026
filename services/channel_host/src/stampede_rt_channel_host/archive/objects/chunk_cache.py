"""Keeps the most recently read parts of objects on the disk of the host, up to a limit in bytes. Its methods block."""

from __future__ import annotations

import os
import shutil
from collections import OrderedDict
from contextlib import suppress
from pathlib import Path
from threading import Lock

from stampede_rt_channel_host.archive.objects.segment_store import SegmentStore
from stampede_rt_channel_host.archive.stable_writes import make_folder

CHUNK_BYTES = 2**20
Place = tuple[str, int]  # an object's name, and the number of the chunk


class ChunkCache:
    """Reads objects of a store in chunks, and keeps the chunks in a folder. Any thread may use it.

    The folder begins empty: `open` deletes the chunks of a former process. If the disk does not take a chunk, the cache
    does not keep it.
    """

    def __init__(self, store: SegmentStore, folder: Path, bytes_max: int) -> None:
        self.used_bytes = 0
        self.fetched_bytes = 0
        """The bytes that came from the store since the start."""
        self._store, self._folder, self._bytes_max = store, folder, bytes_max
        self._lock = Lock()
        self._kept: OrderedDict[Place, tuple[Path, int]] = OrderedDict()  # the file and its bytes, the latest read last
        self._files = 0

    def open(self) -> None:
        """Make the folder. Raises OSError if it cannot be written."""
        shutil.rmtree(self._folder, ignore_errors=True)
        make_folder(self._folder)

    def read(self, name: str, offset: int, size: int) -> bytes:
        """Bytes of an object; fewer at its end. Raises StoreError, and FileNotFoundError if there is no such object."""
        parts, end = [], offset + size
        for number in range(offset // CHUNK_BYTES, (end + CHUNK_BYTES - 1) // CHUNK_BYTES):
            begin = max(0, offset - number * CHUNK_BYTES)
            parts.append(self._part((name, number), begin, min(CHUNK_BYTES, end - number * CHUNK_BYTES) - begin))
        return parts[0] if len(parts) == 1 else b"".join(parts)

    def forget(self, name: str, offset: int, size: int) -> None:
        """Drop some bytes of an object from the cache, because they were damaged. The store may still have them
        undamaged.
        """
        for number in range(offset // CHUNK_BYTES, (offset + size) // CHUNK_BYTES + 1):
            self._drop((name, number))

    def _part(self, place: Place, begin: int, size: int) -> bytes:
        """Bytes of a chunk; fewer at its end."""
        with self._lock:
            kept = self._kept.get(place)
            if kept is not None:
                self._kept.move_to_end(place)
        if kept is not None:
            with suppress(OSError), kept[0].open("rb", buffering=0) as file:
                if os.fstat(file.fileno()).st_size == kept[1]:
                    return os.pread(file.fileno(), size, begin)
        fetched = self._store.read(place[0], place[1] * CHUNK_BYTES, CHUNK_BYTES)
        self._keep(place, fetched)
        return fetched[begin : begin + size]

    def _keep(self, place: Place, chunk: bytes) -> None:
        with self._lock:
            self.fetched_bytes += len(chunk)
            self._files += 1
            path = self._folder / f"{self._files}.chunk"
        if len(chunk) > self._bytes_max:
            return
        try:
            path.write_bytes(chunk)
        except OSError:  # a full disk
            path.unlink(missing_ok=True)
            return
        for former in self._add(place, path, len(chunk)):
            former.unlink(missing_ok=True)

    def _add(self, place: Place, path: Path, size: int) -> list[Path]:
        """Keep a chunk. Returns the files that leave the cache for this chunk. One of them may be of the same chunk,
        because another thread may have fetched it meanwhile.
        """
        with self._lock:
            gone = [self._kept.pop(place)] if place in self._kept else []
            self._kept[place] = path, size
            self.used_bytes += size - sum(one for _, one in gone)
            while self.used_bytes > self._bytes_max:
                _, oldest = self._kept.popitem(last=False)
                self.used_bytes -= oldest[1]
                gone.append(oldest)
        return [one for one, _ in gone]

    def _drop(self, place: Place) -> None:
        with self._lock:
            path, size = self._kept.pop(place, (None, 0))
            self.used_bytes -= size
        if path is not None:
            path.unlink(missing_ok=True)
