"""Fixtures for the tests that start `stampede host` as a process."""

from __future__ import annotations

import os
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from stampede_rt_runtime.server import serving
from tests.support.channel_host.fake_directory import FakeDirectory


@pytest.fixture
async def directory() -> AsyncIterator[FakeDirectory]:
    """A fake directory that serves at the address `target`."""
    fake = FakeDirectory()
    async with serving(fake.register) as server:
        fake.target = server.address
        yield fake


@pytest.fixture
def no_settings_of_the_user(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The processes that a test starts find no settings: neither in the environment nor in the user's folder."""
    for name in [name for name in os.environ if name.startswith("STAMPEDE_")]:
        monkeypatch.delenv(name)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
