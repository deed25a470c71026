"""Reads of a recorded channel whose callers go away."""

from __future__ import annotations

import asyncio
import threading
from pathlib import Path
from typing import Any

import pytest

from stampede_rt.values.model import Policy
from stampede_rt.values.timeline import NOW, OLDEST, Interval
from stampede_rt_channel_host.archive.clean_stop import CleanStop
from stampede_rt_channel_host.archive.disk_use import DiskUse
from stampede_rt_channel_host.channels.piece_scheduler import PieceScheduler
from stampede_rt_channel_host.channels.recording import OpenedChannelArchive, Recording
from stampede_rt_channel_host.core.archive import Wanted, WantedWindow, archived_read
from stampede_rt_channel_host.core.channel import FIRST_KEY, ChannelCore, Query
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
    begun, go_on, loads = threading.Event(), threading.Event(), []

    async def scenario() -> int:
        archive = archive_in(tmp_path / "a", monkeypatch)
        files, _ = opened(tmp_path / "c")
        found = files.open(2, 7)
        channel = ChannelCore(Policy(max_items=2), incarnation=7)
        disk = DiskUse().of_channel(b"", "")
        wanted = Wanted(FIRST_KEY[0], LAST_KEY, 0, 1, down=True)
        newest = await archive.load(files, found.segments, WantedWindow(wanted, FIRST_KEY, LAST_KEY))
        archived = OpenedChannelArchive(files, found, newest, disk)
        recording = Recording(archive, archived, channel, lambda body, lo, hi: body, lambda: None)
        load = files.load

        def slow(*arguments: Any) -> Any:
            loads.append(1)
            begun.set()
            assert go_on.wait(60)
            return load(*arguments)

        monkeypatch.setattr(files, "load_at_hand", lambda *_: None)
        monkeypatch.setattr(files, "load", slow)
        query = Query(interval=Interval(OLDEST, NOW))
        reading = asyncio.create_task(recording.read(query, None, PieceScheduler(), lambda: 1000))
        assert await asyncio.to_thread(begun.wait, 60)
        reading.cancel()
        with pytest.raises(asyncio.CancelledError):
            await reading
        go_on.set()
        held, _ = channel.look(1000)
        assert not held._snapshots, "the read keeps no items in memory"
        monkeypatch.setattr(files, "load", load)
        whole = await recording.read(query, None, PieceScheduler(), lambda: 1000)
        await archive.close([])
        return sum(one.items for one in whole.answer().slices)

    assert asyncio.run(scenario()) == 200
    assert len(loads) == 1
