"""The limit of an archive's bytes on the disk, and the share of each caller."""

from __future__ import annotations

import asyncio
import errno
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from stampede_rt.errors import Overloaded
from stampede_rt.values.model import Policy
from stampede_rt_channel_host.archive import host_archive
from stampede_rt_channel_host.archive.archive_folder import ArchiveFolder
from stampede_rt_channel_host.archive.clean_stop import CleanStop
from stampede_rt_channel_host.archive.disk_use import FOLDER_BYTES, DiskUse
from stampede_rt_channel_host.archive.host_archive import HostArchive
from stampede_rt_channel_host.archive.recorder import ChannelRecorder
from stampede_rt_channel_host.archive.segment_files import ArchiveLimits, SegmentFiles
from stampede_rt_channel_host.core.channel import ChannelCore
from stampede_rt_runtime.quotas.accounts import Accounts
from stampede_rt_runtime.quotas.limits import Quota
from tests.unit.channel_host.archive.test_archive_files import decode, opened, write

ONE, TWO, THREE = b"1" * 16, b"2" * 16, b"3" * 16
MIB = 2**20


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[ArchiveFolder]:
    one = ArchiveFolder(tmp_path / "archive")
    one.open(b"h" * 16)
    yield one
    one.close()


def recorded(folder: ArchiveFolder, channel_id: bytes, created_by: str) -> SegmentFiles:
    """The files of a channel with two blocks."""
    files = SegmentFiles(folder.of_channel(channel_id), {"created_by": created_by})
    files.open(1)
    write(files, 1, 2)
    files.close(CleanStop(7))
    return files


def test_a_full_archive_still_takes_items_of_channels_that_are_charged_with_their_own_limit() -> None:
    disk = DiskUse(4 * MIB)
    first, second = disk.of_channel(ONE, "cam"), disk.of_channel(TWO, "cam")
    first.archive_bytes = 2 * MIB
    # From three quarters of its own limit on, the archive charges a channel with the whole limit.
    first.set_bytes(MIB * 7 // 4)
    second.set_bytes(MIB)
    assert disk.used_bytes == 3 * MIB + FOLDER_BYTES
    second.check(MIB - FOLDER_BYTES)
    with pytest.raises(Overloaded, match=r"has 3407872 bytes .* needs 786433 more, of at most 4194304 \(--archive-byt"):
        second.check(MIB - FOLDER_BYTES + 1)
    second.set_bytes(2 * MIB - FOLDER_BYTES)
    with pytest.raises(Overloaded):
        second.check()
    first.check(2**17)


def test_items_and_a_new_folder_count_as_soon_as_the_channel_accepts_the_items() -> None:
    disk = DiskUse(MIB)
    one = disk.of_channel(ONE, "cam")
    one.check(MIB - FOLDER_BYTES)
    with pytest.raises(Overloaded):
        one.check(MIB - FOLDER_BYTES + 1)
    one.set_unwritten(1000, 1000)
    assert disk.used_bytes == FOLDER_BYTES + 1000
    disk.of_channel(TWO, "cam").check(MIB - 2 * FOLDER_BYTES - 1000)
    with pytest.raises(Overloaded):
        disk.of_channel(TWO, "cam").check(MIB - 2 * FOLDER_BYTES - 999)
    one.set_bytes(FOLDER_BYTES + 900)
    one.set_unwritten(0)
    assert disk.used_bytes == FOLDER_BYTES + 900


def test_a_deleted_channel_counts_for_its_creator_until_its_files_are_gone() -> None:
    accounts = Accounts()
    disk = DiskUse(4 * MIB, accounts.of)
    accounts.set_default(Quota.BYTES_ARCHIVED, MIB)
    disk.of_channel(ONE, "cam").set_bytes(MIB)
    with pytest.raises(Overloaded, match=r"cam has 1048576 bytes on the disk .* bytes-archived is 1048576") as refused:
        disk.of_channel(TWO, "cam").check()
    assert refused.value.metadata["quota"] == "bytes-archived"
    disk.of_channel(TWO, "other").check()
    disk.update([])
    assert disk.used_bytes == 0
    disk.of_channel(TWO, "cam").check()


def test_a_start_finds_the_folders_and_creators_of_all_channels(folder: ArchiveFolder) -> None:
    recorded(folder, ONE, "cam")
    recorded(folder, TWO, "")
    (folder.path / "channels" / "no-channel").mkdir()
    (folder.of_channel(TWO) / "000000000000.segment").write_bytes(b"no block")
    found = {one.channel_id: one for one in folder.of_channels()}
    assert {channel_id: one.created_by for channel_id, one in found.items()} == {ONE: "cam", TWO: ""}
    size = sum(path.stat().st_size for path in folder.of_channel(ONE).iterdir())
    assert found[ONE].bytes == FOLDER_BYTES + size


def test_the_folder_of_a_channel_without_items_is_deleted_with_the_channel(tmp_path: Path) -> None:
    files, _ = opened(tmp_path / "empty")
    files.close(None)
    assert [*tmp_path.iterdir()] == []


def test_the_folder_of_a_channel_without_items_keeps_the_note_of_a_clean_stop(tmp_path: Path) -> None:
    files, _ = opened(tmp_path / "empty")
    files.close(CleanStop(7))
    found = SegmentFiles(tmp_path / "empty", {}).open(2, 7)
    assert found.segments == ()
    assert found.stop is not None


def refused(*_: Any) -> None:
    raise OSError(errno.EACCES, "the folder cannot be written")


def test_a_refusal_frees_the_bytes_of_outdated_files_and_of_folders_that_an_operator_has_deleted(
    folder: ArchiveFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The files of another channel cannot be deleted. In an earlier version this failure ended the pass."""
    monkeypatch.setattr(host_archive, "RETRY_SECONDS", 0)
    recorded(folder, TWO, "")
    disk = DiskUse(1)
    disk.update(folder.of_channels())
    disk.of_channel(THREE, "").set_bytes(5_000)  # the folder of this channel does not exist any more
    files = SegmentFiles(folder.of_channel(ONE), {})
    files.open(1)
    segments = write(files, 1, 9, ArchiveLimits(None, 8))  # a segment for each block

    async def scenario() -> tuple[int, int]:
        counted = asyncio.Event()
        update = disk.update

        def note(*folders: Any, **options: Any) -> None:
            update(*folders, **options)
            counted.set()

        monkeypatch.setattr(disk, "update", note)
        archive = HostArchive(folder, decode, disk, now=lambda: 1_000)
        recorder = ChannelRecorder(ChannelCore(Policy(), incarnation=1), files, segments, disk.of_channel(ONE, ""))
        recorder.limit(ArchiveLimits(10, None))
        archive.record(recorder)
        bad = ChannelRecorder(ChannelCore(Policy(), incarnation=1), SegmentFiles(folder.of_channel(THREE), {}), ())
        monkeypatch.setattr(bad.files, "drop_outdated", refused)
        monkeypatch.setattr(archive, "_recorders", [bad, recorder])
        with pytest.raises(Overloaded):
            recorder.check_room()
        await counted.wait()
        on_disk = sum(one.bytes for one in folder.of_channels())
        await archive.close([recorder])
        return len(recorder.segments), on_disk

    assert asyncio.run(scenario()) == (1, disk.used_bytes)
