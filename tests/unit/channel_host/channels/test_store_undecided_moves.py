"""A channel whose policy changes while a move holds it, so that it needs replicas, or needs them no more."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from stampede_rt.errors import Unavailable
from stampede_rt.v1 import channel_pb2
from stampede_rt.values.policy import parse_policy
from stampede_rt.wire.records import policy_to_spec
from stampede_rt_channel_host.channels.replication import ReplicationKind
from tests.support.channel_host.rig import Rig, running_host


async def held_channel(rig: Rig) -> tuple[Any, channel_pb2.ChannelRecord]:
    """A channel without replicas that a move holds, and its record in the directory, which now asks for replicas."""
    opened = await rig.open()
    hosted = rig.host.store.find(opened.channel_id, opened.epoch)
    hosted.begin_move().hold()
    record = rig.directory.channels[opened.channel_id]
    record.spec.CopyFrom(policy_to_spec(parse_policy(replicas=1)))
    record.spec_version += 1
    return hosted, record


async def test_a_held_channel_accepts_no_puts_because_its_policy_has_changed() -> None:
    """In an earlier version, the host served the channel in another object, which knew nothing of the move. The next
    owner did not get the items of its puts, although they were acknowledged.
    """
    async with running_host() as rig:
        hosted, record = await held_channel(rig)
        with pytest.raises(Unavailable, match="gets its new policy when the move has ended"):
            await rig.host.store.bind(record.channel_id, record.epoch, record.spec_version)
        assert rig.host.store.known(record.channel_id) is hosted
        assert hosted.moving.is_held


async def test_a_channel_gets_its_new_policy_when_its_move_has_failed() -> None:
    async with running_host() as rig:
        hosted, record = await held_channel(rig)
        record.epoch += 1
        present = await rig.host.store.bind(record.channel_id, record.epoch, record.spec_version)
        assert present is not hosted
        assert (present.moving, present.kind_of_replicas) == (None, ReplicationKind.LAGGING)


async def test_calls_that_wait_for_a_move_go_on_when_the_channel_gets_its_new_policy() -> None:
    """In an earlier version they waited for five seconds, and then failed."""
    async with running_host() as rig:
        hosted, record = await held_channel(rig)
        waiting = asyncio.create_task(hosted.moving.decided())
        await asyncio.sleep(0)
        record.epoch += 1
        await rig.host.store.bind(record.channel_id, record.epoch, record.spec_version)
        await waiting


async def test_a_channel_gets_its_new_policy_when_it_has_moved_here() -> None:
    async with running_host() as rig:
        hosted, record = await held_channel(rig)
        hosted.end_move()
        present = await rig.host.store.bind(record.channel_id, record.epoch, record.spec_version)
        assert present.kind_of_replicas is ReplicationKind.LAGGING
