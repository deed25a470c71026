"""Long writes of an archive: their system calls, the bytes that start for the disk early, and failures between them."""

from __future__ import annotations

import errno
import os
from collections.abc import Sequence
from pathlib import Path

import pytest

from stampede_rt_channel_host.archive.segment_files import GATHERED_BYTES
from stampede_rt_channel_host.archive.stable_writes import start_flush
from stampede_rt_channel_host.core.archive import ArchivedRun
from tests.unit.channel_host.archive.test_archive_files import NO_LIMITS, opened, run_at, seqs

FILES = "stampede_rt_channel_host.archive.segment_files"
LONG = b"x" * 300_000


def long_runs(first_seq: int, runs: int) -> list[ArchivedRun]:
    """Runs of two items, each of which fills a block."""
    return [ArchivedRun(1, run_at(first_seq + 2 * number, payload=LONG)) for number in range(runs)]


def test_the_blocks_of_a_write_share_few_system_calls_and_start_for_the_disk_before_the_fsync(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    files, _ = opened(tmp_path)
    calls: list[str] = []
    writev, fsync = os.writev, os.fsync

    def write_noted(file: int, buffers: Sequence[bytes]) -> int:
        calls.append("write")
        return writev(file, buffers)

    def flush_noted(file: int, begin: int, end: int) -> int:
        calls.append("start")
        return start_flush(file, begin, end)

    def sync_noted(file: int) -> None:
        calls.append("fsync")
        fsync(file)

    files.write([long_runs(1, 1)], NO_LIMITS)  # this write begins the segment
    with monkeypatch.context() as noted:
        noted.setattr(f"{FILES}.os.writev", write_noted)
        noted.setattr(f"{FILES}.start_flush", flush_noted)
        noted.setattr(f"{FILES}.os.fsync", sync_noted)
        segments = files.write([long_runs(3, 16)], NO_LIMITS)
    writes = -(-16 * len(LONG) // GATHERED_BYTES)
    assert calls == ["write", "start"] * writes + ["fsync"]
    assert seqs(files, segments) == [*range(1, 35)]
    assert segments[-1].length == sum(path.stat().st_size for path in tmp_path.glob("*.segment"))


def test_a_write_that_fails_between_two_of_its_system_calls_loses_and_duplicates_no_item(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    files, _ = opened(tmp_path)
    before = files.write([long_runs(1, 1)], NO_LIMITS)
    writev, left = os.writev, [1]

    def write_once(file: int, buffers: Sequence[bytes]) -> int:
        if not left:
            raise OSError(errno.ENOSPC, "No space left on device")
        left.pop()
        return writev(file, buffers)

    with monkeypatch.context() as full:
        full.setattr(f"{FILES}.os.writev", write_once)
        with pytest.raises(OSError, match="No space"):
            files.write([long_runs(3, 16)], NO_LIMITS)
    assert seqs(files, before) == [1, 2]
    assert seqs(files, files.write([long_runs(3, 16)], NO_LIMITS)) == [*range(1, 35)]
    files.close(None)
    assert seqs(*opened(tmp_path)) == [*range(1, 35)]


def test_a_flush_begins_with_the_whole_pages_that_no_earlier_one_had(tmp_path: Path) -> None:
    file = os.open(tmp_path / "file", os.O_RDWR | os.O_CREAT)
    try:
        os.write(file, b"x" * 10_000)
        assert start_flush(file, 0, 4095) == 0
        assert start_flush(file, 0, 10_000) == 8192
        assert start_flush(file, 8192, 10_000) == 8192
    finally:
        os.close(file)
