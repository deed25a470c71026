"""Reads over an archive in an object store, with a cache that is too small, give the answers of a channel in memory."""

from __future__ import annotations

import asyncio
import random
from dataclasses import dataclass
from pathlib import Path

import pytest

from stampede_rt.errors import StampedeError
from stampede_rt_channel_host.archive.objects import chunk_cache
from stampede_rt_channel_host.archive.objects.chunk_cache import ChunkCache
from stampede_rt_channel_host.archive.objects.stored_segments import StoredSegments
from stampede_rt_channel_host.core import archive
from stampede_rt_channel_host.core.archive import PlacedBlock, Segment, SegmentBlocks, archived_read
from stampede_rt_channel_host.core.archive.stored_segment import first_number
from tests.property.archived_channel import ArchivedChannel
from tests.property.test_archive_against_memory import put_in_both, query_of, shown
from tests.support.channel_host.object_stores import CHANNEL, FakeStore

SCENARIOS, READS = 60, 12
CACHE_BYTES = 600


@pytest.fixture(autouse=True)
def small_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Chunks shorter than a block, a cache of a few chunks, and windows of one block or a few blocks."""
    monkeypatch.setattr(chunk_cache, "CHUNK_BYTES", 64)
    monkeypatch.setattr(archived_read, "FIRST_WINDOW_BYTES", 1)
    monkeypatch.setattr(archived_read, "WINDOW_BYTES", 300)


@dataclass
class StoredArchive:
    """The files of an `ArchivedChannel`. Most of them are in a store, the others only in a folder."""

    channel: ArchivedChannel
    place: StoredSegments
    cache: ChunkCache
    store: FakeStore

    def move(self, draw: random.Random) -> None:
        """Write the files to the folder, and move most of them to the store."""
        for segment in self.channel.segments:
            numbered = segment._replace(number=first_number(1) + segment.number)
            self.place.file_of(numbered.number).write_bytes(self.channel.file(segment))
            if draw.random() < 0.8:
                packed = self.place.pack(numbered)
                assert asyncio.run(self.store.create(packed.name, packed.content))
                self.place.settle(packed)

    def blocks_of(self, segment: Segment) -> SegmentBlocks:
        return SegmentBlocks(self.place.blocks(segment._replace(number=first_number(1) + segment.number)))

    def content_of(self, segment: Segment, block: PlacedBlock) -> bytes:
        with self.place.opened(first_number(1) + segment.number) as read_at:
            return read_at(block.offset + archive.HEAD_BYTES, block.head.content_bytes)


@pytest.mark.parametrize("seed", range(SCENARIOS))
def test_a_read_over_an_object_store_equals_one_over_memory(seed: int, tmp_path: Path) -> None:
    draw = random.Random(seed)
    large, small, positions, now = put_in_both(draw)
    store = FakeStore()
    folder = tmp_path / CHANNEL.hex()
    folder.mkdir()
    cache = ChunkCache(store, tmp_path / "cache", CACHE_BYTES)
    cache.open()
    stored = StoredArchive(small, StoredSegments(folder, cache, store), cache, store)
    stored.move(draw)
    small.read_from(stored.blocks_of, stored.content_of)
    for _ in range(READS):
        query = query_of(draw, now, positions)
        overlap = large.policy.overlap_nanos or 0
        try:
            expected = large.read(query, now)
        except StampedeError as error:
            with pytest.raises(type(error)):
                small.read(query)
            continue
        assert shown(small.read(query), overlap) == shown(expected, overlap), query
        assert cache.used_bytes <= CACHE_BYTES
