"""Items that an archive lacks at its beginning, at its end, and in segments without any whole block: readers get
LOST.
"""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from stampede_rt.values.model import Policy, Reason
from stampede_rt.values.seq_starts import start_of
from stampede_rt.values.timeline import Bound, Interval, Match
from stampede_rt_channel_host.archive.clean_stop import CleanStop
from stampede_rt_channel_host.archive.recorder import ChannelRecorder
from stampede_rt_channel_host.archive.segment_files import SegmentFiles
from stampede_rt_channel_host.archive.written_parts import MissingSeqs
from stampede_rt_channel_host.channels.past_reads import PastReader
from stampede_rt_channel_host.channels.piece_scheduler import PieceScheduler
from stampede_rt_channel_host.core.archive import (
    HEAD_BYTES,
    ROW_BYTES,
    ArchivedRead,
    ArchivedRun,
    Hole,
    Segment,
    resolved,
    span_of,
)
from stampede_rt_channel_host.core.archive.stored_segment import object_name, segment_named
from stampede_rt_channel_host.core.channel import ChannelCore, Query, ReadAnswer, run_to_end
from stampede_rt_channel_host.core.group import Horizon
from tests.unit.channel_host.archive.test_archive_files import ALL, NO_LIMITS, decode, run_at, write
from tests.unit.channel_host.archive.test_host_archive_writes import archive_in

CLOCK = 1000


def files_of(folder: Path, *bounds: tuple[int, int]) -> list[Path]:
    """Write a file with two items in a block for each of these ranges of seqs. Returns the files, in order.

    The host accepts the items of the first file at the instant 0, and the items of the other files at 600.
    """
    for at, (first, end) in enumerate(bounds if bounds[0][0] == 1 else ((1, 1), *bounds)):
        files = SegmentFiles(folder, {})
        files.open(2)
        for seq in range(first, end, 2):
            files.write([[ArchivedRun(min(600 * at, 600), run_at(seq))]], NO_LIMITS)
        files.close(None)
    return sorted(folder.glob("*.segment"))


def ruin(path: Path) -> None:
    """Leave no block of a file that can be read."""
    path.write_bytes(b"\0" * path.stat().st_size)


def opened(folder: Path, epoch: int = 2) -> tuple[SegmentFiles, tuple[Segment, ...]]:
    files = SegmentFiles(folder, {})
    return files, files.open(epoch).segments


def read(
    files: SegmentFiles, segments: tuple[Segment, ...], start: int, end: int, channel: ChannelCore | None = None,
    *, newest_first: bool = False,
) -> tuple[list[int], Reason | None]:  # fmt: skip
    """The seqs and the reason of a get over the archive and the memory of `channel`."""
    query = Query(interval=Interval(Bound(None, start), Bound(None, end)), match=Match.START, newest_first=newest_first)
    if channel is None:
        channel = ChannelCore(Policy(max_items=100), incarnation=7)
        span = span_of(segments)
        channel.restore((), after=span.newest, next_seq=segments[-1].end_seq, loss=(None, None))
    moment, span = channel.snapshot(CLOCK), span_of(segments)
    within = resolved(moment, span, query)
    assert within is not None
    one = ArchivedRead(moment, span, query, within)
    run_to_end(one.begin())
    while (wanted := one.next_window()) is not None:
        run_to_end(one.take(files.load(segments, wanted, decode, lambda: None)))
    answer = one.answer()
    return sorted(part.first_seq + at for part in answer.slices for at in range(part.items)), answer.reason


def check(
    files: SegmentFiles, segments: tuple[Segment, ...], lost_seqs: set[int], last: int, *, knows_times: bool = False
) -> None:
    """Check that each read that lacks some of the items says LOST.

    `knows_times`: the archive knows the times of the lost items, so no other read says LOST. Otherwise all other reads
    say LOST, too: a lost item may have any of these times, because the limits of the channel would keep such an item.
    """
    for start in range(1, last + 1):
        for end in range(start, last + 1):
            for newest_first in (False, True):
                found, reason = read(files, segments, start, end, newest_first=newest_first)
                wanted = {*range(start, end + 1)}
                assert {*found} == wanted - lost_seqs
                expected_reason = "LOST" if wanted & lost_seqs or not knows_times else None
                assert reason == expected_reason, (start, end, newest_first, reason)


@pytest.mark.parametrize("restarts", [1, 2])
def test_a_first_file_without_a_whole_block_is_a_loss(tmp_path: Path, restarts: int) -> None:
    ruin(files_of(tmp_path, (1, 5), (5, 9))[0])
    for _ in range(restarts):
        files, segments = opened(tmp_path)
    check(files, segments, {1, 2, 3, 4}, 8)
    assert segments[0].first_seq == 1, "a subscription says LOST from this seq on"


def test_the_loss_of_the_first_file_goes_to_the_object_store_with_the_second_one(tmp_path: Path) -> None:
    ruin(files_of(tmp_path, (1, 5), (5, 9))[0])
    files, segments = opened(tmp_path)
    moved = segment_named(object_name(segments[0]))
    assert moved is not None
    check(files, (moved,), {1, 2, 3, 4}, 8)


def test_a_second_file_says_lost_if_the_first_file_has_no_whole_block(tmp_path: Path) -> None:
    files, _ = opened(tmp_path)
    write(files, 1, 2)
    files.close(CleanStop(7, epoch=2))
    [path] = tmp_path.glob("*.segment")
    ruin(path)
    files, segments = opened(tmp_path)
    assert segments == ()
    segments = write(files, 5, 2)
    check(files, segments, {1, 2, 3, 4}, 8)


def test_the_limits_count_again_once_the_file_after_the_damaged_one_has_gone(tmp_path: Path) -> None:
    ruin(files_of(tmp_path, (1, 5), (5, 9), (9, 13))[0])
    files, _ = opened(tmp_path)
    segments = files.drop_outdated(NO_LIMITS._replace(bytes_max=1), CLOCK)
    assert span_of(segments).is_cut
    assert read(files, segments, 1, 12)[1] == "COLLECTED"
    _, reopened = opened(tmp_path)
    assert span_of(reopened).is_cut


@pytest.mark.parametrize("which", [0, 1, 2])
def test_a_file_that_loses_all_its_blocks_after_the_start_is_a_loss(tmp_path: Path, which: int) -> None:
    paths = files_of(tmp_path, (1, 5), (5, 9), (9, 13))
    _, segments = opened(tmp_path)
    ruin(paths[which])
    lost_seqs = {*range(1 + 4 * which, 5 + 4 * which)}
    check(SegmentFiles(tmp_path, {}), segments, lost_seqs, 12, knows_times=True)


def test_items_that_max_bytes_collected_before_all_archived_ones_are_a_loss(tmp_path: Path) -> None:
    files, _ = opened(tmp_path)
    segments = files.write([MissingSeqs(1, 5), [ArchivedRun(1, run_at(5))]], NO_LIMITS)
    check(files, segments, {1, 2, 3, 4}, 6)


def test_items_that_max_bytes_collected_after_all_archived_ones_are_a_loss(tmp_path: Path) -> None:
    files, _ = opened(tmp_path)
    segments = files.write([[ArchivedRun(1, run_at(1))], MissingSeqs(3, 7)], NO_LIMITS)
    channel = ChannelCore(Policy(max_items=100), incarnation=7)
    channel.restore([run_at(7)], after=6, next_seq=9, loss=(None, None))
    for start in range(1, 9):
        for end in range(start, 9):
            if start > 6:
                continue  # such a read does not ask the archive
            found, reason = read(files, segments, start, end, channel)
            assert found == [one for one in range(start, end + 1) if one in (1, 2, 7, 8)]
            assert reason == "LOST", (start, end)  # a lost item may have any time: max_items would keep it


def test_a_loss_stays_if_the_next_host_has_written_nothing_else(tmp_path: Path) -> None:
    files_of(tmp_path, (1, 5))
    for parts in ([MissingSeqs(5, 5, 300)], [[ArchivedRun(600, run_at(5))]]):
        files, segments = opened(tmp_path)
        segments = files.write(parts, NO_LIMITS)
        files.close(None)
    assert [one.items for one in segments] == [4, 0, 2]
    window = files.load(segments, ALL, decode, lambda: None)
    assert window.holes == [Hole(1, 299, 0)]  # the items of 1 to 4 were accepted at the instant 0


def past(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, channel: ChannelCore, as_of: int, *, start: int = 1,
    horizon: Horizon | None = None,
) -> ReadAnswer:  # fmt: skip
    """The answer of a read of everything from `start` on, as of an instant."""

    async def scenario() -> ReadAnswer:
        archive = archive_in(tmp_path / "a", monkeypatch)
        files, segments = opened(tmp_path / "c")
        reader = PastReader(archive, ChannelRecorder(channel, files, segments), channel)
        query = Query(interval=Interval(Bound(None, start), Bound(None, 2**62)), match=Match.START)
        found = await reader.read(query, as_of, PieceScheduler(), horizon)
        await archive.close([])
        return found.answer

    return asyncio.run(scenario())


@pytest.mark.parametrize("as_of", [0, 599])
def test_a_read_as_of_the_time_of_a_damaged_first_file_says_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, as_of: int
) -> None:
    ruin(files_of(tmp_path / "c", (1, 5), (5, 9))[0])
    channel = ChannelCore(Policy(max_items=100), incarnation=7)
    channel.restore((), after=8, next_seq=9, loss=(None, None))
    assert past(tmp_path, monkeypatch, channel, as_of).reason == "LOST"


@pytest.mark.parametrize("cut", [None, 3])
def test_a_read_through_a_group_as_of_an_instant_before_the_first_item_finds_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cut: int | None
) -> None:
    files_of(tmp_path / "c", (1, 5))
    channel = ChannelCore(Policy(max_items=100), incarnation=7)
    channel.restore((), after=4, next_seq=5, loss=(None, None))
    answer = past(tmp_path, monkeypatch, channel, -1, horizon=Horizon(cut, str))
    assert (list(answer.slices), answer.reason) == ([], "NOT_YET")


@pytest.mark.parametrize(("as_of", "reason"), [(-1, "NOT_YET"), (550, "LOST"), (650, "LOST")])
def test_a_read_as_of_an_instant_says_lost_for_the_items_after_the_last_known_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, as_of: int, reason: str
) -> None:
    files, _ = opened(tmp_path / "c")
    files.write([[ArchivedRun(0, run_at(1))], MissingSeqs(3, 7), [ArchivedRun(600, run_at(601))]], NO_LIMITS)
    files.write([MissingSeqs(603, 605)], NO_LIMITS)
    files.close(None)
    channel = ChannelCore(Policy(max_items=100), incarnation=7)
    channel.restore((), after=602, next_seq=605, loss=(None, None))
    late = {-1: 0, 550: 500, 650: 640}[as_of]
    assert past(tmp_path, monkeypatch, channel, as_of, start=late).reason == reason


@pytest.mark.parametrize("newest_first", [False, True])
def test_a_hole_after_a_first_file_without_a_whole_block_is_a_loss(tmp_path: Path, newest_first: bool) -> None:
    [first] = files_of(tmp_path, (1, 5))
    files, _ = opened(tmp_path)
    segments = files.write([MissingSeqs(5, 9), [ArchivedRun(600, run_at(9))]], NO_LIMITS)
    ruin(first)
    files = SegmentFiles(tmp_path, {})
    for start, end in ((2, 3), (6, 6), (6, 9), (1, 10)):
        assert read(files, segments, start, end, newest_first=newest_first)[1] == "LOST"
    assert read(files, segments, 9, 10, newest_first=newest_first) == ([9, 10], "LOST")  # items could still come late


@pytest.mark.parametrize("after_start", [False, True])
@pytest.mark.parametrize(
    ("policy", "first", "last"),
    [
        (Policy(max_age_nanos=7, max_future_nanos=0), 6, 21),  # the host accepted the items from 15 to 21
        (Policy(max_age_nanos=7, max_future_nanos=3), 6, 24),
        (Policy(max_items=3, max_future_nanos=0), 9, 21),  # the file before has more than three items, from 9 on
        (Policy(max_items=100, max_future_nanos=0), 1, 21),
        (Policy(max_bytes=7 * 71, max_future_nanos=0), 9, 21),  # the file before has eight items of 71 bytes
        (Policy(max_bytes=8 * 71, max_future_nanos=0), 1, 21),
    ],
)
def test_items_without_known_times_are_a_loss_wherever_the_limits_let_them_come(
    tmp_path: Path, policy: Policy, first: int, last: int, after_start: bool
) -> None:
    for begin, end in ((1, 9), (9, 17), (17, 33)):
        files, _ = opened(tmp_path)
        for seq in range(begin, end, 2):
            if seq != 19 or after_start:
                files.write([[ArchivedRun(seq, run_at(seq))]], NO_LIMITS)
            else:
                files.write([MissingSeqs(19, 21)], NO_LIMITS)
        files.close(CleanStop(7, epoch=2))
    if after_start:
        raw = bytearray((path := sorted(tmp_path.glob("*.segment"))[-1]).read_bytes())
        raw[raw.index(b"19 ") - ROW_BYTES - HEAD_BYTES] ^= 1
        path.write_bytes(raw)
    files, segments = opened(tmp_path)
    channel = ChannelCore(policy, incarnation=7)
    channel.restore((), after=32, next_seq=33, loss=(None, None))
    expected_reason = [time for time in range(1, 33) if read(files, segments, time, time, channel)[1] == "LOST"]
    assert expected_reason == [*range(first, last + 1)]


def test_a_read_of_the_newest_items_says_lost_for_a_loss_after_them() -> None:
    channel = ChannelCore(Policy(max_items=100), incarnation=7)
    channel.restore([run_at(1), run_at(3)], after=0, next_seq=5, loss=(5, 9))
    answers = []
    for end in (4, 6):
        interval = Interval(Bound(None, 1), Bound(None, end))
        query = Query(interval=interval, match=Match.START, newest_first=True, limit=1)
        answers.append(channel.read(query, CLOCK))
    assert [(one.more, one.reason) for one in answers] == [(True, None), (True, "LOST")]


FIRST = start_of(2)
CLEAN, LOST_ALL, LOST_PART = (None, None), (500, None), (500, 4)  # `lost_before` and `lost_from` of the channel


@pytest.mark.parametrize(
    ("bounds", "dropped", "loss", "expected"),
    [
        (((1, 5), (5, 9)), 0, CLEAN, "NOT_YET"),  # the archive has all items, and the host had accepted none by then
        (((1, 5), (5, 9)), 1, CLEAN, "COLLECTED"),
        (((1, 5), (FIRST, FIRST + 4)), 0, CLEAN, "NOT_YET"),
        (((1, 5), (FIRST, FIRST + 4)), 0, LOST_PART, "NOT_YET"),
        (((1, 5), (FIRST, FIRST + 4)), 1, CLEAN, "COLLECTED"),  # the limits have dropped the first epoch
        (((1, 5), (FIRST, FIRST + 4)), 1, LOST_PART, "COLLECTED"),
        (((FIRST, FIRST + 4),), 0, LOST_ALL, "LOST"),  # the former owner had archived nothing
        (((FIRST, FIRST + 4), (FIRST + 4, FIRST + 8)), 1, LOST_ALL, "COLLECTED"),
        (((1, 5), (FIRST, FIRST + 4), (start_of(3), start_of(3) + 4)), 2, CLEAN, "COLLECTED"),
    ],
)
def test_a_read_before_the_first_item_of_a_later_epoch_says_why_earlier_items_are_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, bounds: tuple[tuple[int, int], ...], dropped: int,
    loss: tuple[int | None, int | None], expected: str,
) -> None:  # fmt: skip
    for path in files_of(tmp_path / "c", *bounds)[:dropped]:
        path.unlink()
    lost_before, lost_from = loss
    channel = ChannelCore(Policy(max_items=100), incarnation=7, lost_before=lost_before)
    channel.restore((), after=bounds[-1][1], next_seq=bounds[-1][1], loss=(lost_from, lost_before))
    assert past(tmp_path, monkeypatch, channel, -1).reason == expected
    files, segments = opened(tmp_path / "c")
    found, reason = read(files, segments, 1, 3, channel)
    assert found == ([1, 2, 3] if bounds[0][0] == 1 and not dropped else [])
    if found:  # an owner that follows a lost one begins at the first seq of its epoch
        expected = "LOST" if bounds[1][0] == FIRST else "NOT_YET"
    assert reason == (None if expected == "NOT_YET" else expected)
