"""A host is killed, and the handles of both clients continue at the replicas.

There are a channel with `ack="host"`, a group, a queue with dead letters, and a mailbox.
"""

from __future__ import annotations

import asyncio
import inspect
from collections.abc import AsyncIterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

import stampede_rt as st
from stampede_rt_local.cluster import LocalCluster
from tests.contract.queues.rig import Rig, until
from tests.support.cluster import cluster_fixture
from tests.support.waiting import pause

cluster = cluster_fixture(hosts=3, supernodes=1, scope="function")

WAIT_SECONDS_MAX, ITEMS = 60.0, 10
LEASE = "30s"  # longer than a take-over


@pytest.fixture(params=["aio", "sync"])
async def rig(request: pytest.FixtureRequest, cluster: LocalCluster) -> AsyncIterator[Rig]:
    with ThreadPoolExecutor(16) as pool:
        made = Rig(cluster.address, pool if request.param == "sync" else None)
        made.rt = await made.connect(name="robot")
        yield made
        for connection in made.connections:
            await connection.aclose()


async def mirrored(thing: Any) -> None:
    """Wait until the replica of a channel or queue is in sync, and has everything."""
    async with asyncio.timeout(WAIT_SECONDS_MAX):
        while not has_replica_with_everything(await thing.stats()):
            await pause()


def has_replica_with_everything(stats: Any) -> bool:
    copies = stats.copies if isinstance(stats, st.ChannelStats) else stats.replicas
    return any(one.in_sync and one.waiting == 0 for one in copies)


async def read(reader: Any, count: int) -> list[int]:
    """The seqs of the next items."""
    async with asyncio.timeout(WAIT_SECONDS_MAX):
        return [(await anext(reader)).seq for _ in range(count)]


class ClusterHandles:
    """A channel with a subscription, two channels in a group, a queue with a poisoned message, and a mailbox.

    All of them are at the host of the mailbox, and have a replica elsewhere.
    """

    def __init__(self, rig: Rig) -> None:
        self.rig, self.rt = rig, rig.rt

    async def set_up(self) -> None:
        self.mailbox = self.rt.mailbox
        await self.mailbox.configure(replicas=1, ack="replica")
        self.host = self.mailbox.info.host
        names = ("lags", "left", "right")
        self.channel, self.left, self.right = [
            await self.rt.channel(one, host=self.host, max_items=1000, replicas=1) for one in names
        ]
        self.group = await self.rt.group("pair", [self.left, self.right])
        queue = {"host": self.host, "replicas": 1, "ack": "replica", "lease": LEASE}
        self.dead = await self.rt.queue("dead", **queue)
        self.jobs = await self.rt.queue("jobs", max_deliveries=1, dead_letter="dead", **queue)

    async def fill(self) -> None:
        for _ in range(ITEMS):
            for channel in (self.channel, self.left, self.right):
                await channel.put(b"an item")
        await self.rt.send("robot", b"hello")
        self.letter = await self.mailbox.get(timeout=30)
        await self.rt.send("robot", b"again")
        await self.jobs.put(b"poison")
        self.poison = await self.jobs.get(timeout=30)
        for thing in (self.channel, self.left, self.right, self.dead, self.jobs, self.mailbox):
            await mirrored(thing)

    async def reader(self) -> Any:
        made = self.channel.subscribe(st.OLDEST)
        return await made if inspect.isawaitable(made) else made


async def test_channels_queues_groups_and_mailboxes_with_replicas_survive_the_loss_of_their_host(
    cluster: LocalCluster, rig: Rig
) -> None:
    things = ClusterHandles(rig)
    await things.set_up()
    await things.fill()
    reader, kept = await things.reader(), (await things.channel.get(st.OLDEST, st.NEWEST))[4]
    assert await read(reader, ITEMS) == [*range(1, ITEMS + 1)]
    group, queue = things.group.incarnation, things.jobs.incarnation
    incarnation = things.channel.incarnation

    cluster.hosts[int(things.host[1:]) - 1].kill()

    await _channel_went_on(things, reader, kept, incarnation)
    await _mailbox_went_on(things)
    await _queue_went_on(things, queue)
    await _group_began_anew(things, group)


async def _channel_went_on(things: ClusterHandles, reader: Any, kept: st.Item, incarnation: int) -> None:
    """The channel continues with all items, because the replica had them.

    Its reader still counts a loss, because the new owner cannot know that it has all of them.
    """
    item = await things.channel.put(b"after")
    assert (item.seq, item.incarnation != incarnation) == (ITEMS + 1, True)
    assert await read(reader, 1) == [ITEMS + 1]
    assert reader.losses == 1
    closed = reader.close()
    if inspect.isawaitable(closed):
        await closed
    assert (await things.channel.stats()).inherited_next_seq == ITEMS + 1
    later = await things.channel.get(st.OLDEST, st.NEWEST, after=kept)  # a position of the former incarnation
    assert [one.seq for one in later] == [*range(6, ITEMS + 2)]


async def _mailbox_went_on(things: ClusterHandles) -> None:
    """The peer settles the message that it has, and gets the next message. Senders find the mailbox."""
    await things.letter.ack()
    assert (await things.mailbox.get(timeout=30)).payload == b"again"
    await things.rt.send("robot", b"after")
    assert (await things.mailbox.get(timeout=30)).payload == b"after"
    assert things.mailbox.info.host != things.host


async def _queue_went_on(things: ClusterHandles, incarnation: int) -> None:
    """The taker gives its message back at the new host, which moves the message to the dead-letter queue."""
    await things.poison.nack()
    letter = await things.dead.get(timeout=30)
    assert (letter.payload, letter.origin.queue, letter.origin.ended) == (b"poison", "jobs", "given_back")
    await letter.ack()
    # `jobs` counts the letter only after the dead-letter queue has stored it.
    stats = await until(things.jobs, lambda stats: stats.dead_lettered == 1)
    assert (things.jobs.incarnation, stats.held) == (incarnation, 0)
    assert (await things.dead.stats()).held == 0


async def _group_began_anew(things: ClusterHandles, incarnation: int) -> None:
    """All members of the group were at the lost host, so no host knows up to which cut readers saw the group.

    The items of the members are there.
    """
    for member in (things.left, things.right):
        await member.put(b"after")
    group = await things.rt.group("pair")
    seqs = [one.seq for one in await group["left"].get(st.OLDEST, st.NEWEST, timeout=30)]
    assert seqs[:ITEMS] == [*range(1, ITEMS + 1)]
    assert group.incarnation != incarnation
