"""A host that starts while its object store is unreachable serves its own items. It lists the store later."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from stampede_rt._async.session import CALL_TIMEOUT_S
from stampede_rt.errors import Unavailable
from stampede_rt_channel_host.archive.objects import guarded_store, listing_schedule, object_archive, segment_mover
from stampede_rt_channel_host.archive.objects.segment_store import FoundObject, StoreError
from stampede_rt_channel_host.channels.opened_archives import open_archive
from stampede_rt_channel_host.core.channel import FIRST_KEY
from stampede_rt_channel_host.core.channel.item_keys import LAST_KEY
from tests.support.channel_host.object_stores import CHANNEL, PREFIX, FakeStore
from tests.support.channel_host.recorded_hosts import Host, host, record
from tests.support.waiting import until


@pytest.fixture(autouse=True)
def quick_retries(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(segment_mover, "BACK_OFF_SECONDS_MIN", 0.01)
    monkeypatch.setattr(segment_mover, "BACK_OFF_SECONDS_MAX", 0.05)
    monkeypatch.setattr(guarded_store, "PAUSE_SECONDS", 0.0)
    monkeypatch.setattr(listing_schedule, "WAIT_SECONDS_MIN", 0.01)


async def serve_until_killed(path: Path, store: FakeStore, *, moved: int = 3, local: int = 2) -> None:
    """Serve the channel, move some of its segments, and kill the host with other segments on its disk."""
    one = Host(path, store)
    await one.serve(1)
    for _ in range(moved):
        await one.write()
        assert not await one.mover.move_all()
    for _ in range(local):
        await one.write()
        one.recorder.files.close(None)
    one.archive.folder.close()


@pytest.mark.parametrize("epoch", [1, 2])
@pytest.mark.asyncio
async def test_a_host_continues_its_seqs_and_reads_its_own_files_while_the_store_is_unreachable(
    tmp_path: Path, epoch: int
) -> None:
    store = FakeStore()
    await serve_until_killed(tmp_path, store)
    before = dict(store.objects)
    store.failure = "connection refused"
    async with host(tmp_path, store) as one:
        recorder = await one.serve(epoch)
        assert one.channel.next_seq == 6
        assert (recorder.span.oldest, recorder.span.newest) == (1, 5)
        await one.write()
        with pytest.raises(StoreError, match="connection refused"):
            one.read()
        assert one.archive.store_failure == "connection refused"
        one.archive.start()
        await until(lambda: one.mover.failure)
        store.failure = ""
        await until(lambda: not one.mover.failure and recorder.files.is_listed)
        assert one.read() == [1, 2, 3, 4, 5, 6]
        await until(lambda: one.local() == [])
        assert one.read() == [1, 2, 3, 4, 5, 6]
    assert {name: store.objects[name] for name in before} == before


@pytest.mark.asyncio
async def test_memory_gets_only_the_items_on_disk_that_are_later_than_all_items_in_the_store(tmp_path: Path) -> None:
    store = FakeStore()
    await serve_until_killed(tmp_path, store)
    store.failure = "unreachable"
    async with host(tmp_path, store) as one:
        opened = await open_archive(one.archive, record(2))
        assert opened.newest is not None
        assert [part.first_seq for part in opened.newest.items.slices(FIRST_KEY, LAST_KEY)] == [4, 5]
        assert opened.newest.edge == 3
        one.archive.give_up(opened.files)


@pytest.mark.asyncio
async def test_a_new_channel_can_be_recorded_while_the_store_is_unreachable(tmp_path: Path) -> None:
    store = FakeStore()
    store.failure = "unreachable"
    async with host(tmp_path, store) as one:
        await one.serve(1)
        await one.write(2)
        assert one.read() == [1, 2]
        one.archive.start()
        store.failure = ""
        await until(lambda: len(store.objects) == 1)
    assert one.local() == []


@pytest.mark.parametrize(("epoch", "damage"), [(3, False), (2, True)])
@pytest.mark.asyncio
async def test_a_host_without_a_list_of_all_objects_refuses_the_channel(
    tmp_path: Path, epoch: int, damage: bool
) -> None:
    store = FakeStore()
    await serve_until_killed(tmp_path, store)
    if damage:
        (tmp_path / "channels" / CHANNEL.hex() / "objects").write_text("nonsense\n\n")
    store.failure = "connection refused"
    async with host(tmp_path, store) as one:
        with pytest.raises(Unavailable, match="connection refused"):
            await open_archive(one.archive, record(epoch))
        store.failure = ""
        await one.serve(epoch)
        assert one.read() == [1, 2, 3, 4, 5]


@pytest.mark.asyncio
async def test_a_listing_that_hangs_delays_a_start_only_briefly(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    answers = threading.Event()

    class HangingStore(FakeStore):
        def _call(self, what: str) -> None:
            super()._call(what)
            if what.startswith("find"):
                answers.wait(10)

    store = HangingStore()
    answers.set()
    await serve_until_killed(tmp_path, store)
    answers.clear()
    monkeypatch.setattr(object_archive, "LISTING_SECONDS_MAX", 0.01)
    async with host(tmp_path, store) as one:
        recorder = await one.serve(2)
        assert not recorder.files.is_listed
        assert one.channel.next_seq == 6
        one.archive.start()
        await one.write()
        answers.set()
        await until(lambda: recorder.files.is_listed and one.local() == [])
        assert one.read() == [1, 2, 3, 4, 5, 6]


@pytest.mark.asyncio
async def test_a_host_refuses_a_channel_with_objects_of_a_later_owner_even_if_its_disk_lists_others(
    tmp_path: Path,
) -> None:
    store = FakeStore()
    await serve_until_killed(tmp_path, store)
    store.objects[PREFIX + "000000009000000001_5_0_90_90_x_x_0.segment"] = b"later"
    async with host(tmp_path, store) as one:
        with pytest.raises(Unavailable, match="later owner"):
            await open_archive(one.archive, record(2))


@pytest.mark.asyncio
async def test_a_file_that_moves_during_the_listing_of_its_channel_is_not_lost(tmp_path: Path) -> None:
    listed, moved = threading.Event(), threading.Event()

    class SlowStore(FakeStore):
        def find(self, prefix: str) -> Iterator[FoundObject]:
            found = [*super().find(prefix)]
            listed.set()
            moved.wait(10)
            yield from found

    store = SlowStore()
    moved.set()
    await serve_until_killed(tmp_path, store, moved=1, local=2)
    listed.clear()
    moved.clear()
    async with host(tmp_path, store) as one:
        serving = asyncio.create_task(one.serve(2))
        await asyncio.to_thread(listed.wait, 10)
        assert not await one.mover.move_all()
        moved.set()
        await serving
        assert one.channel.next_seq == 4
        assert one.read() == [1, 2, 3]


@pytest.mark.asyncio
async def test_the_files_of_a_channel_that_cannot_be_opened_still_move_to_the_store(tmp_path: Path) -> None:
    store = FakeStore()
    await serve_until_killed(tmp_path, store, moved=1, local=2)
    async with host(tmp_path, store) as one:
        store.failure = "unreachable"
        with pytest.raises(Unavailable):
            await open_archive(one.archive, record(3))
        store.failure = ""
        assert not await one.mover.move_all()
        assert not await one.mover.move_all()
        assert one.local() == []


@pytest.mark.asyncio
async def test_the_list_on_the_disk_follows_the_epoch_of_the_channel(tmp_path: Path) -> None:
    store = FakeStore()
    one = Host(tmp_path, store)
    recorder = await one.serve(1)
    await one.write()
    assert not await one.mover.move_all()
    recorder.files.raise_epoch(2)  # the host opened the channel before the directory committed the move to this host
    assert not await one.mover.move_all()
    one.archive.folder.close()  # the host is killed
    store.failure = "unreachable"
    async with host(tmp_path, store) as restarted:
        await restarted.serve(3)
        assert restarted.channel.next_seq == 2


def test_a_host_without_a_list_decides_while_the_call_of_a_client_still_waits() -> None:
    """In an earlier version, each call ended before the wait, and the next call began the wait again."""
    assert object_archive.LISTING_SECONDS_MAX + object_archive.UNKNOWN_SECONDS_MAX <= CALL_TIMEOUT_S - 2
