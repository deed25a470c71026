"""Somebody removes files or folders of an archive while its host runs: writes fail, and reads say LOST."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from stampede_rt_channel_host.archive.segment_files import SegmentFiles
from stampede_rt_channel_host.core.archive import ArchivedRun, Segment
from tests.unit.channel_host.archive.test_archive_files import ALL, decode, seqs, write
from tests.unit.channel_host.archive.test_archive_losses import check, files_of
from tests.unit.channel_host.archive.test_host_archive_writes import SMALL, large


def opened(folder: Path) -> tuple[SegmentFiles, tuple[Segment, ...]]:
    """The files of a channel in an archive, with two items."""
    files = SegmentFiles(folder, {})
    files.open(2)
    return files, write(files, 1, 1)


@pytest.mark.parametrize("removed", ["file", "folder", "renamed file"])
def test_a_write_fails_if_somebody_has_removed_the_open_file_and_the_next_one_begins_a_new_file(
    tmp_path: Path, removed: str
) -> None:
    folder = tmp_path / "channels" / "one"
    files, before = opened(folder)
    [path] = folder.glob("*.segment")
    if removed == "file":
        path.unlink()
    elif removed == "folder":
        shutil.rmtree(folder)
    else:
        path.rename(path.with_suffix(".kept"))
    with pytest.raises(OSError, match="somebody has removed its file"):
        write(files, 3, 1)
    check(files, before, {1, 2}, 2, knows_times=True)
    check(files, write(files, 3, 2), {1, 2}, 6, knows_times=True)
    files.close(None)


def test_writes_fail_and_no_read_says_lost_while_the_folder_of_the_archive_is_missing(tmp_path: Path) -> None:
    folder = tmp_path / "channels"
    files, before = opened(folder / "one")
    folder.rename(tmp_path / "elsewhere")
    for _ in range(2):
        with pytest.raises(OSError, match="channels is missing"):
            write(files, 3, 1)
        with pytest.raises(OSError, match="channels is missing") as refused:
            seqs(files, before)
        assert not isinstance(refused.value, FileNotFoundError), "the caller does not repeat the read after this error"
    (tmp_path / "elsewhere").rename(folder)
    assert seqs(files, write(files, 3, 1)) == [1, 2, 3, 4]
    files.close(None)


def test_a_file_that_somebody_removes_is_a_loss_also_if_its_blocks_are_known(tmp_path: Path) -> None:
    paths = files_of(tmp_path, (1, 5), (5, 9), (9, 13))
    files = SegmentFiles(tmp_path, {})
    segments = files.open(2).segments
    check(files, segments, set(), 12, knows_times=True)
    paths[1].unlink()
    check(files, segments, {5, 6, 7, 8}, 12, knows_times=True)


def test_a_file_that_the_limits_remove_is_no_loss(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    files = SegmentFiles(tmp_path, {})
    files.open(2)
    for number in range(3):
        segments = files.write([large(number)], SMALL)
    seen: list[type[BaseException]] = []

    def read_then_remove(path: Path, *, missing_ok: bool = False) -> None:
        path.rename(path.with_suffix(".gone"))
        try:
            files.load(segments, ALL, decode, lambda: None)
        except OSError as error:
            seen.append(type(error))

    monkeypatch.setattr("stampede_rt_channel_host.archive.segment_folder.Path.unlink", read_then_remove)
    for number in range(3, 8):
        files.write([[ArchivedRun(number, large(number)[0].run)]], SMALL)
    assert set(seen) == {FileNotFoundError}, "the read tries again with the other files"
    files.close(None)
