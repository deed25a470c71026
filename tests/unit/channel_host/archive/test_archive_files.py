"""The files of an archive under faults: a crash, a full disk, a flipped bit, a folder of another host."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from stampede_rt.errors import Overloaded
from stampede_rt_channel_host.archive.archive_folder import ArchiveFolder
from stampede_rt_channel_host.archive.clean_stop import CleanStop, read_stop
from stampede_rt_channel_host.archive.segment_files import ArchiveLimits, SegmentFiles
from stampede_rt_channel_host.archive.written_parts import MissingSeqs
from stampede_rt_channel_host.core.archive import (
    ROW_BYTES,
    ArchivedRun,
    Hole,
    Segment,
    WantedItems,
    WantedWindow,
    span_of,
)
from stampede_rt_channel_host.core.channel import FIRST_KEY, Run, make_run
from stampede_rt_channel_host.core.channel.item_keys import LAST_KEY
from stampede_rt_runtime.settings import SettingsError

NO_LIMITS = ArchiveLimits(None, None)
ALL = WantedWindow(WantedItems(FIRST_KEY[0], LAST_KEY, 0, 2**30), FIRST_KEY, LAST_KEY)
HOST, OTHER = b"h" * 16, b"o" * 16


def run_at(seq: int, items: int = 2, payload: bytes = b"") -> Run:
    return make_run(seq, [seq + at for at in range(items)], None, [7] * items, b"%d " % seq + payload)


def decode(body: bytes) -> Run:
    return run_at(int(body.split(b" ")[0]))


def write(files: SegmentFiles, first: int, blocks: int, limits: ArchiveLimits = NO_LIMITS) -> tuple[Segment, ...]:
    """Write this number of blocks of one run of two items. Returns all segments."""
    segments: tuple[Segment, ...] = ()
    for number in range(blocks):
        segments = files.write([[ArchivedRun(number, run_at(first + 2 * number))]], limits)
    return segments


def seqs(files: SegmentFiles, segments: tuple[Segment, ...]) -> list[int]:
    """The seqs of all items that a read finds."""
    window = files.load(segments, ALL, decode, lambda: None)
    return [part.first_seq + at for part in window.items.slices(FIRST_KEY, LAST_KEY) for at in range(part.items)]


def opened(folder: Path) -> tuple[SegmentFiles, tuple[Segment, ...]]:
    files = SegmentFiles(folder, {})
    return files, files.open(2).segments


def test_a_file_cut_at_any_byte_keeps_the_blocks_before_the_cut_and_takes_new_ones(tmp_path: Path) -> None:
    files, _ = opened(tmp_path / "a")
    write(files, 1, 3)
    files.close(None)
    [path] = (tmp_path / "a").glob("*.segment")
    raw = path.read_bytes()
    for cut in range(0, len(raw), 7):
        folder = tmp_path / f"cut-{cut}"
        folder.mkdir()
        (folder / path.name).write_bytes(raw[:cut])
        files = SegmentFiles(folder, {})
        found = files.open(2)
        kept = [seq for one in found.segments for seq in range(one.first_seq, one.end_seq)]
        assert kept == list(range(1, len(kept) + 1))
        assert found.stop is None
        assert seqs(files, write(files, len(kept) + 1, 1)) == list(range(1, len(kept) + 3))
        files.close(None)


def test_a_new_file_is_on_stable_storage_with_its_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    synced: list[Path] = []
    monkeypatch.setattr("stampede_rt_channel_host.archive.segment_files.sync_folder", synced.append)
    files, _ = opened(tmp_path / "channel")
    write(files, 1, 1)
    files.close(None)
    assert synced == [tmp_path / "channel", tmp_path]  # the name of the file, and the name of its folder


def test_a_full_disk_loses_no_item_that_was_written_before(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    files, _ = opened(tmp_path)
    before = write(files, 1, 2)

    def write_some(file: int, buffers: list[bytes]) -> int:
        os.write(file, buffers[0][:10])
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as full:
        full.setattr("stampede_rt_channel_host.archive.segment_files.os.writev", write_some)
        with pytest.raises(OSError, match="No space left"):
            write(files, 5, 1)
    assert seqs(files, before) == [1, 2, 3, 4]
    assert seqs(files, write(files, 5, 1)) == [1, 2, 3, 4, 5, 6]
    files.close(CleanStop(7))
    files, segments = opened(tmp_path)
    assert seqs(files, segments) == [1, 2, 3, 4, 5, 6]


def test_a_flipped_bit_loses_only_its_block(tmp_path: Path) -> None:
    files, _ = opened(tmp_path)
    segments = write(files, 1, 3)
    [path] = tmp_path.glob("*.segment")
    raw = bytearray(path.read_bytes())
    raw[raw.index(b"3 ")] ^= 1
    path.write_bytes(raw)
    assert seqs(files, segments) == [1, 2, 5, 6]
    assert files.damaged_blocks == 1
    files.close(None)
    assert SegmentFiles(tmp_path, {}).open(2).damaged_blocks == 1


def test_a_damaged_head_of_the_first_block_is_a_loss_and_does_not_count_as_collected(tmp_path: Path) -> None:
    files, _ = opened(tmp_path)
    write(files, 1, 3)
    files.close(None)
    [path] = tmp_path.glob("*.segment")
    raw = bytearray(path.read_bytes())
    raw[raw.index(b"1 ") - ROW_BYTES - 20] ^= 1  # in the head of the block
    path.write_bytes(raw)
    files, segments = opened(tmp_path)
    assert seqs(files, segments) == [3, 4, 5, 6]
    assert not span_of(segments).is_cut
    window = files.load(segments, ALL, decode, lambda: None)
    assert [(hole.items, hole.end) for hole in window.holes] == [(2, 2)]
    before = WantedWindow(WantedItems(1, (2, 2**64), 0, 2**30), FIRST_KEY, LAST_KEY)
    assert [hole.items for hole in files.load(segments, before, decode, lambda: None).holes] == [2]


@pytest.mark.parametrize(
    ("epoch", "incarnation", "expected"), [(2, 8, True), (3, 8, False), (3, 7, True), (9, 7, True)]
)
def test_a_stop_counts_as_clean_only_if_no_other_owner_has_served_the_channel_since(
    tmp_path: Path, epoch: int, incarnation: int, expected: bool
) -> None:
    stop = CleanStop(incarnation=7, advance=5, lost_from=None, lost_before=3, retries=b"\xff\0")
    files = SegmentFiles(tmp_path, {})
    files.open(1)
    write(files, 1, 1)
    files.close(stop)
    found = SegmentFiles(tmp_path, {}).open(epoch, incarnation)
    assert found.stop == (stop._replace(epoch=1, end_seq=3, newest=2) if expected else None)
    assert SegmentFiles(tmp_path, {}).open(epoch, incarnation).stop is None, "once only"


@pytest.mark.parametrize(
    "text", [b"", b"{}", b"7", b"[1]", b'{"incarnation": 7}', b'{"incarnation": "7", "retries": ""}']
)
def test_an_unreadable_note_of_a_stop_is_ignored(tmp_path: Path, text: bytes) -> None:
    (tmp_path / "stopped-cleanly").write_bytes(text)
    assert SegmentFiles(tmp_path, {}).open(0, 7).stop is None


def test_a_flipped_bit_in_the_note_of_a_stop_is_never_taken_for_another_fact(tmp_path: Path) -> None:
    stop = CleanStop(incarnation=7, advance=15, lost_from=11, lost_before=13, retries=b"\xff\0", epoch=1)
    files = SegmentFiles(tmp_path / "a", {})
    files.open(1)
    write(files, 1, 1)
    files.close(stop)
    path = tmp_path / "a" / "stopped-cleanly"
    note = path.read_bytes()
    for at in range(len(note)):
        for bit in range(8):
            path.write_bytes(note[:at] + bytes([note[at] ^ 1 << bit]) + note[at + 1 :])
            assert read_stop(path.parent) is None, (at, bit)


def test_the_note_of_a_stop_of_an_earlier_release_counts(tmp_path: Path) -> None:
    (tmp_path / "stopped-cleanly").write_text('{"incarnation": 7, "retries": "", "epoch": 1, "end_seq": 3}')
    assert read_stop(tmp_path) == CleanStop(7, epoch=1, end_seq=3)


def test_a_folder_names_the_process_that_stopped_last_with_all_items_written(tmp_path: Path) -> None:
    folder = ArchiveFolder(tmp_path)
    folder.open(HOST)
    assert folder.boot_of_last_stop() == 0
    folder.note_stop(2**64 - 1)
    assert folder.boot_of_last_stop() == 2**64 - 1
    (tmp_path / "stopped").write_bytes(b"\xff nonsense")
    assert folder.boot_of_last_stop() == 0
    folder.close()


def test_an_archive_beyond_its_bytes_or_age_drops_whole_segments(tmp_path: Path) -> None:
    files, _ = opened(tmp_path / "bytes")
    for number in range(40):
        run = run_at(1 + 2 * number, payload=b"x" * 2**17)
        segments = files.write([[ArchivedRun(number, run)]], ArchiveLimits(None, 2**20))
    assert sum(one.length for one in segments) <= 2**20 + 2**18
    assert segments[-1].end_seq == 81
    assert len([*(tmp_path / "bytes").glob("*.segment")]) == len(segments)
    files, _ = opened(tmp_path / "age")
    segments = write(files, 1, 100, ArchiveLimits(32, None))
    assert 64 <= segments[0].last_accepted <= 68
    assert segments[-1].end_seq == 201


def test_a_file_lists_the_seqs_that_were_never_archived(tmp_path: Path) -> None:
    files, _ = opened(tmp_path)
    files.write([[ArchivedRun(1, run_at(1))], MissingSeqs(3, 9), [ArchivedRun(2, run_at(9))]], NO_LIMITS)
    files.close(None)
    files, segments = opened(tmp_path)
    assert (segments[0].items, segments[0].end_seq) == (4, 11)
    assert seqs(files, segments) == [1, 2, 9, 10]


def test_a_folder_belongs_to_one_host_and_one_process(tmp_path: Path) -> None:
    first = ArchiveFolder(tmp_path / "a")
    first.open(HOST)
    with pytest.raises(SettingsError, match="another host uses the folder"):
        ArchiveFolder(tmp_path / "a").open(HOST)
    first.close()
    with pytest.raises(SettingsError, match="is the archive of host"):
        ArchiveFolder(tmp_path / "a").open(OTHER)
    reopened = ArchiveFolder(tmp_path / "a")
    reopened.open(HOST)
    reopened.close()


def test_a_folder_that_cannot_be_made_is_named_with_its_reason(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(SettingsError, match=r"file/a cannot be written \(Not a directory\)"):
        ArchiveFolder(tmp_path / "file" / "a").open(HOST)


def test_a_read_names_the_items_that_are_missing_between_two_segments(tmp_path: Path) -> None:
    files, _ = opened(tmp_path)
    files.write([[ArchivedRun(1, run_at(1))], MissingSeqs(3, 6)], NO_LIMITS)
    files.close(None)
    files, _ = opened(tmp_path)
    segments = files.write([[ArchivedRun(2, run_at(6))]], NO_LIMITS)
    assert len(segments) == 2
    window = files.load(segments, ALL, decode, lambda: None)
    assert window.holes == [Hole(3, 5, 3)]
    before = WantedWindow(WantedItems(FIRST_KEY[0], (3, 0), 0, 2**30), FIRST_KEY, (3, 0))
    assert files.load(segments, before, decode, lambda: None).holes == [Hole(3, 5, 3)]


def test_a_read_of_too_many_items_of_one_time_fails_instead_of_taking_all_memory(tmp_path: Path) -> None:
    files, _ = opened(tmp_path)
    segments = write(files, 1, 40)
    narrow = ALL.wanted._replace(bytes_max=100, bytes_limit=400)
    assert files.load(segments, ALL._replace(wanted=narrow), decode, lambda: None).edge is not None
    same = [make_run(seq, [5] * 2, None, [7] * 2, b"%d " % seq) for seq in range(81, 121, 2)]
    for run in same:
        segments = files.write([[ArchivedRun(3, run)]], NO_LIMITS)
    for down in (False, True):
        wanted = narrow._replace(start=5, high=(6, 0), down=down)
        with pytest.raises(Overloaded, match="have one time"):
            files.load(segments, WantedWindow(wanted, FIRST_KEY, (6, 0)), decode, lambda: None)


@pytest.mark.parametrize("which", ["before another segment", "last, after a clean stop"])
def test_a_file_whose_only_block_is_damaged_stays_and_its_items_are_a_loss(tmp_path: Path, which: str) -> None:
    files, _ = opened(tmp_path)
    write(files, 1, 1)
    files.close(CleanStop(7))
    [path] = tmp_path.glob("*.segment")
    raw = bytearray(path.read_bytes())
    raw[raw.index(b"1 ") - ROW_BYTES - 20] ^= 1  # in the head of the block
    if which == "before another segment":
        files, _ = opened(tmp_path)
        write(files, 3, 1)
        files.close(CleanStop(7))
    path.write_bytes(raw)
    files = SegmentFiles(tmp_path, {})
    found = files.open(2)
    assert found.damaged_blocks == 1
    [kept] = tmp_path.glob("*.damaged")
    assert kept.read_bytes() == raw
    segments = found.segments or write(files, 3, 1)
    assert seqs(files, segments) == [3, 4]
    files.close(CleanStop(7))
    assert seqs(*opened(tmp_path)) == [3, 4]
    assert kept.read_bytes() == raw
