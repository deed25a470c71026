"""An archive that has dropped items whose times are not before all its other items: readers hear COLLECTED."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest

from stampede_rt_channel_host.archive.segment_files import ArchiveLimits, SegmentFiles
from stampede_rt_channel_host.archive.written_parts import Advances
from stampede_rt_channel_host.core.archive import ArchivedAdvance, ArchivedRun
from stampede_rt_channel_host.core.channel import Run, make_run
from tests.support.channel_host.object_stores import FakeStore, move, opened_files
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


@pytest.mark.parametrize("has_advance", [False, True])
@pytest.mark.parametrize("is_opened_again", [False, True])
def test_a_read_after_all_times_of_the_first_file_says_collected_for_dropped_items(
    tmp_path: Path, is_opened_again: bool, has_advance: bool
) -> None:
    """In an earlier version, it gave no reason: it did not look into the first file."""
    files = SegmentFiles(tmp_path / "c", {})
    files.open(1)
    segments = files.write([[ArchivedRun(10, run(1, [10, 50]))]], NO_LIMITS)
    files._end_segment()
    if has_advance:  # then the first file that the limits keep has no items
        segments = files.write([Advances(3, (ArchivedAdvance(900, 5),))], NO_LIMITS)
        files._end_segment()
    segments = files.write([[ArchivedRun(1000, run(3, [30, 35]))]], NO_LIMITS)
    files._end_segment()
    segments = files.write([[ArchivedRun(1001, run(5, [40, 60]))]], NO_LIMITS)
    assert read(files, segments, 45, 60) == ([2, 6], None)
    files._end_segment()
    segments = files.write([[ArchivedRun(1001, run(7, [70, 80]))]], ArchiveLimits(500, None))
    if is_opened_again:
        files.close(None)
        files, segments = opened(tmp_path / "c")
    assert [one.first_seq for one in segments] == ([3, 3, 5, 7] if has_advance else [3, 5, 7])
    for start in range(36, 80):
        assert read(files, segments, start, 90)[1] == ("COLLECTED" if start <= 50 else None), start


@pytest.mark.asyncio
async def test_a_read_learns_from_the_store_which_times_the_dropped_items_had(tmp_path: Path) -> None:
    store = FakeStore()
    files = opened_files(tmp_path / "a", store, 1)
    files.write([[ArchivedRun(10, run(1, [10, 50]))]], NO_LIMITS)
    for seq, times in ((3, (30, 35)), (5, (36, 37)), (7, (40, 60))):
        files._end_segment()
        files.write([[ArchivedRun(1000, run(seq, times))]], ArchiveLimits(100, None))
    files.close(None)
    await move(files, store)
    owner = opened_files(tmp_path / "b", store, 2)
    owner.is_listed = False  # as with a list on the disk, while the store is unreachable
    assert read(owner, owner.segments, 45, 60) == ([8], None)
    first = min(store.objects)
    assert not any(first in call for call in store.calls if call.startswith("read")), "the store may be unreachable"
    segments = owner.find_again(owner.stored.find(2), 9)
    for start in range(45, 60):
        assert read(owner, segments, start, 60)[1] == ("COLLECTED" if start <= 50 else None), start


def test_a_file_of_an_earlier_release_does_not_show_the_latest_time_of_the_dropped_items(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    files = SegmentFiles(tmp_path / "c", {})
    files.open(1)
    files.write([[ArchivedRun(1000, run(3, [15, 30]))]], NO_LIMITS)
    files.close(None)
    files, segments = opened(tmp_path / "c")
    assert read(files, segments, 15, 40) == ([3, 4], None)
