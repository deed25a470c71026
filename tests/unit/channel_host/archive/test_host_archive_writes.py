"""Writes of an archive that fail late, or are under way when the host stops: no item is lost, and none is doubled."""

from __future__ import annotations

import asyncio
import errno
import os
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from stampede_rt.values.model import Policy
from stampede_rt.values.seq_starts import start_of
from stampede_rt_channel_host.archive.archive_folder import ArchiveFolder
from stampede_rt_channel_host.archive.clean_stop import CleanStop
from stampede_rt_channel_host.archive.host_archive import HostArchive
from stampede_rt_channel_host.archive.recorder import ChannelRecorder
from stampede_rt_channel_host.archive.segment_files import ArchiveLimits, SegmentFiles
from stampede_rt_channel_host.core.archive import ArchivedRun, Segment
from stampede_rt_channel_host.core.channel import ChannelCore, Offer
from stampede_rt_runtime.settings import SettingsError
from tests.support.waiting import until
from tests.unit.channel_host.archive.test_archive_files import decode, opened, run_at, seqs, write

FILES = "stampede_rt_channel_host.archive.segment_files"
SMALL = ArchiveLimits(None, 2**20)


def refuse(*_: object, **__: object) -> None:
    raise OSError(errno.EROFS, "Read-only file system")


def large(number: int) -> list[ArchivedRun]:
    """One block of two items that is a fourth of the archive SMALL."""
    return [ArchivedRun(number, run_at(1 + 2 * number, payload=b"x" * 2**18))]


def test_failed_writes_in_a_read_only_folder_neither_lose_nor_repeat_items(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    files, _ = opened(tmp_path)
    before = write(files, 1, 2)
    with monkeypatch.context() as broken:
        for name in ("fsync", "truncate"):
            broken.setattr(f"{FILES}.os.{name}", refuse)
        broken.setattr(f"{FILES}.Path.unlink", refuse)
        for _ in range(2):
            with pytest.raises(OSError, match="Read-only"):
                write(files, 5, 1)
    assert seqs(files, before) == [1, 2, 3, 4]
    assert seqs(files, write(files, 5, 2)) == [1, 2, 3, 4, 5, 6, 7, 8]
    files.close(CleanStop(7))
    files, segments = opened(tmp_path)
    assert seqs(files, segments) == [1, 2, 3, 4, 5, 6, 7, 8]
    assert [one.end_seq for one in segments[:-1]] == [one.first_seq for one in segments[1:]]


def test_an_old_segment_that_cannot_be_deleted_does_not_fail_the_write(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    files, _ = opened(tmp_path)
    for number in range(3):
        segments = files.write([large(number)], SMALL)
    with monkeypatch.context() as broken:
        broken.setattr(f"{FILES}.Path.unlink", refuse)
        for number in range(3, 6):
            segments = files.write([large(number)], SMALL)
    assert seqs(files, segments) == [*range(1, 13)]
    segments = files.write([large(6)], SMALL)
    assert seqs(files, segments) == [*range(15 - 2 * len(segments), 15)]
    assert len(segments) < 6


def test_files_that_are_not_segments_do_not_disturb_an_archive(tmp_path: Path) -> None:
    files, _ = opened(tmp_path)
    write(files, 1, 1)
    files.close(None)
    (tmp_path / "000000000001 (copy).segment").write_bytes(b"")
    (tmp_path / "stopped-cleanly").write_bytes(b"\xff")
    files, segments = opened(tmp_path)
    assert seqs(files, segments) == [1, 2]


def test_only_the_owner_can_read_a_folder_and_the_error_names_an_unreadable_owner_file(tmp_path: Path) -> None:
    folder = ArchiveFolder(tmp_path / "a")
    folder.open(b"h" * 16)
    folder.close()
    assert [path.stat().st_mode & 0o777 for path in (tmp_path / "a", tmp_path / "a" / "channels")] == [0o700, 0o700]
    (tmp_path / "a" / "owner").unlink()
    (tmp_path / "a" / "owner").mkdir()
    with pytest.raises(SettingsError, match="a cannot be written"):
        folder.open(b"h" * 16)


def test_the_names_of_new_folders_are_synced_to_stable_storage(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    synced: list[Path] = []
    monkeypatch.setattr("stampede_rt_channel_host.archive.stable_writes.sync_folder", synced.append)
    folder = ArchiveFolder(tmp_path / "a" / "b")
    folder.open(b"h" * 16)
    folder.close()
    assert {tmp_path, tmp_path / "a", tmp_path / "a" / "b"} <= set(synced)


def test_a_stop_that_cannot_be_noted_is_logged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    async def scenario() -> None:
        archive = archive_in(tmp_path / "a", monkeypatch)
        monkeypatch.setattr(archive.folder, "note_stop", refuse)
        await archive.close([], boot_incarnation=5)

    asyncio.run(scenario())
    assert [(one.levelname, vars(one)["event"]) for one in caplog.records] == [("ERROR", "archive_stop_unnoted")]


class SlowDisk:
    """A disk whose next flush waits until the test lets it go on."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.reached, self.may_continue = threading.Event(), threading.Event()
        self._fsync = os.fsync
        monkeypatch.setattr(f"{FILES}.os.fsync", self._flush)

    def _flush(self, file: int) -> None:
        self.reached.set()
        assert self.may_continue.wait(60)
        self._fsync(file)


def recorded(archive: HostArchive, folder: Path) -> tuple[ChannelRecorder, Callable[[], None]]:
    """A recorded channel, and a function that puts an item into it."""
    channel = ChannelCore(Policy(max_items=1000), incarnation=7)
    files = SegmentFiles(folder, {})
    files.open(1)
    recorder = ChannelRecorder(channel, files, ())

    def put() -> None:
        at = channel.next_seq
        channel.put(
            Offer(times=[at], durations=None, lengths=[1]), at, lambda first_seq, kept, stamped: b"%d " % first_seq
        )
        if recorder.note(at):
            archive.touch(recorder, lambda: None)

    return recorder, put


def archive_in(folder: Path, monkeypatch: pytest.MonkeyPatch) -> HostArchive:
    monkeypatch.setattr("stampede_rt_channel_host.archive.host_archive.WRITE_AFTER_SECONDS", 0)
    opened_folder = ArchiveFolder(folder)
    opened_folder.open(b"h" * 16)
    return HostArchive(opened_folder, decode)


def test_a_stop_in_the_middle_of_a_write_repeats_no_item(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    async def scenario() -> tuple[Segment, ...]:
        archive = archive_in(tmp_path / "a", monkeypatch)
        recorder, put = recorded(archive, tmp_path / "c")
        disk = SlowDisk(monkeypatch)
        put()
        assert await asyncio.to_thread(disk.reached.wait, 60)
        put()
        closing = asyncio.create_task(archive.close([recorder]))
        await asyncio.sleep(0)
        disk.may_continue.set()
        await closing
        return recorder.segments

    segments = asyncio.run(scenario())
    assert sum(one.items for one in segments) == 2
    found = SegmentFiles(tmp_path / "c", {}).open(1)
    assert (sum(one.items for one in found.segments), found.stop is not None) == (2, True)


def test_a_stop_with_a_disk_that_fails_logs_the_items_that_are_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    async def scenario() -> None:
        archive = archive_in(tmp_path / "a", monkeypatch)
        recorder, put = recorded(archive, tmp_path / "c")
        monkeypatch.setattr(recorder.files, "write", refuse)
        put()
        put()
        await archive.close([recorder])

    asyncio.run(scenario())
    last = vars(caplog.records[-1])
    assert (last["event"], last["items"], last["why"]) == ("archive_cut_short", 2, "Read-only file system")


def test_a_stop_with_a_disk_that_fails_counts_no_seqs_before_the_first_seq_of_an_owner(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    async def scenario() -> None:
        archive = archive_in(tmp_path / "a", monkeypatch)
        recorder, put = recorded(archive, tmp_path / "c")
        begin = start_of(2)  # the archive has the seqs of a lost owner up to 5
        recorder._channel.restore((), after=None, next_seq=begin, loss=(None, 1))
        recorder.archived_to = 6
        monkeypatch.setattr(recorder.files, "write", refuse)
        put()
        await archive.close([recorder])

    asyncio.run(scenario())
    assert (vars(caplog.records[-1])["event"], vars(caplog.records[-1])["items"]) == ("archive_cut_short", 1)


def test_a_channel_that_is_given_up_in_the_middle_of_a_write_is_no_longer_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def scenario() -> int:
        archive = archive_in(tmp_path / "a", monkeypatch)
        first, put_first = recorded(archive, tmp_path / "first")
        second, put_second = recorded(archive, tmp_path / "second")
        disk = SlowDisk(monkeypatch)
        put_first()
        put_second()
        assert await asyncio.to_thread(disk.reached.wait, 60)
        put_first()
        archive.forget(first)
        archive.forget(second)
        disk.may_continue.set()
        await archive.close([])
        return first.backlog_items + second.backlog_items

    assert asyncio.run(scenario()) == 2
    assert len([*tmp_path.glob("second/*.segment")]) == 0
    assert sum(one.items for one in SegmentFiles(tmp_path / "first", {}).open(1).segments) == 1


@pytest.mark.parametrize("is_full", [False, True])
def test_a_write_begins_as_soon_as_enough_bytes_wait_unless_the_disk_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, is_full: bool
) -> None:
    async def scenario() -> list[int]:
        archive = archive_in(tmp_path / "a", monkeypatch)
        monkeypatch.setattr("stampede_rt_channel_host.archive.host_archive.WRITE_AFTER_SECONDS", 10**6)
        recorder, put = recorded(archive, tmp_path / "c")
        run_bytes = recorder.files.run_bytes_max + 2
        monkeypatch.setattr("stampede_rt_channel_host.archive.recorder.WRITE_FROM_BYTES", 3 * run_bytes)
        if is_full:
            recorder.note_end("no space left on device")
        written = []
        for _ in range(4):
            put()
            await until(lambda: recorder.archived_to == 4 or not recorder.fills_a_write)
            written.append(recorder.archived_to - 1)
        await archive.close([])
        return written

    assert asyncio.run(scenario()) == ([0, 0, 0, 0] if is_full else [0, 0, 3, 3])


def test_items_that_come_during_a_write_wait_for_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    async def scenario() -> list[int]:
        archive = archive_in(tmp_path / "a", monkeypatch)
        monkeypatch.setattr("stampede_rt_channel_host.archive.host_archive.WRITE_AFTER_SECONDS", 10**6)
        recorder, put = recorded(archive, tmp_path / "c")
        disk = SlowDisk(monkeypatch)
        put()
        archive.hurry()
        assert await asyncio.to_thread(disk.reached.wait, 60)
        put()
        disk.may_continue.set()
        await until(lambda: recorder.archived_to == 2)
        put()
        archive.hurry()
        await until(lambda: recorder.archived_to == 4)
        put()
        await archive.close([recorder])
        files = recorder.files
        blocks = files.place.blocks(recorder.segments[0], 0)
        return [one.head.items for one in blocks if one.head.items]

    assert asyncio.run(scenario()) == [1, 2, 1]


@pytest.mark.parametrize(
    ("policy", "puts"),
    [
        (Policy(max_bytes=4000), 3),  # an item counts 370 bytes, because it may begin a file
        (Policy(max_items=12, on_full="block", consumers=1), 3),
        (Policy(max_items=12), None),  # the channel keeps more items until they are archived
    ],
)
def test_a_write_begins_when_a_fourth_of_a_small_channel_waits(
    tmp_path: Path, policy: Policy, puts: int | None
) -> None:
    channel, files = ChannelCore(policy, incarnation=7), SegmentFiles(tmp_path, {})
    recorder, fills = ChannelRecorder(channel, files, ()), list[bool]()
    for at in range(1, 6):
        channel.put(Offer(times=[at], durations=None, lengths=[1]), at, lambda first_seq, kept, stamped: b"item")
        recorder.note(at)
        fills.append(recorder.fills_a_write)
    assert fills == [puts is not None and at >= puts for at in range(1, 6)]
