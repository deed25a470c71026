"""The archive of a host with an object store: one channel or one call fails for long, and the rest goes on."""

from __future__ import annotations

import errno
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from stampede_rt_channel_host.archive.objects import segment_mover, stored_segments
from stampede_rt_channel_host.archive.objects.moving_files import MovingFiles
from stampede_rt_channel_host.archive.objects.segment_store import StoreError
from stampede_rt_channel_host.archive.segment_files import ArchiveLimits
from tests.support.channel_host.object_stores import FakeStore, moving_files
from tests.support.channel_host.recorded_hosts import host, no_pauses_after_failures  # noqa: F401

pytestmark = [pytest.mark.usefixtures("no_pauses_after_failures"), pytest.mark.asyncio]


class KeepingStore(FakeStore):
    """Refuses to delete objects while `keeps` is set."""

    keeps = True

    def delete(self, names: Sequence[str]) -> None:
        if self.keeps:
            raise StoreError("AccessDenied: this user may not delete objects", is_refusal=True)
        super().delete(names)


async def test_the_names_of_objects_that_a_store_does_not_delete_have_a_bound_and_are_found_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In an earlier version the list of these names grew without a bound."""
    monkeypatch.setattr(stored_segments, "OUTDATED_MAX", 2)
    monkeypatch.setattr(segment_mover, "LOOKS_PER_DROP", 1)
    store = KeepingStore()
    async with host(tmp_path, store) as one:
        recorder = await one.serve(1)
        recorder.limit(ArchiveLimits(10**9, None))
        for _ in range(7):
            await one.write()
            await one.mover.move_all()
        files = recorder.files
        assert isinstance(files, MovingFiles)
        assert len(files.stored.outdated) == 2
        assert len(store.objects) == 7
        store.keeps = False
        for _ in range(8):
            assert not await one.mover.move_all()
        assert not files.stored.has_outdated
        assert len(store.objects) == 1
        assert one.read() == [7]


async def test_a_channel_whose_folder_fails_does_not_hold_up_the_moves_of_the_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In an earlier version the first failure ended each look, and no file of any channel moved."""
    store = FakeStore()
    async with host(tmp_path, store) as one:
        recorder = await one.serve(1)
        bad = moving_files(tmp_path / "bad", store)

        def fail(*_: Any) -> None:
            raise OSError(errno.EACCES, "the folder cannot be written")

        monkeypatch.setattr(bad, "look", fail)
        monkeypatch.setattr(one.mover, "_recorders", {bad: recorder, **one.mover._recorders})
        await one.write()
        assert await one.mover.move_all() == "the folder cannot be written"
        assert len(store.objects) == 1
