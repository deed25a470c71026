"""The cache of an object store on the disk, used by several threads at the same time."""

from __future__ import annotations

import asyncio
import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Barrier, Lock

import pytest

from stampede_rt_channel_host.archive.objects import chunk_cache
from stampede_rt_channel_host.archive.objects.chunk_cache import ChunkCache
from tests.support.channel_host.object_stores import FakeStore

THREADS, CHUNKS = 8, 40
CONTENT = bytes(range(100)) * 10


class YieldingLock:
    """A lock that lets other threads run after each release."""

    def __init__(self) -> None:
        self._lock = Lock()

    def __enter__(self) -> None:
        self._lock.acquire()

    def __exit__(self, *_: object) -> None:
        self._lock.release()
        os.sched_yield()


@pytest.mark.parametrize("bytes_max", [10**6, 500])
def test_threads_that_fetch_the_same_chunks_count_and_keep_each_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, bytes_max: int
) -> None:
    monkeypatch.setattr(chunk_cache, "CHUNK_BYTES", len(CONTENT) // CHUNKS)
    store, together = FakeStore(), Barrier(THREADS)
    asyncio.run(store.create("a", CONTENT))
    cache = ChunkCache(store, tmp_path / "cache", bytes_max)
    cache.open()
    monkeypatch.setattr(cache, "_lock", YieldingLock())

    def read_all() -> bytes:
        parts = []
        for offset in range(0, len(CONTENT), chunk_cache.CHUNK_BYTES):
            together.wait(30)
            parts.append(cache.read("a", offset, chunk_cache.CHUNK_BYTES))
        return b"".join(parts)

    with ThreadPoolExecutor(THREADS) as threads:
        found = [one.result() for one in [threads.submit(read_all) for _ in range(THREADS)]]
    assert found == [CONTENT] * THREADS
    kept = [path.stat().st_size for path in (tmp_path / "cache").iterdir()]
    assert sum(kept) == cache.used_bytes <= bytes_max
