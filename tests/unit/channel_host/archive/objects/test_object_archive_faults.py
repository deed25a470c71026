"""An archive with an object store under faults: a clock that steps, a wrong store, and a disk that takes no writes."""

from __future__ import annotations

import errno
from pathlib import Path

import pytest

from stampede_rt.errors import Unavailable
from stampede_rt_channel_host.archive.objects import guarded_store, known_objects, segment_mover
from stampede_rt_channel_host.channels.opened_archives import open_archive
from tests.support.channel_host.object_stores import FakeStore
from tests.support.channel_host.recorded_hosts import Host, host, record
from tests.support.waiting import until

DAY = 86_400 * 10**9


def refuse(*_: object, **__: object) -> None:
    raise OSError(errno.EROFS, "Read-only file system")


async def moved(one: Host, count: int) -> None:
    """Write some segments, and move each."""
    for _ in range(count):
        await one.write()
        assert not await one.mover.move_all()


@pytest.mark.parametrize("step", [-DAY, DAY])
@pytest.mark.asyncio
async def test_a_step_of_the_clock_loses_no_item_and_leaves_no_file_open(tmp_path: Path, step: int) -> None:
    store = FakeStore()
    async with host(tmp_path, store) as one:
        one.clock = 2 * DAY
        await one.serve(1)
        await moved(one, 2)
        await one.write()  # this file is open when the clock steps
        one.clock += step
        assert not await one.mover.move_all()
        assert one.local() == []
        await moved(one, 2)
        assert one.read() == [1, 2, 3, 4, 5]
    async with host(tmp_path, store) as restarted:
        restarted.clock = DAY // 2  # the clock of the next process shows yet another time
        await restarted.serve(2)
        assert restarted.read() == [1, 2, 3, 4, 5]
        await moved(restarted, 1)
        assert restarted.read() == [1, 2, 3, 4, 5, 6]


@pytest.mark.asyncio
async def test_after_a_change_of_the_store_files_move_to_the_new_store_and_the_old_list_is_ignored(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(guarded_store, "PAUSE_SECONDS", 0.0)
    former, new = FakeStore(), FakeStore()
    new.url = "memory:///new"
    async with host(tmp_path, former) as one:
        await one.serve(1)
        await moved(one, 2)
        former.failure = "away for ever"
        await one.write(2)
    new.failure = "away, too"
    async with host(tmp_path, new) as restarted:
        with pytest.raises(Unavailable, match="away, too"):
            await open_archive(restarted.archive, record(2))
        new.failure = ""
        await restarted.serve(2)
        assert restarted.read() == [3, 4]
        restarted.archive.start()
        await until(lambda: restarted.local() == [])
        await restarted.write()
        assert restarted.read() == [3, 4, 5]
    assert [name.rpartition(".")[2] for name in sorted(new.objects)] == ["segment", "segment", "stopped"]


@pytest.mark.asyncio
async def test_on_a_full_disk_files_still_move_and_reads_work_without_the_cache(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = FakeStore()
    async with host(tmp_path, store) as one:
        await one.serve(1)
        await one.write(3)
        monkeypatch.setattr(known_objects, "write_all", refuse)
        monkeypatch.setattr(Path, "write_bytes", refuse)
        assert not await one.mover.move_all()
        assert one.local() == []
        assert one.read() == [1, 2, 3]
        assert one.mover.counts().cache_bytes == 0


@pytest.mark.asyncio
async def test_a_moved_file_in_a_read_only_folder_is_kept_and_its_items_are_read_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = FakeStore()
    async with host(tmp_path, store) as one:
        await one.serve(1)
        await one.write(3)
        with monkeypatch.context() as broken:
            broken.setattr(known_objects, "write_all", refuse)
            broken.setattr(Path, "unlink", refuse)
            assert await one.mover.move_all() == "Read-only file system"
            assert one.archive.store_failure == ""
        assert len(store.objects) == len(one.local()) == 1
        assert one.read() == [1, 2, 3]
        monkeypatch.setattr(segment_mover, "BACK_OFF_SECONDS_MIN", 0.01)
        one.archive.start()
        await until(lambda: one.local() == [])
        assert one.read() == [1, 2, 3]
