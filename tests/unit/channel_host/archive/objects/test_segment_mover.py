"""The archive of a host with an object store: moves in the background, a store that fails, and the files of channels
that moved to another host.
"""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from stampede_rt.errors import Overloaded
from stampede_rt_channel_host.archive.disk_use import FOLDER_BYTES
from stampede_rt_channel_host.archive.objects import segment_mover
from stampede_rt_channel_host.archive.segment_files import ArchiveLimits
from tests.support.channel_host.object_stores import CHANNEL, PREFIX, FakeStore
from tests.support.channel_host.recorded_hosts import Host, host, record
from tests.support.waiting import until

SECONDS_MAX = 10


@pytest.fixture(autouse=True)
def quick_retries(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(segment_mover, "BACK_OFF_SECONDS_MIN", 0.01)
    monkeypatch.setattr(segment_mover, "BACK_OFF_SECONDS_MAX", 0.05)


def remove_files(folder: Path) -> None:
    for path in folder.rglob("*.segment"):
        path.unlink()


async def fill(one: Host) -> None:
    """Write until an item is refused because of the limit of the disk."""
    while True:  # each write takes some bytes of the limit
        await one.write()


@pytest.mark.asyncio
async def test_closed_files_move_to_the_store_and_free_their_bytes_on_the_disk(tmp_path: Path) -> None:
    store = FakeStore()
    async with host(tmp_path, store) as one:
        await one.serve(1)
        for _ in range(3):
            await one.write()
            assert not await one.mover.move_all()
        assert len(store.objects) == 3
        assert one.local() == []
        assert one.disk.used_bytes == FOLDER_BYTES
        counts = one.mover.counts()
        assert (counts.objects, counts.waiting_bytes, counts.failures) == (3, 0, 0)
        assert counts.bytes == sum(map(len, store.objects.values()))
        assert one.read()[:3] == [1, 2, 3]
        assert one.mover.counts().fetched_bytes > 0


@pytest.mark.asyncio
async def test_files_stay_on_the_disk_up_to_its_limit_while_the_store_is_unreachable(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    store = FakeStore()
    async with host(tmp_path, store, bytes_max=FOLDER_BYTES + 5000) as one:
        await one.serve(1)
        one.archive.start()
        store.failure = "connection refused"
        await one.write()
        await until(lambda: one.mover.failure)
        assert one.mover.counts().waiting_bytes > 0
        assert one.archive.store_failure == "connection refused"
        with pytest.raises(Overloaded, match="--archive-bytes-max"):
            await fill(one)
        assert one.read()[:4] == [1, 2, 3, 4], "reads of memory and of the archive still work"
        store.failure = ""
        await until(lambda: one.local() == [] and not one.mover.failure)
        await one.write()
        assert one.mover.counts().failures > 0
    events = [getattr(line, "event", "") for line in caplog.records]
    assert [events.count(f"archive_store_{what}") for what in ("failed", "recovered")] == [1, 1]


@pytest.mark.asyncio
async def test_a_file_that_somebody_has_removed_does_not_hold_up_the_later_ones(tmp_path: Path) -> None:
    store = FakeStore()
    async with host(tmp_path, store) as one:
        await one.serve(1)
        await one.write()
        remove_files(tmp_path)
        assert "somebody has removed its file" in await one.mover.move_all()
        assert not await one.mover.move_all()
        await one.write()
        assert not await one.mover.move_all()
        assert (len(store.objects), one.local()) == (1, [])


@pytest.mark.asyncio
async def test_a_host_that_stops_moves_its_closed_files(tmp_path: Path) -> None:
    store = FakeStore()
    async with host(tmp_path, store) as one:
        await one.serve(1)
        await one.write(3)
    assert one.local() == []
    assert [name.rpartition(".")[2] for name in sorted(store.objects)] == ["segment", "stopped"]


@pytest.mark.asyncio
async def test_a_host_stops_even_if_the_store_does_not_answer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    class HangingStore(FakeStore):
        async def create(self, name: str, content: bytes | bytearray) -> bool:
            await asyncio.Event().wait()
            return True

    monkeypatch.setattr("stampede_rt_channel_host.archive.host_archive.CLOSE_SECONDS_MAX", 0.2)
    async with asyncio.timeout(SECONDS_MAX), host(tmp_path, HangingStore()) as one:
        await one.serve(1)
        await one.write()
        one.archive.start()
    assert "stay on the disk" in caplog.text
    assert len(one.local()) == 1


@pytest.mark.asyncio
async def test_the_files_of_a_channel_that_moved_away_are_uploaded_immediately_or_after_a_restart(
    tmp_path: Path,
) -> None:
    store = FakeStore()
    store.failure = "unreachable"
    async with host(tmp_path, store) as one:
        store.failure = ""
        await one.serve(1)
        await one.write()
        one.archive.forget(one.recorder)
        del one.recorder
        store.failure = "unreachable"
        assert await one.mover.move_all() == "unreachable"
    store.failure = ""
    assert len(one.local()) == 1
    async with host(tmp_path, store) as restarted:
        restarted.archive.start()
        await until(lambda: restarted.local() == [])
        assert len(store.objects) == 1


@pytest.mark.asyncio
async def test_the_folder_of_a_channel_that_moved_away_is_deleted(tmp_path: Path) -> None:
    store = FakeStore()
    async with host(tmp_path, store) as one:
        await one.serve(1)
        await one.write()
        one.archive.forget(one.recorder)
        del one.recorder
        assert not await one.mover.move_all()
        assert not await one.mover.move_all()
        assert len(store.objects) == 1
        assert [*(tmp_path / "channels").iterdir()] == []
        await one.serve(3)
        await one.write()
        assert one.read() == [1, 2]


@pytest.mark.asyncio
async def test_a_channel_that_moved_here_gets_the_last_files_of_its_former_owner(tmp_path: Path) -> None:
    store = FakeStore()
    async with host(tmp_path / "a", store) as former, host(tmp_path / "b", store) as new:
        await former.serve(1)
        await former.write()
        recorder = await new.serve(2, next_seq=2)
        new.mover.expect_former(recorder)
        new.archive.start()
        former.archive.forget(former.recorder)
        del former.recorder
        assert not await former.mover.move_all()
        await until(lambda: recorder.segments)
        assert new.read()[:1] == [1]


@pytest.mark.asyncio
async def test_an_idle_channel_that_moved_here_finds_files_that_are_uploaded_later(tmp_path: Path) -> None:
    store = FakeStore()
    async with host(tmp_path / "a", store) as former, host(tmp_path / "b", store) as new:
        await former.serve(1)
        await former.write()
        assert not await former.mover.move_all()
        await former.write()
        recorder = await new.serve(2, next_seq=3)
        new.mover.expect_former(recorder)
        new.mover._listings.hurry()
        assert not await new.mover.move_all()
        assert new.read() == [1]
        assert not await former.mover.move_all()
        new.mover._listings.hurry()
        assert not await new.mover.move_all()
        assert new.read() == [1, 2]


@pytest.mark.asyncio
async def test_deleting_a_channel_removes_its_files_and_objects_and_nothing_else_even_after_a_restart(
    tmp_path: Path,
) -> None:
    store = FakeStore()
    foreign = {"channels/ff/x": b"1", PREFIX + "notes": b"2"}
    store.objects.update(foreign)
    async with host(tmp_path, store) as one:
        await one.serve(1)
        for _ in range(2):
            await one.write()
            await one.mover.move_all()
        await one.write()
        store.failure = "unreachable"
        one.archive.forget(one.recorder)
        del one.recorder
        one.archive.delete(CHANNEL)
        assert await one.mover.move_all() == "unreachable"
    store.failure = ""
    async with host(tmp_path, store) as restarted:
        assert not await restarted.mover.move_all()
    assert store.objects == foreign
    assert [*(tmp_path / "channels").iterdir()] == []


@pytest.mark.asyncio
async def test_the_limits_of_an_idle_channel_remove_its_objects(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(segment_mover, "LOOKS_PER_DROP", 1)
    store = FakeStore()
    async with host(tmp_path, store) as one:
        await one.serve(1)
        for _ in range(3):
            await one.write()
            await one.mover.move_all()
        one.recorder.limit(ArchiveLimits(10**9, None))
        assert not await one.mover.move_all()
        assert len(store.objects) == 1  # the limit keeps the last object
        assert len(one.recorder.segments) == 1


@pytest.mark.asyncio
async def test_an_upload_that_takes_too_long_counts_as_a_failure_of_the_store(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class HangingStore(FakeStore):
        async def create(self, name: str, content: bytes | bytearray) -> bool:
            await asyncio.Event().wait()
            return True

    monkeypatch.setattr(segment_mover, "UPLOAD_SECONDS_LEAST", 0.05)
    async with host(tmp_path, HangingStore()) as one:
        await one.serve(1)
        await one.write()
        assert "has not taken an object" in await one.mover.move_all()
        assert len(one.local()) == 1


@pytest.mark.asyncio
async def test_no_call_of_the_store_runs_on_the_event_loop(tmp_path: Path) -> None:
    class WatchingStore(FakeStore):
        def _call(self, what: str) -> None:
            super()._call(what)
            if not what.startswith("create"):
                with pytest.raises(RuntimeError):
                    asyncio.get_running_loop()

    store = WatchingStore()
    async with host(tmp_path, store) as one:
        await one.serve(1)
        await one.write()
        assert not await one.mover.move_all()
        one.archive.delete(CHANNEL)
        assert not await one.mover.move_all()
    assert {what.split()[0] for what in store.calls} == {"find", "create", "delete"}


@pytest.mark.asyncio
async def test_the_files_of_a_channel_that_stopped_cleanly_move_before_it_is_served_again(tmp_path: Path) -> None:
    store = FakeStore()
    async with host(tmp_path, store) as one:
        await one.serve(1)
        await one.write(3)
        store.failure = "unreachable"
    store.failure = ""
    assert len(one.local()) == 1
    async with host(tmp_path, store) as restarted:
        restarted.archive.start()
        await until(lambda: restarted.local() == [])
        assert len(store.objects) == 1
        files, found = await restarted.archive.open(record(1))
        assert found.stop is not None
        assert found.stop.incarnation == 1
        assert sum(one.items for one in found.segments) == 3
        restarted.archive.give_up(files)


@pytest.mark.asyncio
async def test_the_thread_of_writes_does_not_wait_for_the_store_when_a_former_owner_has_moved_its_last_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = FakeStore()
    async with host(tmp_path / "a", store) as former, host(tmp_path / "b", store) as new:
        await former.serve(1)
        await former.write(2)
        recorder = await new.serve(2, next_seq=2)
        await new.write()  # item 2 of the former owner is lost, and the new owner uses its seq
        assert not await former.mover.move_all()
        find_again, reads = recorder.files.find_again, []  # type: ignore[attr-defined]

        def watched(*arguments: object) -> object:
            before = len(store.calls)
            found = find_again(*arguments)
            reads.append(store.calls[before:])
            return found

        monkeypatch.setattr(recorder.files, "find_again", watched)
        new.mover.expect_former(recorder)
        new.mover._listings.hurry()
        await new.mover._find_again(recorder.files)  # type: ignore[arg-type]
        assert reads == [[]]
        assert new.read() == [1, 2]
