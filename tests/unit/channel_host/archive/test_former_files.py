"""Readers wait for the last files of a former owner, but not for ever."""

from __future__ import annotations

import asyncio

import pytest

from stampede_rt_channel_host.archive import former_files
from stampede_rt_channel_host.archive.former_files import FormerFiles


async def test_readers_wait_until_the_files_have_come() -> None:
    files = FormerFiles()
    await files.wait()
    files.expect()
    waiting = asyncio.create_task(files.wait())
    await asyncio.sleep(0)
    assert (files.are_expected, waiting.done()) == (True, False)
    files.note_complete()
    await waiting
    assert not files.are_expected


async def test_readers_go_on_when_the_former_owner_is_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(former_files, "WAIT_SECONDS_MAX", 0.0)
    files = FormerFiles()
    files.expect()
    await files.wait()
    assert not files.are_expected
