"""Cases of groups: cut events, and readers that wait for a group."""

from __future__ import annotations

import asyncio
import contextlib

from stampede_rt.errors import StampedeError, Unavailable
from stampede_rt_channel_host.core.group import CutFollower, GroupDefinition, TimesBoard
from stampede_rt_channel_host.core.records import RecordedGroup, ResolvedGroup
from stampede_rt_channel_host.groups.hosted_group import HostedGroup
from stampede_rt_channel_host.groups.waiting import Waiter
from tests.benchmarks.longest_pause.filling import fill, opened
from tests.benchmarks.longest_pause.watch import Work, until
from tests.support.channel_host.rig import Rig


async def late_items(rig: Rig, items: int) -> tuple[str, Work]:
    _, hosted = await opened(rig)
    now = rig.now()
    fill(hosted, now, [now])
    follower = CutFollower(hosted.channel, now + 1, now)
    for at in range(items):
        fill(hosted, now, [now - 1 - at])

    async def work() -> None:
        follower.begin(now + 2)
        while follower.under_way:
            follower.take(rig.now(), 2**20)
            await asyncio.sleep(0)

    return f"a cut event with {items:,} late items", work


async def group_readers(rig: Rig, count: int) -> tuple[str, Work]:
    """Subscriptions to cuts wait for a group, which moves, and is then deleted."""
    hosted = group_of(rig)
    events = 0

    async def wait(waiter: Waiter) -> None:
        nonlocal events
        for _ in range(2):
            with contextlib.suppress(StampedeError):
                await waiter.wait(None)
            events += 1

    waiters = [Waiter() for _ in range(count)]
    waiting = [asyncio.create_task(wait(one)) for one in waiters]
    for one in waiters:
        hosted.cut_observers.add(one)
    await asyncio.sleep(0)  # the readers begin to wait

    async def work() -> None:
        hosted.generation += 1
        hosted.changed()
        await until(lambda: events == count)
        hosted.end(Unavailable("gone"))
        await until(lambda: events == count + len(waiting))

    return f"a group with {count:,} readers moves, and ends", work


def group_of(rig: Rig) -> HostedGroup:
    group = RecordedGroup(group_id=b"g" * 16, name="g", definition=GroupDefinition(members=frozenset()), message=b"")
    resolved = ResolvedGroup(group=group, channels={}, targets={}, host_names={})
    begin = rig.host.store.scheduler.begin
    return HostedGroup(resolved, TimesBoard(), rig.now, on_moved=lambda _: None, on_idle=lambda _: None, begin=begin)
