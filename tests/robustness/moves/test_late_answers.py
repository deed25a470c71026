"""Answers of the directory that come late: a record from before a move arrives during the move, or after it."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import suppress
from typing import Any

import pytest

from stampede_rt.errors import StaleBinding, StampedeError
from stampede_rt.values.model import Policy
from stampede_rt_channel_host.channels.channel_changes import ChannelChanges
from stampede_rt_channel_host.copies.moves.gathered_moves import MoveCommit
from stampede_rt_channel_host.core.records import PolicyChange, RecordedChannel
from tests.robustness.moves.test_crashes_at_each_step import ITEMS, Scenario
from tests.robustness.moves.two_hosts import Host
from tests.support.supernode.operations import update


@pytest.fixture
async def scenario() -> AsyncIterator[Scenario]:
    made = Scenario()
    yield made
    await made.world.aclose()


class LateLookups:
    """The lookups of records by a host. The directory answers them, but each answer comes only after `release`."""

    def __init__(self, host: Host) -> None:
        self._release = asyncio.Event()
        self._looked_up = asyncio.Event()
        self._directory = host.store._directory
        self._resolve = self._directory.resolve
        self._directory.resolve = self._answered_late  # type: ignore[method-assign]

    async def _answered_late(self, channel_id: bytes) -> RecordedChannel:
        record = await self._resolve(channel_id)
        self._looked_up.set()
        await self._release.wait()
        return record

    async def looked_up(self) -> None:
        """Wait until the directory has answered a lookup."""
        await self._looked_up.wait()

    def release(self) -> None:
        """Let the answers come, and delay no others."""
        self._directory.resolve = self._resolve  # type: ignore[method-assign]
        self._release.set()


async def bind_at(host: Host, scenario: Scenario) -> None:
    """Bind the channel under the epoch before the move, as a client that knows a former owner does."""
    with suppress(StampedeError):
        await host.store.bind(scenario.channel_id, 1)


async def test_a_record_from_before_a_move_does_not_make_the_new_owner_drop_the_channel(scenario: Scenario) -> None:
    lookups = LateLookups(scenario.destination)
    binding = asyncio.create_task(bind_at(scenario.destination, scenario))
    await lookups.looked_up()
    assert await scenario.move() is None
    lookups.release()
    await binding
    items = await scenario.settle()
    assert len(items) >= ITEMS
    scenario.check(items)


async def test_a_lookup_before_the_commit_leaves_the_copy_that_becomes_the_owner(scenario: Scenario) -> None:
    """The directory answers again after an outage of six seconds: first a lookup, and then the commit. In an earlier
    version, the lookup made the next owner drop its copy, and it then served the channel without items.
    """
    destination, channel_id = scenario.destination, scenario.channel_id
    commit = destination.directory.commit_one

    async def committed_late(move: MoveCommit) -> RecordedChannel:
        held = destination.store.known(channel_id)
        assert held is not None
        assert held.copy is not None
        assert held.copy.as_of_nanos is not None
        held.copy.as_of_nanos -= 6 * 10**9
        with pytest.raises(StampedeError, match="is at host"):
            await destination.store.bind(channel_id, 1)
        return await commit(move)

    destination.directory.commit_one = committed_late
    assert await scenario.move() is None
    items = await scenario.settle()
    assert len(items) >= ITEMS
    scenario.check(items)


class LateUpdates:
    """The changes of policies at the directory. Each answer comes only after `release`."""

    def __init__(self, scenario: Scenario) -> None:
        self._world = scenario.world
        self.done, self.release = asyncio.Event(), asyncio.Event()

    async def update(self, channel_id: bytes, epoch: int, change: PolicyChange, **_: Any) -> RecordedChannel:
        self._world.apply(update(channel_id, epoch, max_items=change.stated.max_items or 0))
        record = self._world.record_of(channel_id)
        self.done.set()
        await self.release.wait()
        return record


async def test_a_former_owner_does_not_serve_the_channel_when_a_change_of_its_policy_is_answered_after_the_move(
    scenario: Scenario,
) -> None:
    """In an earlier version, it served the channel without items, and acknowledged puts under the former epoch."""
    source, channel_id = scenario.source, scenario.channel_id
    await source.store.bind(channel_id, 1)
    updates: Any = LateUpdates(scenario)
    change = PolicyChange(stated=Policy(max_items=50_000), message=b"")
    changing = asyncio.create_task(ChannelChanges(source.store, updates).configure(channel_id, 1, change, b"", 0.0))
    await updates.done.wait()
    assert await scenario.move() is None
    await scenario.until(lambda: source.store.known(channel_id) is None)
    updates.release.set()
    with pytest.raises(StaleBinding, match="is at host"):
        await changing
    assert source.store.known(channel_id) is None
    scenario.check(await scenario.settle())
