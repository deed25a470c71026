"""A host with an archive in an object store stops. The host keeps its lease until the store has everything."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from stampede_rt.v1 import channel_pb2
from stampede_rt.v1 import directory_service_pb2 as pb
from stampede_rt_channel_host import host as host_module
from stampede_rt_channel_host.archive.archive_folder import ArchiveFolder
from stampede_rt_channel_host.archive.clean_stop import CleanStop, stop_named
from stampede_rt_runtime.server import serving
from tests.support.channel_host.fake_directory import FakeDirectory
from tests.support.channel_host.in_process_host import HOST_ID, started_host
from tests.support.channel_host.object_stores import FakeStore
from tests.support.channel_host.rig import Rig, run_of

RECORDED = channel_pb2.ChannelSpec(archive_nanos=2**63 - 1)


class Directory(FakeDirectory):
    """Notes which objects the store has when the host gives its lease up."""

    def __init__(self, store: FakeStore, lease_ttl_nanos: int) -> None:
        super().__init__(lease_ttl_nanos=lease_ttl_nanos)
        self.store = store
        self.found: list[str] = []
        self.has_left = asyncio.Event()

    async def DeregisterHost(self, request: Any, context: Any) -> pb.DeregisterHostResponse:  # noqa: N802
        self.found = [*self.store.objects]
        self.has_left.set()
        return await super().DeregisterHost(request, context)


class SlowStore(FakeStore):
    """A store whose new objects wait until `is_fast` is set."""

    def __init__(self) -> None:
        super().__init__()
        self.is_fast, self.is_asked = asyncio.Event(), asyncio.Event()

    async def create(self, name: str, content: bytes | bytearray) -> bool:
        self.is_asked.set()
        await self.is_fast.wait()
        return await super().create(name, content)


@asynccontextmanager
async def recording_host(path: Path, store: FakeStore, lease_ttl_nanos: int = 600 * 10**9) -> AsyncIterator[Rig]:
    directory = Directory(store, lease_ttl_nanos)
    async with serving(directory.register) as supernode:
        directory.target = supernode.address
        started = await started_host(directory.target, archive=path, store=store)
        rig = Rig(directory, started)
        try:
            yield rig
        finally:
            await rig.connection.close(None)
            await started.stop()


def segment_files(path: Path) -> list[Path]:
    return [*path.rglob("*.segment")]


def stop_among(names: list[str]) -> CleanStop | None:
    return next((one for name in names if (one := stop_named(name.rpartition("/")[2]))), None)


async def test_a_host_that_stops_has_its_lease_until_the_store_has_all_items(tmp_path: Path) -> None:
    store = FakeStore()
    async with recording_host(tmp_path, store) as rig:
        channel = await rig.open(spec=RECORDED)
        await channel.put(run_of(b"x", b"y"))
        await rig.host.leave()
        found = rig.directory.found
        stop = stop_among(found)
        assert stop is not None, found
        assert (stop.end_seq, sum(name.endswith(".segment") for name in found)) == (3, 1)


async def test_a_host_whose_store_is_slow_gives_its_lease_up_and_goes_on_with_the_moves(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(host_module, "FINISH_SECONDS_MAX", 0.05)
    store = SlowStore()
    async with recording_host(tmp_path, store) as rig:
        channel = await rig.open(spec=RECORDED)
        await channel.put(run_of(b"x"))
        leaving = asyncio.create_task(rig.host.leave())
        async with asyncio.timeout(30):
            await rig.directory.has_left.wait()
            await store.is_asked.wait()
        assert not rig.directory.found
        store.is_fast.set()
        await leaving
        assert stop_among([*store.objects]) is not None


async def test_a_host_whose_store_is_slow_ends_in_the_time_of_a_stop_and_keeps_its_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("stampede_rt_runtime.server.DRAIN_SECONDS", 0.3)
    monkeypatch.setattr(host_module, "FINISH_SECONDS_MAX", 0.05)
    store = SlowStore()
    async with recording_host(tmp_path, store) as rig:
        channel = await rig.open(spec=RECORDED)
        await channel.put(run_of(b"x"))
    assert rig.directory.has_left.is_set()
    assert not store.objects
    assert len(segment_files(tmp_path)) == 1
    folder = ArchiveFolder(tmp_path)
    folder.open(HOST_ID)  # the host has released the folder
    folder.close()


async def test_a_host_that_waits_for_its_store_renews_its_lease(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(host_module, "FINISH_SECONDS_MAX", 60.0)
    store = SlowStore()
    async with recording_host(tmp_path, store, lease_ttl_nanos=3 * 10**9) as rig:
        channel = await rig.open(spec=RECORDED)
        await channel.put(run_of(b"x"))
        leaving = asyncio.create_task(rig.host.leave())
        await store.is_asked.wait()
        await rig.directory.called("RenewHostLease", times=rig.directory.calls["RenewHostLease"] + 1)
        assert not rig.directory.has_left.is_set()
        store.is_fast.set()
        await leaving
        assert stop_among(rig.directory.found) is not None
