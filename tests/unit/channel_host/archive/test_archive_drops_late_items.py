"""An archive that has dropped items whose times are not before all its other items: readers hear COLLECTED."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest

from stampede_rt_channel_host.archive.segment_files import ArchiveLimits, SegmentFiles
from stampede_rt_channel_host.core.archive import ArchivedRun
from stampede_rt_channel_host.core.channel import Run, make_run
from tests.unit.channel_host.archive.test_archive_files import NO_LIMITS
from tests.unit.channel_host.archive.test_archive_losses import opened, read


def run(seq: int, times: Sequence[int]) -> Run:
    return make_run(seq, times, None, [1] * len(times), b"%d:%s" % (seq, ",".join(map(str, times)).encode()))


def decoded(body: bytes) -> Run:
    seq, _, times = body.partition(b":")
    return run(int(seq), [int(one) for one in times.split(b",")])


@pytest.fixture(autouse=True)
def decoded_items(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let reads decode the items of `run`."""
    monkeypatch.setattr("tests.unit.channel_host.archive.test_archive_losses.decode", decoded)


@pytest.mark.parametrize(("late", "whole_from"), [(15, 21), (20, 21), (21, 21)])
def test_a_read_says_collected_up_to_the_latest_time_of_the_dropped_items(
    tmp_path: Path, late: int, whole_from: int
) -> None:
    """In an earlier version, a read from the time of the oldest archived item on gave no reason."""
    files = SegmentFiles(tmp_path / "c", {})
    files.open(1)
    files.write([[ArchivedRun(10, run(1, [10, 20]))]], NO_LIMITS)
    files._end_segment()
    files.write([[ArchivedRun(1000, run(3, [late, 30]))]], ArchiveLimits(100, None))
    files.close(None)
    files, segments = opened(tmp_path / "c")
    assert [one.first_seq for one in segments] == [3], "the limits have dropped the first file"
    for start in range(late, 25):
        expected = "COLLECTED" if start < whole_from else None
        assert read(files, segments, start, 40)[1] == expected, start
    assert read(files, segments, 12, 14) == ([], "COLLECTED")


def test_a_file_of_an_earlier_release_does_not_show_the_latest_time_of_the_dropped_items(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    files = SegmentFiles(tmp_path / "c", {})
    files.open(1)
    files.write([[ArchivedRun(1000, run(3, [15, 30]))]], NO_LIMITS)
    files.close(None)
    files, segments = opened(tmp_path / "c")
    assert read(files, segments, 15, 40) == ([3, 4], None)
