"""Faults of the hosts of replicated channels.

With `ack="replica"` no acknowledged or seen item may be lost, and no incarnation may change. With `ack="host"` a
replica may become the owner without the latest items, and then each subscription reports the loss.

Before each fault all channels of the traffic have their replica in sync. So one fault never costs two copies.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from typing import Any

import stampede_rt as st
from stampede_rt import aio
from tests.robustness.faults.host_faults import RETRY_SECONDS, started
from tests.robustness.faults.kills_and_cuts import KILLED, STOPPED, cut
from tests.robustness.faults.scene import PATIENCE_SECONDS, Fault, Scene
from tests.robustness.real_cluster.cluster import Host
from tests.robustness.real_cluster.placed_process import FaultHadNoEffect
from tests.robustness.real_cluster.supernode import LEASE_TTL_SECONDS
from tests.robustness.real_cluster.traffic import Traffic

PUT_PAUSE_SECONDS, TAKEOVERS_MAX = 0.02, 3
FROZEN_SECONDS = LEASE_TTL_SECONDS + 3.0
DISTURBED_SECONDS = 3.0  # longer than a silent replica keeps its in-sync flag


class ReplicatedChannel:
    """A channel of this test with an item, its owner and the host of its replica."""

    def __init__(self, scene: Scene, channel: aio.Channel, incarnation: int) -> None:
        assert scene.traffic is not None, "this fault is for clusters with channel hosts"
        self.scene, self.traffic, self.channel, self.incarnation = scene, scene.traffic, channel, incarnation
        self.names: dict[bytes, str] = {}
        self._reader = channel.subscribe(st.OLDEST)
        self._got: set[tuple[int, int]] = set()  # incarnation and seq
        self._wakeup = asyncio.Event()
        self._tasks = [asyncio.create_task(self._read()), asyncio.create_task(self._put())]

    async def find(self) -> tuple[Host, Host]:
        """Wait until a replica is in sync. Returns the owner, and the host of the replica."""
        self.names = {one.host_id: one.name for one in await self.traffic.rt.hosts()}
        async with patience(f"no replica of {self.channel.name} is in sync"):
            replicas = await _synced(self.channel)
        owner = next(one.host for one in await self.traffic.rt.channels(self.channel.name))
        return self._host(owner), self._host(self.names[replicas[0]])

    async def _check_reported(self, item: st.Item) -> None:
        """Check that the reader got the item, and that it learned of a loss if and only if the incarnation changed.

        If puts wait for replicas, the incarnation must not change.
        """
        takeovers = (item.incarnation - self.incarnation) % 2**64
        if takeovers > (0 if self.traffic.waits_for_replicas else TAKEOVERS_MAX):
            raise AssertionError(f"{self.channel.name} has another incarnation, although a replica was in sync")
        async with patience(f"the reader of {self.channel.name} did not get seq {item.seq}"):
            while (item.incarnation, item.seq) not in self._got:
                await self._wakeup.wait()
                self._wakeup.clear()
        if bool(self._reader.losses) != bool(takeovers):
            raise AssertionError(f"the reader of {self.channel.name} learned of {self._reader.losses} losses")

    async def _read(self) -> None:
        async for item in self._reader:
            self._got.add((item.incarnation, item.seq))
            self._wakeup.set()

    async def _put(self) -> None:
        """Put during the fault, so that there is something to lose."""
        while True:
            with suppress(st.StampedeError):
                await self.traffic.put(self.channel)
            await asyncio.sleep(PUT_PAUSE_SECONDS)

    async def close(self) -> None:
        """End the reader and the producer."""
        self._reader.close()
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    def _host(self, name: str) -> Host:
        return next(one for one in self.scene.cluster.hosts if one.name == name)

    async def wait_for_put(self, since: float) -> float:
        """Put until a put is acknowledged. Returns the time since `since`. Raises AssertionError, TimeoutError."""
        async with patience(f"no put into {self.channel.name} was acknowledged"):
            while True:
                with suppress(st.StampedeError):  # no host can take a put at the moment
                    item = await self.traffic.put(self.channel)
                    break
                await asyncio.sleep(RETRY_SECONDS)
        await self._check_reported(item)
        async with patience(f"{self.channel.name} was not read"):
            await self.traffic.read_all(self.channel)
        return time.monotonic() - since


@asynccontextmanager
async def patience(what: str) -> AsyncIterator[None]:
    """Limit the block to PATIENCE_SECONDS. Raises TimeoutError, which says `what`."""
    try:
        async with asyncio.timeout(PATIENCE_SECONDS):
            yield
    except TimeoutError as error:
        raise TimeoutError(f"{what} within {PATIENCE_SECONDS:g} s") from error


async def _in_sync(channel: aio.Channel) -> list[bytes]:
    try:
        return [one.host_id for one in (await channel.stats()).copies if one.replica and one.in_sync]
    except st.StampedeError:
        return []


async def _seen(channel: aio.Channel) -> str:
    """The facts that the owner reports about the copies of a channel."""
    try:
        stats = await channel.stats()
    except st.StampedeError as error:
        return str(error)
    return f"accepted {stats.accepted}, replicated up to {stats.replicated}, copies {stats.copies}"


async def _synced(channel: aio.Channel) -> list[bytes]:
    """Wait until the channel has a replica in sync. Returns the hosts of its replicas in sync. The caller limits the
    wait.
    """
    while True:
        if found := await _in_sync(channel):
            return found
        await asyncio.sleep(RETRY_SECONDS)


async def settled(traffic: Traffic) -> None:
    """Wait until each channel that is in use has its replica in sync."""
    for channel in traffic.in_use():
        try:
            async with asyncio.timeout(PATIENCE_SECONDS):
                await _synced(channel)
        except TimeoutError as error:
            raise TimeoutError(f"no replica of {channel.name} is in sync: {await _seen(channel)}") from error


@asynccontextmanager
async def _prepare(scene: Scene) -> AsyncIterator[tuple[ReplicatedChannel, Host, Host]]:
    """A channel of this test, its owner, and the host of its replica in sync."""
    assert scene.traffic is not None, "this fault is for clusters with channel hosts"
    name = f"robust-copied/{time.monotonic_ns()}"
    async with patience(f"{name} was not opened, and no put into it acknowledged"):
        channel, item = await _first_put(scene.traffic, name)
    await settled(scene.traffic)
    found = ReplicatedChannel(scene, channel, item.incarnation)
    try:
        yield (found, *await found.find())
    finally:
        await found.close()


async def _first_put(traffic: Traffic, name: str) -> tuple[aio.Channel, st.Item]:
    """Open the channel and put an item, and try again until both succeed. The caller limits the wait."""
    while True:
        with suppress(st.StampedeError):  # the host is busy, or has not come back from the last fault
            channel = await traffic.open(name)
            return channel, await traffic.put(channel)
        await asyncio.sleep(RETRY_SECONDS)


async def kill_owner(scene: Scene) -> None:
    """Kill the owner. The replica becomes the owner when the lease of the killed host has ended."""
    async with _prepare(scene) as (found, owner, replica):
        began = time.monotonic()
        await owner.kill()
        recovery = await found.wait_for_put(began)
        await started(owner)
        evidence = f"{KILLED}; from {owner.name} to {replica.name}"
        scene.ended("copies: kill -9 of the owner", began, recovery, evidence=evidence)


async def restart_owner(scene: Scene) -> None:
    """Kill the owner, and start it again within its lease. It comes back without items, so the replica must become the
    owner.
    """
    async with _prepare(scene) as (found, owner, _):
        began = time.monotonic()
        await owner.kill()
        await started(owner)
        recovery = await found.wait_for_put(began)
        scene.ended("copies: kill -9 and a restart of the owner", began, recovery, evidence=KILLED)


async def freeze_owner(scene: Scene) -> None:
    """Stop the owner for longer than its lease."""
    async with _prepare(scene) as (found, owner, _):
        began = time.monotonic()
        await owner.freeze()
        try:
            recovery = await found.wait_for_put(began)
            await asyncio.sleep(max(0.0, began + FROZEN_SECONDS - time.monotonic()))
        finally:
            owner.thaw()
        await found.wait_for_put(began)
        scene.ended("copies: SIGSTOP of the owner", began, recovery, evidence=STOPPED)


async def kill_replica(scene: Scene) -> None:
    """Kill the host of the replica. The owner finds another host."""
    async with _prepare(scene) as (found, _, replica):
        began = time.monotonic()
        await replica.kill()
        recovery = await found.wait_for_put(began)
        await started(replica)
        scene.ended("copies: kill -9 of the replica's host", began, recovery, evidence=KILLED)


async def freeze_replica(scene: Scene) -> None:
    """Stop the host of the replica for longer than the replica keeps its in-sync flag, but not as long as the host's
    lease.
    """
    async with _prepare(scene) as (found, _, replica):
        began = time.monotonic()
        await replica.freeze()
        try:
            await asyncio.sleep(DISTURBED_SECONDS)
        finally:
            replica.thaw()
        recovery = await found.wait_for_put(began)
        scene.ended("copies: SIGSTOP of the replica's host", began, recovery, evidence=STOPPED)


async def cut_copies(scene: Scene) -> None:
    """Cut the link between the owner and the replica. Both still reach the directory."""
    async with _prepare(scene) as (found, owner, replica):
        pair = (owner.namespace, replica.namespace)
        began = time.monotonic()
        async with cut(scene, [pair, pair[::-1]]) as evidence:
            await asyncio.sleep(DISTURBED_SECONDS)
        recovery = await found.wait_for_put(began)
        scene.ended("copies: no link between owner and replica", began, recovery, evidence=evidence)


async def cut_off_owner(scene: Scene) -> None:
    """Cut the owner off from the directory and the replica, but not from callers."""
    async with _prepare(scene) as (found, owner, replica):
        others = [replica.namespace, *(one.namespace for one in scene.cluster.supernodes)]
        pairs = [pair for other in others for pair in ((owner.namespace, other), (other, owner.namespace))]
        began = time.monotonic()
        async with cut(scene, pairs) as evidence:
            recovery = await found.wait_for_put(began)
        scene.ended("copies: the owner is cut off", began, recovery, evidence=evidence)


async def slow_links(scene: Scene) -> None:
    """Put a slow link before the hosts of the owner and of the replica, and kill the owner behind it."""
    async with _prepare(scene) as (found, owner, replica):
        relays = [relay for one in (owner, replica) for relay in one.relays]
        kind = scene.rng.choice([*SLOW_LINKS])
        began = time.monotonic()
        for relay in relays:
            await relay.set_conditions(*SLOW_LINKS[kind])
        try:
            await asyncio.sleep(DISTURBED_SECONDS)
            await owner.kill()
            recovery = await found.wait_for_put(began)
        finally:
            counts = [await relay.set_conditions(0, 0, 0, 0) for relay in relays]
        await started(owner)
        chunks, waited_millis = sum(one[0] for one in counts), sum(one[2] for one in counts)
        if not chunks or not (waited_millis or len(SLOW_LINKS[kind]) > DELAYS):
            raise FaultHadNoEffect(f"{chunks} chunks went through the relays, and waited {waited_millis} ms")
        evidence = f"{chunks} chunks waited {waited_millis / chunks:.0f} ms on average"
        scene.ended(f"copies: {kind}, and kill -9 of the owner", began, recovery, evidence=evidence)


async def kill_during_move(scene: Scene) -> None:
    """Move the channel, and kill the destination at some moment of the move."""
    async with _prepare(scene) as (found, owner, replica):
        to = scene.rng.choice([one for one in scene.cluster.hosts if one is not owner])
        began = time.monotonic()
        move = asyncio.create_task(found.traffic.rt.move(found.channel, to.name))
        await asyncio.sleep(scene.rng.uniform(0.0, 0.2))
        await to.kill()
        outcome = (await asyncio.gather(move, return_exceptions=True))[0]
        if isinstance(outcome, BaseException) and not isinstance(outcome, st.StampedeError):
            raise outcome
        recovery = await found.wait_for_put(began)
        await started(to)
        role = "the replica's host" if to is replica else "a host without a copy"
        note = f"a move to {role} had {'failed' if isinstance(outcome, BaseException) else 'ended'}"
        scene.ended("copies: kill -9 of a move's destination", began, recovery, evidence=KILLED, note=note)


async def _fill(filler: aio.Channel, began: float) -> int:
    """Put until the host refuses an item. Returns the number of accepted bytes. Raises FaultHadNoEffect."""
    filled = 0
    while time.monotonic() - began < PATIENCE_SECONDS:
        try:
            await filler.put(bytes(FILLER_BYTES), timeout=FILLER_SECONDS)
            filled += FILLER_BYTES
        except (st.Overloaded, st.ChannelFull):
            return filled
        except st.Unavailable:  # the host was too slow for this put
            continue
    raise FaultHadNoEffect(f"the host has not refused an item after {filled} bytes")


async def fill_replica(scene: Scene) -> None:
    """Fill the memory of the replica's host. Then the replica can take no items, and must lose its in-sync flag before
    puts go on.
    """
    async with _prepare(scene) as (found, _, replica):
        began = time.monotonic()
        name = f"robust-filler/{time.monotonic_ns()}"
        filler = await found.traffic.rt.channel(name, host=replica.name, **FILLER)
        try:
            filled = await _fill(filler, began)
            recovery = await found.wait_for_put(time.monotonic())
        finally:
            await filler.delete()
        evidence = f"{replica.name} refused an item after {filled >> 20} MiB"
        scene.ended("copies: full memory at the replica's host", began, recovery, evidence=evidence)


FILLER_BYTES, FILLER_SECONDS = 4 * 2**20, 5.0
FILLER: dict[str, Any] = {"max_age": "1h", "max_bytes": 2**30, "on_full": "reject"}
DELAYS = 4  # the number of figures about delays; a fifth figure limits the bytes per second
SLOW_LINKS: dict[str, tuple[float, ...]] = {
    "links with a delay of 100 to 300 ms": (0.1, 0.2, 0.0, 0.0),
    "links with 20 % loss": (0.002, 0.01, 0.2, 0.0),
    "links of 64 KiB a second": (0.0, 0.0, 0.0, 0.0, 65536.0),
}

FAULTS: dict[str, Fault] = {
    "copies_kill_owner": kill_owner,
    "copies_restart_owner": restart_owner,
    "copies_freeze_owner": freeze_owner,
    "copies_kill_replica": kill_replica,
    "copies_freeze_replica": freeze_replica,
    "copies_cut": cut_copies,
    "copies_cut_off_owner": cut_off_owner,
    "copies_slow_links": slow_links,
    "copies_kill_during_move": kill_during_move,
    "copies_fill_replica": fill_replica,
}
