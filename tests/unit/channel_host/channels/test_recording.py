"""Reads of a recorded channel whose callers go away."""

from __future__ import annotations

import asyncio
import threading
from pathlib import Path
from typing import Any

import pytest

from stampede_rt.values.model import Policy
from stampede_rt.values.timeline import NOW, OLDEST, Bound, Interval, Match
from stampede_rt_channel_host.archive.clean_stop import CleanStop
from stampede_rt_channel_host.archive.disk_use import DiskUse
from stampede_rt_channel_host.archive.host_archive import HostArchive
from stampede_rt_channel_host.archive.segment_files import SegmentFiles
from stampede_rt_channel_host.channels.opened_archives import OpenedChannelArchive
from stampede_rt_channel_host.channels.piece_scheduler import PieceScheduler
from stampede_rt_channel_host.channels.recording import Recording
from stampede_rt_channel_host.core.archive import WantedItems, WantedWindow, archived_read
from stampede_rt_channel_host.core.channel import FIRST_KEY, ChannelCore, Offer, Query, Run, make_run
from stampede_rt_channel_host.core.channel.item_keys import LAST_KEY
from tests.unit.channel_host.archive.test_archive_files import opened, write
from tests.unit.channel_host.archive.test_host_archive_writes import archive_in


def test_a_long_read_of_an_archive_ends_with_its_present_window_when_its_caller_vanishes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(archived_read, "FIRST_WINDOW_BYTES", 1)
    monkeypatch.setattr(archived_read, "WINDOW_BYTES", 1)
    files, _ = opened(tmp_path / "c")
    write(files, 1, 100)
    files.close(CleanStop(7, epoch=2))
    begun, may_continue, loads = threading.Event(), threading.Event(), []

    async def scenario() -> int:
        archive = archive_in(tmp_path / "a", monkeypatch)
        files, _ = opened(tmp_path / "c")
        found = files.open(2, 7)
        channel = ChannelCore(Policy(max_items=2), incarnation=7)
        disk = DiskUse().of_channel(b"", "")
        wanted = WantedItems(FIRST_KEY[0], LAST_KEY, 0, 1, down=True)
        newest = await archive.load(files, found.segments, WantedWindow(wanted, FIRST_KEY, LAST_KEY))
        archived = OpenedChannelArchive(files, found, newest, disk)
        recording = Recording(archive, archived, channel, lambda body, lo, hi: body, lambda: None)
        load = files.load

        def slow(*arguments: Any) -> Any:
            loads.append(1)
            begun.set()
            assert may_continue.wait(60)
            return load(*arguments)

        monkeypatch.setattr(files, "load_at_hand", lambda *_: None)
        monkeypatch.setattr(files, "load", slow)
        query = Query(interval=Interval(OLDEST, NOW))
        reading = asyncio.create_task(recording.read(query, None, PieceScheduler(), lambda: 1000))
        assert await asyncio.to_thread(begun.wait, 60)
        reading.cancel()
        with pytest.raises(asyncio.CancelledError):
            await reading
        may_continue.set()
        held, _ = channel.look(1000)
        assert not held._snapshots, "the read keeps no items in memory"
        monkeypatch.setattr(files, "load", load)
        whole = await recording.read(query, None, PieceScheduler(), lambda: 1000)
        await archive.close([])
        return sum(one.items for one in whole.answer().slices)

    assert asyncio.run(scenario()) == 200
    assert len(loads) == 1


@pytest.mark.parametrize("later", ["a crash", "a clean stop"])
def test_a_read_of_the_time_of_a_crash_says_lost_also_after_later_crashes_and_stops(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, later: str
) -> None:
    """The channel's host was lost before the instant 100, and then once more before the instant 200."""

    async def scenario() -> list[str | None]:
        archive = archive_in(tmp_path / "a", monkeypatch)
        monkeypatch.setattr(archive, "_decode", decode_timed)
        for number, lost_before in enumerate([None, 100, 200, 300]):
            recording, channel = await started(archive, tmp_path / "c", 2 + number, lost_before)
            if number == 3:
                found = [await reason_of(recording, *times) for times in ((60, 90), (120, 140), (160, 190), (10, 20))]
            for time in (100 * number + 1, 100 * number + 50):
                body = b"%d %d " % (channel.next_seq, time)
                channel.put(
                    Offer(times=[time], durations=None, lengths=[7]),
                    time,
                    lambda first_seq, kept, stamped, body=body: body,
                )
                recording.accepted(time)
            await archive.write_all()
            stop = CleanStop(300, epoch=4) if number == 2 and later == "a clean stop" else None
            recording.recorder.files.close(stop)
            recording.stop()
        await archive.close([])
        return found

    assert asyncio.run(scenario()) == ["LOST", None, "LOST", None]


async def reason_of(recording: Recording, start: int, end: int) -> str | None:
    """The reason in the answer to a get of these times; None also for NEVER."""
    query = Query(interval=Interval(Bound(None, start), Bound(None, end)), match=Match.START)
    read = await recording.read(query, None, PieceScheduler(), lambda: 1000)
    reason = read.answer().reason
    return None if reason in (None, "NEVER") else str(reason)


def decode_timed(body: bytes) -> Run:
    """The run of an item, whose body has its seq and its time."""
    seq, time = map(int, body.split())
    return make_run(seq, [time], None, [7], body)


async def started(
    archive: HostArchive, folder: Path, epoch: int, lost_before: int | None
) -> tuple[Recording, ChannelCore]:
    """The recording of a channel whose host has started. If `lost_before` is given, the former process of the host
    was lost before this instant.
    """
    files = SegmentFiles(folder, {})
    incarnation = lost_before or 7
    found = files.open(epoch, incarnation)
    if found.stop is not None:
        lost_before = None
    channel = ChannelCore(Policy(max_items=100), incarnation=incarnation, lost_before=lost_before)
    newest = None
    if found.segments:
        wanted = WantedItems(FIRST_KEY[0], LAST_KEY, 0, 2**20, down=True)
        newest = await archive.load(files, found.segments, WantedWindow(wanted, FIRST_KEY, LAST_KEY))
    archived = OpenedChannelArchive(files, found, newest, DiskUse().of_channel(b"", ""))
    return Recording(archive, archived, channel, lambda body, lo, hi: body, lambda: None), channel
