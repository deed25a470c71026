"""Waits for stable storage: until the archive has the items, or until it cannot have them."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest

from stampede_rt.values.model import Policy
from stampede_rt_channel_host.archive.recorder import ChannelRecorder
from stampede_rt_channel_host.archive.segment_files import ArchiveLimits, SegmentFiles
from stampede_rt_channel_host.archive.written_parts import WrittenPart
from stampede_rt_channel_host.core.archive import ArchivedRun, Segment
from stampede_rt_channel_host.core.channel import ChannelCore, Offer, Slice, make_run
from tests.unit.channel_host.archive.test_host_archive_writes import FILES, archive_in, recorded, refuse


async def wait_until_written(recorder: ChannelRecorder) -> str:
    """Wait until all items are on stable storage, or cannot get there. Returns the reason in that case."""
    return await recorder.stored(1, recorder.archived_to + recorder.backlog_items, 60)


def success_of(recorder: ChannelRecorder, monkeypatch: pytest.MonkeyPatch) -> asyncio.Event:
    """An event that is set when a write of the channel has succeeded."""
    succeeded, note_end = asyncio.Event(), recorder.note_end

    def note(failure: str) -> None:
        note_end(failure)
        if not failure:
            succeeded.set()

    monkeypatch.setattr(recorder, "note_end", note)
    return succeeded


def test_a_wait_for_stable_storage_makes_the_archive_write_immediately(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def scenario() -> str:
        archive = archive_in(tmp_path / "a", monkeypatch)
        monkeypatch.setattr("stampede_rt_channel_host.archive.host_archive.WRITE_AFTER_SECONDS", 3600)
        recorder, put = recorded(archive, tmp_path / "c")
        put()
        archive.hurry()
        why = await wait_until_written(recorder)
        put()
        archive.hurry()
        why += await wait_until_written(recorder)
        await archive.close([recorder])
        return why

    assert asyncio.run(scenario()) == ""
    found = SegmentFiles(tmp_path / "c", {}).open(1)
    assert sum(one.items for one in found.segments) == 2


def test_a_disk_failure_ends_the_waits_of_a_channel_with_the_reason_and_delays_no_other_channel(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def scenario() -> tuple[str, str, str, str, str]:
        archive = archive_in(tmp_path / "a", monkeypatch)
        monkeypatch.setattr("stampede_rt_channel_host.archive.host_archive.RETRY_SECONDS", 0.01)
        broken, put_broken = recorded(archive, tmp_path / "broken")
        whole, put_whole = recorded(archive, tmp_path / "whole")
        with monkeypatch.context() as fault:
            fault.setattr(broken.files, "write", refuse)
            put_broken()
            put_whole()
            refused, kept, failing = await wait_until_written(broken), await wait_until_written(whole), archive.failure
        await success_of(broken, monkeypatch).wait()  # the host tries again by itself
        healed = await wait_until_written(broken)
        await archive.close([broken, whole])
        return refused, kept, failing, healed, archive.failure

    assert asyncio.run(scenario()) == ("Read-only file system", "", "Read-only file system", "", "")


def test_a_channel_that_fails_waits_for_its_next_try_without_the_writer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def scenario() -> list[str]:
        archive = archive_in(tmp_path / "a", monkeypatch)
        monkeypatch.setattr("stampede_rt_channel_host.archive.host_archive.RETRY_SECONDS", 3600)
        broken, put_broken = recorded(archive, tmp_path / "broken")
        whole, put_whole = recorded(archive, tmp_path / "whole")
        monkeypatch.setattr(broken.files, "write", refuse)
        answers = []
        for _ in range(3):
            put_broken()
            put_whole()
            answers.append(await wait_until_written(whole))
        archive.forget(broken)
        answers.append(archive.failure)
        await archive.close([whole])
        return answers

    assert asyncio.run(scenario()) == ["", "", "", ""]


def test_an_fsync_after_a_failed_fsync_fails_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    async def scenario() -> tuple[str, str]:
        archive = archive_in(tmp_path / "a", monkeypatch)
        monkeypatch.setattr("stampede_rt_channel_host.archive.host_archive.RETRY_SECONDS", 0.01)
        recorder, put = recorded(archive, tmp_path / "c")
        put()
        assert await wait_until_written(recorder) == ""
        with monkeypatch.context() as fault:
            fault.setattr(f"{FILES}.os.fsync", refuse)
            put()
            refused = await wait_until_written(recorder)
        await success_of(recorder, monkeypatch).wait()
        healed = await wait_until_written(recorder)
        await archive.close([recorder])
        return refused, healed

    assert asyncio.run(scenario()) == ("Read-only file system", "")
    segments = SegmentFiles(tmp_path / "c", {}).open(1).segments
    assert [one.items for one in segments] == [1, 1]  # the bytes after a failed fsync are in a new file


def test_items_that_memory_lost_before_they_were_written_are_never_stored(tmp_path: Path) -> None:
    async def scenario() -> list[str]:
        channel = ChannelCore(Policy(max_bytes=300), incarnation=7)
        files = SegmentFiles(tmp_path / "c", {})
        files.open(1)
        recorder = ChannelRecorder(channel, files, ())
        for seq in range(1, 9):
            channel.put(
                Offer(times=[seq], durations=None, lengths=[1]), seq, lambda first, kept, stamped: b"%d " % first
            )
            recorder.note(seq)
        job = recorder.take()
        recorder.written(job, job.files.write(job.parts, job.limits))
        return [await recorder.stored(seq, seq + 1, 0) for seq in (1, 8)]

    lost, kept = asyncio.run(scenario())
    assert "before they were written" in lost
    assert kept == ""


def test_a_wait_ends_after_its_time_limit_and_when_the_host_gives_the_channel_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def scenario() -> tuple[str, str]:
        archive = archive_in(tmp_path / "a", monkeypatch)
        monkeypatch.setattr("stampede_rt_channel_host.archive.host_archive.WRITE_AFTER_SECONDS", 3600)
        recorder, put = recorded(archive, tmp_path / "c")
        put()
        slow = await recorder.stored(1, 2, 0)
        waits = asyncio.create_task(recorder.stored(1, 2, None))
        await asyncio.sleep(0)
        archive.forget(recorder)
        given_up = await waits
        await archive.close([])
        return slow, given_up

    assert asyncio.run(scenario()) == ("the disk is too slow", "the host gave the channel up")


def put_at(channel: ChannelCore, seq: int) -> None:
    channel.put(Offer(times=[seq], durations=None, lengths=[1]), seq, lambda first, kept, stamped: b"%d " % first)


def test_a_disk_that_fails_for_long_costs_no_memory_for_the_puts_that_memory_has_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("stampede_rt_channel_host.archive.waiting_puts.JOIN_FROM_PUTS", 16)
    channel, files = ChannelCore(Policy(max_bytes=300), incarnation=7), SegmentFiles(tmp_path / "c", {})
    files.open(1)
    recorder = ChannelRecorder(channel, files, ())
    kept = []
    for seq in range(1, 1001):
        put_at(channel, seq)
        recorder.note(seq)
        kept.append(len(recorder._puts._ends))
    assert max(kept) <= 16
    assert recorder.waiting_since == 1
    parts = recorder.take().parts
    held = [one for part in parts if isinstance(part, list) for one in part]
    assert [one.accepted for one in held] == [one.run.first_seq for one in held]
    assert held[-1].accepted == 1000


def test_a_recorder_of_a_channel_that_has_moved_sizes_its_items_a_part_at_a_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("stampede_rt_channel_host.archive.recorder.SLICES_PER_NOTE", 10)
    channel, files = ChannelCore(Policy(max_items=1000), incarnation=7), SegmentFiles(tmp_path / "c", {})
    looked: list[int] = []
    accepted_from = channel.accepted_from

    def counted(seq: int) -> Iterator[Slice]:
        for one in accepted_from(seq):
            looked.append(one.first_seq)
            yield one

    for time in range(25):
        channel.put(Offer(times=[time], durations=None, lengths=[100]), time, lambda seq, kept, stamped: b"x" * 100)
    recorder = ChannelRecorder(channel, files, (), from_memory=True)
    monkeypatch.setattr(channel, "accepted_from", counted)
    unwritten = []
    for _ in range(4):
        looked.clear()
        assert recorder.note(30)
        assert len(looked) <= 10
        unwritten.append(recorder.disk.unwritten_bytes)
    assert unwritten == sorted(unwritten)
    assert unwritten[0] < unwritten[2] == unwritten[3]
    assert recorder.disk.unwritten_bytes >= 25 * 100


@pytest.mark.parametrize("hole_at", [5, 25])
def test_the_new_owner_of_a_shared_archive_leaves_all_items_before_the_last_hole_to_the_former_owner(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, hole_at: int
) -> None:
    monkeypatch.setattr("stampede_rt_channel_host.archive.moved_items.SLICES_PER_LOOK", 10)

    async def scenario() -> list[ArchivedRun]:
        archive = archive_in(tmp_path / "a", monkeypatch)
        channel, files = moved_channel(hole_at, 40), SegmentFiles(tmp_path / "c", {})
        files.is_shared = True
        files.open(2)
        recorder = ChannelRecorder(channel, files, (), from_memory=True)
        written: list[ArchivedRun] = []
        write = files.write

        def kept(parts: Sequence[WrittenPart], limits: ArchiveLimits) -> tuple[Segment, ...]:
            for part in parts:
                assert isinstance(part, list), "no gap is written over the items of the former owner"
                written.extend(part)
            return write(parts, limits)

        monkeypatch.setattr(files, "write", kept)
        put_at(channel, 40)  # comes after the move, and before all items were looked at
        if recorder.note(40):
            archive.touch(recorder, lambda: None)
        assert await recorder.stored(40, 41, 60) == ""
        await archive.close([recorder])
        return written

    written = asyncio.run(scenario())
    assert [one.run.first_seq for one in written] == [*range(hole_at + 1, 41)]


def moved_channel(hole_at: int, next_seq: int) -> ChannelCore:
    """A channel that came with a move, without the item `hole_at`."""
    channel = ChannelCore(Policy(max_items=1000), incarnation=7)
    runs = [make_run(seq, [seq], None, [1], b"%d " % seq) for seq in range(1, next_seq) if seq != hole_at]
    channel.restore(runs, after=None, next_seq=next_seq, loss=(None, None))
    return channel
