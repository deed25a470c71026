"""Losses of owners that no file records, because the file with the record is lost, too: readers get LOST."""

from __future__ import annotations

from pathlib import Path

import pytest

from stampede_rt.values.model import Policy
from stampede_rt.values.seq_starts import start_of
from stampede_rt_channel_host.archive.segment_files import SegmentFiles
from stampede_rt_channel_host.archive.written_parts import MissingSeqs
from stampede_rt_channel_host.core.archive import NOTHING_LOST, ArchivedRun
from stampede_rt_channel_host.core.channel import ChannelCore, Run, make_run
from tests.unit.channel_host.archive.test_archive_files import NO_LIMITS
from tests.unit.channel_host.archive.test_archive_losses import opened, past, read

OLD, NEW = 100, 500
"""The instants and times of the item of a former owner, and of the item after the loss."""


def archived(seq: int, time: int) -> list[ArchivedRun]:
    return [ArchivedRun(time, make_run(seq, [time], None, [7], b"%d" % seq))]


def decode_at(body: bytes) -> Run:
    return archived(int(body), OLD if int(body) == 1 else NEW)[0].run


@pytest.fixture(autouse=True)
def decoded_items(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let reads decode the items of `archived`."""
    monkeypatch.setattr("tests.unit.channel_host.archive.test_archive_losses.decode", decode_at)
    monkeypatch.setattr("tests.unit.channel_host.archive.test_host_archive_writes.decode", decode_at)


def written(folder: Path, *records: MissingSeqs, files_count: int) -> None:
    """An item of a lost owner, and an item of an owner that follows it, in one file or in two. `records`: parts of
    the second owner before its item.
    """
    first, second = archived(1, OLD), archived(start_of(2), NEW)
    for parts in [[first, *records, second]] if files_count == 1 else [[first], [*records, second]]:
        files = SegmentFiles(folder, {})
        files.open(2)
        files.write(parts, NO_LIMITS)
        files.close(None)


@pytest.mark.parametrize("files_count", [1, 2])
def test_an_owner_that_begins_at_the_first_seq_of_its_epoch_shows_the_loss_before_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, files_count: int
) -> None:
    """In an earlier version, reads gave no reason for the lost items."""
    written(tmp_path / "c", files_count=files_count)
    files, segments = opened(tmp_path / "c")
    assert read(files, segments, 200, 300) == ([], "LOST")
    assert read(files, segments, OLD, OLD) == ([1], None)
    assert read(files, segments, NEW, NEW + 1) == ([start_of(2)], None)
    channel = ChannelCore(Policy(max_items=100), incarnation=7)
    channel.restore((), after=NEW, next_seq=start_of(2) + 1, loss=(None, None))
    assert past(tmp_path, monkeypatch, channel, 300, start=200).reason == "LOST"


def test_an_owner_that_follows_a_clean_stop_shows_no_loss(tmp_path: Path) -> None:
    records = [MissingSeqs(2, 2, 400), MissingSeqs(2, 2, NOTHING_LOST)]
    written(tmp_path / "c", *records, files_count=2)
    files, segments = opened(tmp_path / "c")
    assert read(files, segments, 50, 600) == ([1, start_of(2)], None)


def test_items_in_memory_that_begin_at_the_first_seq_of_an_epoch_show_the_loss_before_them(tmp_path: Path) -> None:
    """The file with these items is lost, or has not come yet. In an earlier version, reads gave no reason."""
    files = SegmentFiles(tmp_path / "c", {})
    files.open(1)
    files.write([archived(1, OLD)], NO_LIMITS)
    files.close(None)
    files, (segment,) = opened(tmp_path / "c")
    channel = ChannelCore(Policy(max_items=100), incarnation=7)
    held = archived(start_of(2), NEW)[0].run
    channel.restore([held], after=NEW - 1, next_seq=start_of(2) + 1, loss=(None, None))
    readable = (segment._replace(end_seq=start_of(2)),)
    assert read(files, readable, 200, 300, channel) == ([], "LOST")
    assert read(files, readable, OLD, OLD, channel) == ([1], None)
