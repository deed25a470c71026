"""The places of blocks that a host keeps between reads."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import pytest

from stampede_rt_channel_host.archive.kept_blocks import FoundBlocks, KeptBlocks
from stampede_rt_channel_host.archive.segment_files import ArchiveLimits, SegmentFiles
from stampede_rt_channel_host.core.archive import (
    ArchivedRun,
    ArchiveWindow,
    PlacedBlock,
    Segment,
    SegmentBlocks,
    WantedItems,
    WantedWindow,
)
from stampede_rt_channel_host.core.channel import FIRST_KEY, Run, make_run
from stampede_rt_channel_host.core.channel.item_keys import LAST_KEY, SEQ_END

ALL = WantedWindow(WantedItems(FIRST_KEY[0], LAST_KEY, 0, 2**30), FIRST_KEY, LAST_KEY)


def run_at(seq: int) -> Run:
    return make_run(seq, [seq], None, [7], b"%d" % seq)


def decode(body: bytes) -> Run:
    return run_at(int(body))


def test_the_cache_of_blocks_keeps_the_blocks_used_last_within_its_limit(tmp_path: Path) -> None:
    kept = KeptBlocks(bytes_max=20_000)
    files = SegmentFiles(tmp_path, {}, kept)
    files.open(1)
    segments = files.write([[ArchivedRun(1, run_at(1))]], ArchiveLimits(None, None))
    files.load(segments, ALL, decode, lambda: None)
    [number] = [one.number for one in segments]
    [*_, block] = kept.get(files, number).blocks
    for channel in range(100):
        kept.keep(channel, 1, FoundBlocks(block.end, SegmentBlocks([block])))
        assert kept.get(files, number).length == segments[0].length
    assert kept.bytes <= 20_000
    assert kept.get(0, 1).length == 0
    assert kept.get(99, 1).length == block.end


def test_a_read_of_a_file_that_has_grown_looks_only_at_its_new_blocks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    files = SegmentFiles(tmp_path, {})
    files.open(1)
    begun: list[int] = []
    blocks = files.place.blocks

    def noted(segment: Segment, begin: int = 0) -> Sequence[PlacedBlock]:
        begun.append(begin)
        return blocks(segment, begin)

    monkeypatch.setattr(files.place, "blocks", noted)
    first: tuple[Segment, ...] = ()
    lengths = [0]
    for number in range(1, 4):
        segments = files.write([[ArchivedRun(number, run_at(number))]], ArchiveLimits(None, None))
        first = first or segments
        for _ in range(2):
            assert seqs(files, segments) == [*range(1, number + 1)]
        assert seqs(files, first) == [1], "a read that began before sees the file as it was"
        lengths.append(segments[-1].length)
    assert begun == lengths[:-1]


def seqs(files: SegmentFiles, segments: tuple[Segment, ...]) -> list[int]:
    return seqs_of(files.load(segments, ALL, decode, lambda: None))


def seqs_of(window: ArchiveWindow) -> list[int]:
    return [part.first_seq for part in window.items.slices(FIRST_KEY, LAST_KEY)]


def reads_without_wait(folder: Path) -> bool:
    """Whether the file system of the folder can refuse a read that waits for a disk. An overlay cannot."""
    (folder / "written").write_bytes(b"1")
    with (folder / "written").open("rb") as file:
        try:
            return os.preadv(file.fileno(), [bytearray(1)], 0, os.RWF_NOWAIT) == 1
        except OSError:
            return False


def test_only_a_short_window_in_memory_is_read_without_a_thread(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    files = SegmentFiles(tmp_path, {})
    files.open(1)
    for number in range(1, 31):
        segments = files.write([[ArchivedRun(number, run_at(number))]], ArchiveLimits(None, None))
    one = WantedWindow(WantedItems(5, (5, SEQ_END), 0, 2**18), FIRST_KEY, LAST_KEY)
    assert files.load_at_hand(segments, one, decode) is None, "no read has found the blocks yet"
    expected = files.load(segments, one, decode, lambda: None)
    found = files.load_at_hand(segments, one, decode)
    if not reads_without_wait(tmp_path):
        assert found is None, "a read of a file system that cannot refuse to wait needs a thread"
        return
    assert found is not None
    assert seqs_of(found) == seqs_of(expected) == [4, 5]
    assert files.load_at_hand(segments, ALL, decode) is None, "the read needs 30 blocks"

    def away(*_: object) -> int:
        raise BlockingIOError

    monkeypatch.setattr("stampede_rt_channel_host.archive.segment_folder.os.preadv", away)
    assert files.load_at_hand(segments, one, decode) is None
