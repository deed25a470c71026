"""How fast the archive of a host moves to an object store and back: `python -m tests.benchmarks.object_store`.

The store is a real S3 server (versitygw) on this machine. The table compares the host with obstore alone, in the same
run: obstore uploads the same objects, and reads them by ranges of the same size. Needs Go, or the built server. Takes
less than a minute.
"""

from __future__ import annotations

import argparse
import asyncio
import os
import random
import statistics
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import obstore

from stampede_rt.wire.run_slices import slice_run
from stampede_rt.wire.runs import encode_run, seal_run
from stampede_rt_channel_host.archive.objects.chunk_cache import CHUNK_BYTES, ChunkCache
from stampede_rt_channel_host.archive.objects.moving_files import MovingFiles
from stampede_rt_channel_host.archive.objects.opened_store import OpenedStore
from stampede_rt_channel_host.archive.objects.stored_segments import StoredSegments
from stampede_rt_channel_host.archive.segment_files import SEGMENT_BYTES, ArchiveLimits
from stampede_rt_channel_host.copies.messages import run_of
from stampede_rt_channel_host.core.archive import ArchivedRun, WantedItems, WantedWindow
from stampede_rt_channel_host.core.channel import FIRST_KEY
from stampede_rt_channel_host.core.channel.item_keys import LAST_KEY
from tests.benchmarks.archive_cost.figures import heading, ratios, row, seconds_of, spread
from tests.polyglot.toolchains import BuildFailed, Unavailable
from tests.support.channel_host.s3_server import BUCKET, S3Server, build

FRAME_BYTES, FRAMES_PER_WRITE, READ_BYTES = 300_000, 50, 2**20
EVERYTHING, LOOKS = ArchiveLimits(None, None), 50
CHANNEL = "00" * 16


class StoredFiles(NamedTuple):
    """The files of one channel, and the store and the cache behind them."""

    files: MovingFiles
    store: OpenedStore
    cache: ChunkCache


def stored_at(folder: Path, cache_bytes_max: int) -> StoredFiles:
    """A channel without files yet."""
    store = OpenedStore(f"s3://{BUCKET}/{folder.name}")
    cache = ChunkCache(store, folder / "cache", cache_bytes_max)
    cache.open()
    place = folder / CHANNEL
    files = MovingFiles(place, {}, StoredSegments(place, cache, store), slice_run)
    files.open_found(1, 1, {})
    return StoredFiles(files, store, cache)


def fill(files: MovingFiles, segments: int) -> int:
    """Write whole segments of frames. Returns the seq after the last frame."""
    payload, seq = os.urandom(FRAME_BYTES), 1
    while len(files.segments) < segments or files.segments[-1].length < SEGMENT_BYTES:
        runs = []
        for number in range(seq, seq + FRAMES_PER_WRITE):
            runs.append(ArchivedRun(number, run_of(seal_run(encode_run([payload], times=[number]), number))))
        files.write([runs], EVERYTHING)
        seq += FRAMES_PER_WRITE
    files.look(2**62, 0, None)
    return seq


async def move(stored: StoredFiles) -> None:
    """Move all closed segments, as the host does."""
    for segment in stored.files.waiting:
        packed = await asyncio.to_thread(stored.files.stored.pack, segment)
        assert await stored.store.create(packed.name, packed.content)
        await asyncio.to_thread(stored.files.settle, packed)


def read_all(files: MovingFiles, end_seq: int) -> None:
    """Read all frames in their order, as a subscription does."""
    seq = 1
    while seq < end_seq:
        seq = files.load_part(files.segments, (seq, end_seq), READ_BYTES, run_of, _do_not_rest).end_seq


def look_at(files: MovingFiles, instant: int) -> None:
    """Read the frame of an instant, as `at` does."""
    window = WantedItems(instant, (instant + 1, 0), 0, READ_BYTES // 4)
    files.load(files.segments, WantedWindow(window, FIRST_KEY, LAST_KEY), run_of, _do_not_rest)


class PlainObstore:
    """The same objects with obstore alone."""

    def __init__(self, names: list[str], size: int) -> None:
        self._store = OpenedStore(f"s3://{BUCKET}/plain")._writing
        self._names, self._content = names, os.urandom(size)
        self.bytes = size * len(names)

    async def upload(self) -> None:
        """Make the objects."""
        for name in self._names:
            await obstore.put_async(self._store, name, self._content, mode="create", use_multipart=False)

    def read(self) -> None:
        """Read the objects by ranges."""
        for name in self._names:
            for start in range(0, len(self._content), CHUNK_BYTES):
                length = min(CHUNK_BYTES, len(self._content) - start)
                bytes(obstore.get_range(self._store, name, start=start, length=length))

    def look(self) -> None:
        """Read one range."""
        start = random.randrange(len(self._content) - CHUNK_BYTES)
        bytes(obstore.get_range(self._store, random.choice(self._names), start=start, length=CHUNK_BYTES))

    def delete(self) -> None:
        """Delete the objects."""
        obstore.delete(self._store, self._names)


class Figures:
    """The rates of all rounds, in MB/s, and the times of single looks, in seconds."""

    def __init__(self) -> None:
        self.rates: dict[str, list[float]] = {}
        self.looks: dict[str, list[float]] = {}

    def rate(self, name: str, size: int, work: Callable[[], object]) -> None:
        """Note how fast some work moves `size` bytes."""
        self.rates.setdefault(name, []).append(size / seconds_of(work) / 1e6)

    def look(self, name: str, work: Callable[[], object]) -> None:
        """Note the times of LOOKS looks."""
        self.looks.setdefault(name, []).extend(seconds_of(work) for _ in range(LOOKS))


def one_round(folder: Path, segments: int, figures: Figures) -> None:
    """Upload and read, plain and as the host does."""
    stored = stored_at(folder, 2 * segments * SEGMENT_BYTES)
    end_seq = fill(stored.files, segments)
    size = sum(one.length for one in stored.files.segments)
    plain = PlainObstore([f"{number}" for number in range(segments)], size // segments)
    figures.rate("upload, obstore", plain.bytes, lambda: asyncio.run(plain.upload()))
    figures.rate("upload, host", size, lambda: asyncio.run(move(stored)))
    figures.rate("read, obstore", plain.bytes, plain.read)
    figures.rate("read, host", size, lambda: read_all(stored.files, end_seq))
    figures.rate("read again, host, from its cache", size, lambda: read_all(stored.files, end_seq))
    figures.look("one range of 1 MiB, obstore", plain.look)
    stored.cache.open()
    cold = stored_again(folder)
    figures.look("at(t), host", lambda: look_at(cold, random.randrange(1, end_seq)))
    plain.delete()


def stored_again(folder: Path) -> MovingFiles:
    """The files of a host that has started again, with a cache that keeps nothing."""
    stored = stored_at(folder, 0)
    stored.files.open_found(2, 1, stored.files.stored.find(2))
    return stored.files


def _do_not_rest() -> None:
    """Do nothing: no other work waits for a turn."""


def report(figures: Figures) -> None:
    """Print the tables."""
    heading("", "MB/s", "of obstore")
    for name, rates in figures.rates.items():
        peer = figures.rates[f"{name.partition(',')[0].removesuffix(' again')}, obstore"]
        row(name, spread(rates, ".0f"), ratios(rates, peer))
    heading("", "median", "p99")
    for name, times in figures.looks.items():
        worst = sorted(times)[int(len(times) * 0.99)]
        row(name, f"{statistics.median(times) * 1e3:.1f} ms", f"{worst * 1e3:.1f} ms")


def main() -> int:
    """Print the figures. Returns 2 if this machine has no S3 server."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.object_store", description=__doc__)
    parser.add_argument(
        "--folder", type=Path, help="a folder on the measured disk; default: the folder for temporary files"
    )
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--segments", type=int, default=4, help="the files of 64 MiB in each round")
    wanted = parser.parse_args()
    try:
        program = build()
    except (Unavailable, BuildFailed) as failure:
        print(f"cannot run: {failure}", file=sys.stderr)
        return 2
    print(f"load average at the start: {os.getloadavg()[0]:.1f}, {os.cpu_count()} processors")
    figures = Figures()
    with tempfile.TemporaryDirectory(dir=wanted.folder, prefix="object-store-") as name:
        server = S3Server(program, Path(name) / "s3")
        server.start()
        os.environ.update(server.environment)
        try:
            for number in range(wanted.rounds):
                one_round(Path(name) / f"round-{number}", wanted.segments, figures)
        finally:
            server.stop()
    report(figures)
    print(f"\nload average at the end: {os.getloadavg()[0]:.1f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
