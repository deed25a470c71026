"""Items that leave memory before the archive has them: readers get them later, or learn of their loss."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from stampede_rt.values.model import Policy, Reason
from stampede_rt.values.timeline import NOW, OLDEST, Bound, Interval, Match
from stampede_rt_channel_host.archive.disk_use import DiskUse
from stampede_rt_channel_host.archive.host_archive import HostArchive
from stampede_rt_channel_host.archive.recorder import ChannelRecorder
from stampede_rt_channel_host.archive.segment_files import SegmentFiles
from stampede_rt_channel_host.channels.archive_status import archive_status
from stampede_rt_channel_host.channels.opened_archives import OpenedChannelArchive
from stampede_rt_channel_host.channels.piece_scheduler import PieceScheduler
from stampede_rt_channel_host.channels.recording import Recording
from stampede_rt_channel_host.core.channel import (
    ITEM_OVERHEAD_BYTES,
    ChannelCore,
    Offer,
    Query,
    ReadAnswer,
    run_to_end,
)
from stampede_rt_channel_host.core.group import Horizon, VisibleChannel
from tests.support.waiting import until
from tests.unit.channel_host.archive.test_host_archive_writes import SlowDisk, archive_in, refuse

CLOCK = 1000
HELD = 4  # the items that memory holds
LARGEST = 2**20


class RecordedChannel:
    """A recorded channel whose puts have two items: the item with the seq n has the time n."""

    def __init__(self, archive: HostArchive, recording: Recording, channel: ChannelCore) -> None:
        self.archive, self.recording, self.channel = archive, recording, channel

    def put(self, runs: int = 1) -> None:
        for _ in range(runs):
            at = self.channel.next_seq
            put(self.channel, at)
            self.recording.accepted(at)

    async def write(self) -> None:
        """Wait until the last item is on the disk."""
        end_seq = self.channel.next_seq
        assert await self.recording.recorder.stored(end_seq - 1, end_seq, 60) == ""

    async def read_in_group(self, cut: int | None, *, newest_first: bool = False) -> tuple[list[int], Reason | None]:
        """Read all items, through a group with this cut."""
        interval, horizon = Interval(Bound(None, 1), Bound(None, CLOCK)), Horizon(cut, lambda: "held back by nobody")
        query = Query(interval=interval, match=Match.START, newest_first=newest_first)
        if self.recording.reaches_in_group(query, horizon, CLOCK):
            view = await self.recording.read_in_group(
                query, horizon, None, PieceScheduler(), lambda: CLOCK, waits=False
            )
            return seqs_of(view.answer), view.answer.reason
        answer = VisibleChannel(self.channel).read(query, horizon, CLOCK)
        return seqs_of(answer), answer.reason

    async def read(
        self, *, start: int = 1, end: int = CLOCK, newest_first: bool = False
    ) -> tuple[list[int], Reason | None]:
        """The seqs of the items, and the reason: from memory if that is enough, as the host decides it."""
        return await self.answer(Interval(Bound(None, start), Bound(None, end)), newest_first=newest_first)

    async def answer(self, interval: Interval, *, newest_first: bool = False) -> tuple[list[int], Reason | None]:
        """Like `read`, for an interval."""
        query = Query(interval=interval, match=Match.START, newest_first=newest_first)
        if self.recording.reaches(query, CLOCK):
            read = await self.recording.read(query, None, PieceScheduler(), lambda: CLOCK)
            answer = read.answer()
        else:
            answer = self.channel.read(query, CLOCK)
        return seqs_of(answer), answer.reason

    def counts(self) -> tuple[int, int]:
        """The items that wait for the disk, and the items that the archive will never have, as callers see them."""
        status = run_to_end(archive_status(self.recording.recorder, self.archive))
        return status.waiting, status.unarchived


def seqs_of(answer: ReadAnswer) -> list[int]:
    return sorted(part.first_seq + at for part in answer.slices for at in range(part.items))


def put(channel: ChannelCore, at: int) -> None:
    offer = Offer(times=[at, at + 1], durations=None, lengths=[7, 7])
    channel.put(offer, at, lambda first_seq, kept, stamped: b"%d " % first_seq)


@asynccontextmanager
async def recorded_channel(
    folder: Path, monkeypatch: pytest.MonkeyPatch, earlier: int = 0
) -> AsyncIterator[RecordedChannel]:
    """`earlier`: how many puts the channel takes before its recording begins."""
    monkeypatch.setattr("stampede_rt_channel_host.archive.host_archive.RETRY_SECONDS", 0.01)
    monkeypatch.setattr("stampede_rt_channel_host.archive.recorder.SETTLE_SECONDS_MAX", 60)
    archive = archive_in(folder / "a", monkeypatch)
    files = SegmentFiles(folder / "c", {})
    channel = ChannelCore(Policy(max_bytes=HELD * (7 + ITEM_OVERHEAD_BYTES)), incarnation=7)
    for at in range(1, 2 * earlier, 2):
        put(channel, at)
    opened = OpenedChannelArchive(files, files.open(1, 7), None, DiskUse().of_channel(b"", ""))
    recording = Recording(archive, opened, channel, lambda body, lo, hi: body, lambda: None)
    yield RecordedChannel(archive, recording, channel)
    await archive.close([recording.recorder])


async def put_during_a_write(one: RecordedChannel, monkeypatch: pytest.MonkeyPatch, later_runs: int = 2) -> SlowDisk:
    """Put two runs, and wait until their write has reached the disk. Then put `later_runs` more.

    Memory holds only the last four items. Returns the disk, on which the write waits.
    """
    disk = SlowDisk(monkeypatch)
    one.put(2)
    assert await asyncio.to_thread(disk.reached.wait, 60)
    one.put(later_runs)
    return disk


async def test_while_the_disk_fails_reads_name_the_items_that_memory_has_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with recorded_channel(tmp_path, monkeypatch) as one:
        one.put(2)
        await one.write()
        with monkeypatch.context() as fault:
            fault.setattr(one.recording.recorder.files, "write", refuse)
            one.put(5)  # the seqs 5 to 14; memory holds the last four
            await until(lambda: bool(one.recording.recorder.failure))
            for newest_first in (False, True):
                found, reason = await one.read(newest_first=newest_first)
                assert found == [1, 2, 3, 4, 11, 12, 13, 14]
                assert reason == "LOST"
                assert "lacks 6 items" in reason.detail
            assert one.counts() == (4, 6)
        await until(lambda: not one.recording.recorder.backlog_items)
        found, reason = await one.read()
        assert (found, reason) == ([1, 2, 3, 4, 11, 12, 13, 14], "LOST")
        assert one.counts() == (0, 6)


async def test_a_read_names_the_items_that_memory_has_lost_before_the_first_write(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with recorded_channel(tmp_path, monkeypatch) as one:
        with monkeypatch.context() as fault:
            fault.setattr(one.recording.recorder.files, "write", refuse)
            one.put(5)
            await until(lambda: bool(one.recording.recorder.failure))
            for newest_first in (False, True):
                found, reason = await one.read(newest_first=newest_first)
                assert (found, reason) == ([7, 8, 9, 10], "LOST")
                assert reason is not None
                assert "lacks 6 items" in reason.detail
            assert await one.read(start=8) == ([8, 9, 10], None)
        await until(lambda: not one.recording.recorder.backlog_items)
        found, reason = await one.read()
        assert (found, reason) == ([7, 8, 9, 10], "LOST")


async def test_before_the_first_write_items_that_left_memory_before_the_recording_began_are_collected(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with recorded_channel(tmp_path, monkeypatch, earlier=3) as one:  # memory holds the seqs 3 to 6
        monkeypatch.setattr(one.recording.recorder.files, "write", refuse)
        one.put(4)  # the seqs 7 to 14
        await until(lambda: bool(one.recording.recorder.failure))
        found, reason = await one.read(end=6)
        assert (found, reason) == ([], "COLLECTED")
        found, reason = await one.read()
        assert (found, reason) == ([11, 12, 13, 14], "LOST")
        assert reason is not None
        assert "lacks 4 items" in reason.detail


async def test_a_read_from_the_oldest_item_waits_for_the_first_write_of_items_that_have_left_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with recorded_channel(tmp_path, monkeypatch) as one:
        disk = await put_during_a_write(one, monkeypatch)
        reading = asyncio.create_task(one.answer(Interval(OLDEST, NOW)))
        await asyncio.sleep(0)
        disk.may_continue.set()
        assert await reading == ([*range(1, 9)], None)


@pytest.mark.parametrize("has_segments", [False, True])
async def test_a_read_waits_for_the_write_of_items_that_have_left_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, has_segments: bool
) -> None:
    async with recorded_channel(tmp_path, monkeypatch) as one:
        if has_segments:
            one.put()
            await one.write()
        disk = await put_during_a_write(one, monkeypatch)
        reading = asyncio.create_task(one.read())
        await asyncio.sleep(0)
        disk.may_continue.set()
        assert await reading == ([*range(1, one.channel.next_seq)], None)


async def test_a_subscription_waits_for_the_write_of_items_that_have_left_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with recorded_channel(tmp_path, monkeypatch) as one:
        cursor = one.channel.subscribe_all(CLOCK)
        # the write has the seqs 1 to 4; memory holds 11 to 14; the next write cannot have 5 to 10
        disk = await put_during_a_write(one, monkeypatch, later_runs=5)
        feeding = asyncio.create_task(one.recording.since(cursor, LARGEST, lambda: CLOCK))
        await asyncio.sleep(0)
        disk.may_continue.set()
        batch = await feeding
        assert batch is not None
        assert batch.gap is None
        assert [part.slice.first_seq for part in batch.slices] == [1, 3]
        batch = await one.recording.since(cursor, LARGEST, lambda: CLOCK)
        assert batch is not None
        assert batch.gap is not None
        assert (batch.gap.first_seq, batch.gap.last_seq, batch.gap.reason) == (5, 10, "LOST")


@pytest.mark.parametrize("start", [2, 7])
async def test_a_subscription_that_begins_among_lost_items_names_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, start: int
) -> None:
    async with recorded_channel(tmp_path, monkeypatch) as one:
        one.put(2)
        await one.write()
        monkeypatch.setattr(one.recording.recorder.files, "write", refuse)
        one.put(5)  # the seqs 5 to 14; memory holds the last four
        await until(lambda: bool(one.recording.recorder.failure))
        where = one.recording.beginning({"start": Bound(None, start)}, CLOCK)
        cursor = run_to_end(one.channel.subscribing_all(CLOCK, **where))
        found: list[int] = []
        gaps: list[tuple[int, int, Reason]] = []
        while cursor.next_seq < 15:
            batch = await one.recording.since(cursor, LARGEST, lambda: CLOCK)
            if batch is None:
                batch = one.channel.since(cursor, CLOCK, LARGEST)
            if batch.gap is not None:
                gaps.append((batch.gap.first_seq, batch.gap.last_seq, batch.gap.reason))
            found += [seq for part in batch.slices for seq in range(part.slice.first_seq, part.slice.end_seq)]
        assert (found, cursor.dropped) == ([*range(start, 5), *range(11, 15)], 6)
        assert gaps == [(5, 10, "LOST")]


@pytest.mark.parametrize(
    ("start", "has_segments", "first"),
    [(Bound(None, 4), False, 4), (Bound(None, 4), True, 4), (OLDEST, False, 1), (OLDEST, True, 1)],
)
async def test_a_subscription_begins_with_items_that_have_left_memory_during_their_write(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, start: Bound, has_segments: bool, first: int
) -> None:
    async with recorded_channel(tmp_path, monkeypatch) as one:
        if has_segments:
            one.put()
            await one.write()
        disk = await put_during_a_write(one, monkeypatch)
        where = one.recording.beginning({"start": start}, CLOCK)
        cursor = run_to_end(one.channel.subscribing_all(CLOCK, **where))
        feeding = asyncio.create_task(one.recording.since(cursor, LARGEST, lambda: CLOCK))
        await asyncio.sleep(0)
        disk.may_continue.set()
        batch = await feeding
        assert batch is not None
        assert batch.gap is None
        assert batch.slices[0].slice.first_seq == first


def test_a_write_that_takes_a_run_saves_the_items_of_the_run_that_have_left_memory(tmp_path: Path) -> None:
    channel = ChannelCore(Policy(max_bytes=3 * (7 + ITEM_OVERHEAD_BYTES)), incarnation=7)
    files = SegmentFiles(tmp_path, {})
    files.open(1)
    recorder = ChannelRecorder(channel, files, ())
    for first in (1, 3, 5):
        offer = Offer(times=[first, first + 1], durations=None, lengths=[7, 7])
        channel.put(offer, first, lambda first_seq, kept, stamped: b"%d " % first_seq)
        recorder.note(first)
    job = recorder.take()  # memory holds the seqs 4 to 6, and the run of the item 3
    assert (channel.backlog.lost, channel.backlog.at_risk) == (2, 1)
    recorder.note_end("no space left on device")
    assert (recorder.lost_items, recorder.waiting_items, recorder.unarchived) == (3, 3, 3)
    job = recorder.take()
    recorder.written(job, files.write(job.parts, job.limits))
    assert (recorder.lost_items, recorder.waiting_items, recorder.unarchived) == (0, 0, 2)
    assert sum(one.items for one in recorder.segments) == 4
