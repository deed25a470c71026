"""A host whose event loop is held up for longer than its lease keeps the lease: another thread renews it."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import pytest

import stampede_rt as st
from stampede_rt_channel_host.cluster import lease_thread
from stampede_rt_channel_host.cluster.identity import HostIdentity
from stampede_rt_channel_host.core.channel import Pieces
from stampede_rt_channel_host.host import ChannelHost
from stampede_rt_local.cluster import LocalCluster
from stampede_rt_runtime.clock import SystemClock
from stampede_rt_runtime.dial import Dialer
from stampede_rt_runtime.server import ServiceServer

LEASE_SECONDS = 5.0  # a busy machine halts a process for longer than a part of 2 s
HELD_UP_SECONDS = 1.3 * LEASE_SECONDS


class HostWithLease:
    """A host on this test's own event loop, and the events of its lease."""

    def __init__(self, cluster: LocalCluster) -> None:
        dialer = Dialer(secret=cluster.secret)
        self.states: list[bool] = []
        self.changed = asyncio.Event()
        self.server = ServiceServer(secret=cluster.secret)
        self.host = ChannelHost(
            HostIdentity(host_id=b"the-host-id-here", name="here", boot_incarnation=7),
            frontends=[cluster.address],
            dial=dialer,
            dial_for_lease=dialer.dial_from_any_loop,
            clock=SystemClock(),
            memory_bytes_max=2**30,
            on_serving=self._note_state,
            on_defect=_fail,
        )

    def _note_state(self, serving: bool) -> None:
        self.states.append(serving)
        self.changed.set()


def _fail(failure: BaseException) -> None:
    raise AssertionError("a task of the host died") from failure


@asynccontextmanager
async def served() -> AsyncIterator[tuple[LocalCluster, HostWithLease]]:
    """A cluster of processes without a host, and a host in this process whose lease lasts 2 s."""
    cluster = LocalCluster(hosts=0, supernodes=1)
    cluster.supernodes[0].arguments.extend(("--lease-ttl", f"{LEASE_SECONDS:g}s"))
    await asyncio.to_thread(cluster.__enter__)
    try:
        one = HostWithLease(cluster)
        address = one.server.bind("localhost:0")
        one.host.add_to(one.server.grpc)
        await one.server.start()
        await one.host.enter(address)
        try:
            yield cluster, one
        finally:
            await one.server.stop(one.host.leave)
    finally:
        await asyncio.to_thread(cluster.__exit__, None, None, None)


def hold_up(seconds: float) -> None:
    """Stop the event loop, as a long computation does."""
    until_s = time.monotonic() + seconds
    while time.monotonic() < until_s:
        sum(range(10_000))


async def test_an_event_loop_that_is_blocked_for_longer_than_the_lease_keeps_the_lease() -> None:
    async with served() as (cluster, one), await st.aio.connect(cluster.address, secret=cluster.secret.text) as rt:
        channel = await rt.channel("cam", max_age="60s")
        put = await channel.put(b"before")
        hold_up(HELD_UP_SECONDS)
        assert one.host.store.lease_held()
        await channel.put(b"after")
        items = await channel.get(st.OLDEST, st.NEWEST)
        assert [(item.payload, item.incarnation) for item in items] == [
            (b"before", put.incarnation),
            (b"after", put.incarnation),
        ]
        assert one.states == [True]


async def test_an_event_loop_that_is_blocked_for_very_long_loses_the_lease_and_gets_it_again_afterwards(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(lease_thread, "LOOP_SILENCE_SECONDS_MAX", 1.0)
    async with served() as (_, one):
        time.sleep(HELD_UP_SECONDS)  # noqa: ASYNC251  # blocks the event loop, and costs no CPU time
        assert not one.host.store.lease_held()
        async with asyncio.timeout(30):
            while one.states != [True, False, True]:
                one.changed.clear()
                await one.changed.wait()
        assert one.host.store.lease_held()


async def test_changes_by_a_registration_are_made_on_the_serving_loop_before_the_lease_counts() -> None:
    async with served() as (_, one):
        seen: list[tuple[Any, bool]] = []
        registering = one.host.store.registering

        def spy(*args: Any, **kwargs: Any) -> Pieces[None]:
            seen.append((asyncio.get_running_loop(), one.host.store.lease_held()))
            yield from registering(*args, **kwargs)

        one.host.store.registering = spy  # type: ignore[method-assign]
        registration = one.host._lease._registration
        assert registration is not None
        keeping = next(task for task in one.host._tasks if task.get_name() == "lease")
        keeping.cancel()  # a renewal under way would hold the lease again

        async def register_anew() -> None:
            registration._lease.give_up()
            await registration._register()

        await lease_thread._on(one.host._lease._started()[1], register_anew())
        assert seen == [(asyncio.get_running_loop(), False)]
        assert one.host.store.lease_held()
