"""The host keeps the feed of a copy for as long as it has the copy."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any

from stampede_rt_channel_host.channels.copy_state import CopyState
from stampede_rt_channel_host.copies.keeper import CopyKeeper
from stampede_rt_channel_host.copies.replica_directory import FeedSource

ME = b"m" * 16


async def test_the_task_of_a_replica_ends_when_the_replica_has_become_the_owner() -> None:
    """In an earlier version, the task asked the directory several times a second until the host stopped. When the
    channel moved away, and this host got a replica again, two tasks fed this replica.
    """
    state, lookups = CopyState(), list[bytes]()

    async def source_of(channel_id: bytes, host_id: bytes) -> FeedSource:
        lookups.append(channel_id)
        assert len(lookups) == 1, "the directory has answered already"
        return FeedSource(ME, "", 2)

    async def become_owner(channel_id: bytes, epoch: int) -> None:
        state.on_dropped()  # as the store does when it replaces the copy

    copies = SimpleNamespace(of=lambda channel_id: None)
    store: Any = SimpleNamespace(copies=copies, become_owner=become_owner, lease_held=lambda: True)
    directory: Any = SimpleNamespace(source_of=source_of)
    identity: Any = SimpleNamespace(host_id=ME, name="h1")
    nobody: Any = None
    keeper = CopyKeeper(identity, store, directory, nobody)
    record: Any = SimpleNamespace(channel_id=b"c" * 16, name="cam")
    task = keeper._start(record, state).task
    assert task is not None
    async with asyncio.timeout(30):
        await task
    assert lookups == [record.channel_id]
