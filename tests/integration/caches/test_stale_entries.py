"""Each entry that a client keeps becomes stale: its use fails, and the client asks as if it had no entry.

The rows of the table in docs/connections.md are the rows of this file (paper, section 4.2). Both clients meet the same
faults. After each fault all acknowledged items are there once.
"""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import pytest

import stampede_rt as st
from stampede_rt import aio
from stampede_rt_local.cluster import LocalCluster
from stampede_rt_local.process import ServiceProcess
from tests.contract.surfaces import AwaitableObject, Surface
from tests.integration.caches.traces import Row, Trace, Traces, documented
from tests.support.cluster import running_cluster
from tests.support.waiting import until

# The kind of the entry that each row makes stale, as events in a trace name it; see `Traces.install`.
SHOWN = {
    "the first use by a thread": "channel",
    "the channel has just moved": "channel",
    "the channel has moved some seconds ago": "channel",
    "another entry of this host was dropped": "channel",
    "the channel was deleted and made again": "channel",
    "the host runs again at another port": "channel",
    "the host is gone": "channel",
    "the host is gone, and a replica is the owner": "channel",
    "the channel was deleted and made again, before a first use": "channel",
    "the queue has moved": "queue",
    "the queue was deleted and made again": "queue",
    "the peer registered again": "queue",
    "the host of the proxy is gone": "proxy",
    "this supernode is gone": "supernode",
    "all supernodes are gone": "supernode",
}
LONG_S = 30
ARCHIVED = {"archive": "7d"}
REPLICATED: dict[str, Any] = {"replicas": 1, "ack": "replica"}
_numbers = itertools.count()


def rows() -> dict[str, Row]:
    return {row.stale_after: row for row in documented()}


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LocalCluster]:
    with running_cluster(hosts=3, supernodes=3, archive=tmp_path_factory.mktemp("archive")) as made:
        yield made


@pytest.fixture(autouse=True)
def all_run(cluster: LocalCluster) -> Iterator[None]:
    """After each test all services run again."""
    yield
    run_again(cluster)


def run_again(cluster: LocalCluster) -> None:
    ended = [process for process in reversed(list(cluster.processes())) if process.ended]
    for process in ended:
        process.start()
    for process in ended:
        process.wait_ready(40)


class Client(NamedTuple):
    """A connection with the same awaitable methods for both clients, and its trace."""

    surface: Surface
    trace: Trace
    pool: ThreadPoolExecutor | None

    async def channel(self, **policy: Any) -> Any:
        """A new channel with one item."""
        channel = await self.surface.channel(f"stale/{next(_numbers)}", **{"max_items": 100, **policy})
        await channel.put(b"0")
        return channel

    async def call(self, name: str, *arguments: Any, **named: Any) -> Any:
        """Call a method of the connection."""
        found = await getattr(self.surface.connection, name)(*arguments, **named)
        return AwaitableObject(found, self.pool) if self.pool and name == "queue" else found

    def check(self, *stale_after: str) -> None:
        """Check that the entry failed as the page says, and that the client asked the parties that the page names.

        `stale_after`: rows of the page with the same kind of entry. One of them must fit.
        """
        kind = SHOWN[stale_after[0]]
        found = [rows()[one] for one in stale_after]
        allowed = [(failure, row.parties) for row in found for failure in row.failure.split(" or ")]
        assert (self.trace.failed(kind), self.trace.parties(kind)) in allowed


@pytest.fixture
async def clients(cluster: LocalCluster, monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[list[Client]]:
    """Both clients, over different transports. The blocking client has one thread, so it has one endpoint for each
    channel.
    """
    traces = Traces()
    traces.install(monkeypatch)
    address = cluster.address
    with st.connect(address, transport="socket") as blocking, ThreadPoolExecutor(1) as pool:
        async with aio.connect(address, transport="grpc") as awaited:
            yield [
                Client(Surface(blocking, pool), traces.of(blocking._session), pool),
                Client(Surface(awaited), traces.of(awaited._session), None),
            ]


@pytest.fixture
async def other(cluster: LocalCluster) -> AsyncIterator[Any]:
    """Another program, which makes the entries stale."""
    async with aio.connect(cluster.address) as rt:
        yield rt


async def of_all(clients: list[Client], step: Callable[[Client], Awaitable[Any]]) -> list[Any]:
    """Let both clients take a step at the same time."""
    return await asyncio.gather(*(step(client) for client in clients))


async def has(channel: Any, *payloads: bytes) -> None:
    """Check that the channel has these items once, in order."""
    assert [item.payload for item in await channel.get(st.OLDEST, st.NEWEST)] == [*payloads]


def test_each_row_of_the_page_is_shown_here() -> None:
    assert set(rows()) == set(SHOWN)


async def test_a_thread_without_an_endpoint_asks_the_gatekeeper(clients: list[Client]) -> None:
    client = clients[0]
    channel = await client.channel(host="h1")
    client.trace.clear()
    await asyncio.to_thread(channel._wrapped.put, b"1")
    client.check("the first use by a thread")
    await has(channel, b"0", b"1")


async def test_both_clients_find_a_channel_that_has_moved(clients: list[Client], other: Any) -> None:
    for client in clients:
        channel, unused = await client.channel(host="h1"), await client.surface.channel(host="h1")
        client.trace.clear()
        await other.move(channel.name, "h2")
        await channel.put(b"1")
        client.check("the channel has just moved", "the channel has moved some seconds ago")
        await has(channel, b"0", b"1")
        client.trace.clear()
        await unused.put(b"first")
        client.check("another entry of this host was dropped")


async def test_both_clients_find_a_channel_that_was_deleted_and_made_again(clients: list[Client], other: Any) -> None:
    for client in clients:
        channel = await client.channel(host="h1")
        client.trace.clear()
        await (await other.channel(channel.name)).delete()
        other_channel = await other.channel(channel.name, host="h2")
        assert (await channel.put(b"1")).incarnation == (await other_channel.newest()).incarnation
        client.check("the channel was deleted and made again")
        await has(channel, b"1")


async def test_both_clients_find_a_channel_that_was_made_again_before_its_first_use(
    clients: list[Client], other: Any
) -> None:
    for client in clients:
        channel = await client.surface.channel(host="h1")
        await (await other.channel(channel.name)).delete()
        await other.channel(channel.name, host="h2")
        client.trace.clear()
        await channel.put(b"1")
        client.check("the channel was deleted and made again, before a first use")
        await has(channel, b"1")


async def test_both_clients_find_a_queue_that_has_moved(clients: list[Client], other: Any) -> None:
    for client in clients:
        queue = await client.call("queue", name := f"stale/{next(_numbers)}", host="h1")
        await queue.put(b"0")
        client.trace.clear()
        await other.move_queue(name, "h2")
        await queue.put(b"1")
        client.check("the queue has moved")
        assert [(await queue.get(timeout=LONG_S)).payload for _ in range(2)] == [b"0", b"1"]


async def test_both_clients_find_a_queue_that_was_deleted_and_made_again(clients: list[Client], other: Any) -> None:
    for client in clients:
        queue = await client.call("queue", name := f"stale/{next(_numbers)}", host="h1")
        await queue.put(b"0")
        await (await other.queue(name)).delete()
        await other.queue(name, host="h2")
        client.trace.clear()
        await queue.put(b"1")
        client.check("the queue was deleted and made again")
        assert (await queue.get(timeout=LONG_S)).payload == b"1"


async def test_both_clients_find_a_peer_that_registered_again(cluster: LocalCluster, clients: list[Client]) -> None:
    for client in clients:
        name = f"stale-{next(_numbers)}"
        async with aio.connect(cluster.address, name=name) as peer:
            await client.call("send", name, b"0")
            assert (await peer.mailbox.get(timeout=LONG_S)).payload == b"0"
        async with aio.connect(cluster.address, name=name) as peer:
            client.trace.clear()
            await client.call("send", name, b"1")
            client.check("the peer registered again")
            assert (await peer.mailbox.get(timeout=LONG_S)).payload == b"1"


async def test_both_clients_find_a_host_that_runs_again_at_another_port(
    cluster: LocalCluster, clients: list[Client]
) -> None:
    channels = await of_all(clients, lambda client: client.channel(host="h1", **ARCHIVED))
    before = cluster.hosts[0].address
    assert await asyncio.to_thread(cluster.hosts[0].restart) != before
    for client, channel in zip(clients, channels, strict=True):
        client.trace.clear()
        await channel.put(b"1", timeout=LONG_S)
        client.check("the host runs again at another port")
        await has(channel, b"0", b"1")


async def test_both_clients_find_the_channels_of_a_host_that_is_gone(
    cluster: LocalCluster, clients: list[Client], other: Any
) -> None:
    """The channels come to other hosts: empty, from a replica, or from the owner instead of the proxy."""
    lost = await of_all(clients, lambda client: client.channel(host="h3"))
    kept = await of_all(clients, lambda client: client.channel(host="h3", **REPLICATED))
    read = await of_all(clients, lambda client: client.channel(host="h1"))
    for channel in read:
        await other.proxy(channel.name, "h3")
        await until_async(lambda channel=channel: is_of_proxy(channel), "the proxy answers")
    for channel in kept:
        await until_async(lambda channel=channel: is_replicated(channel), "the replica is in sync")
    cluster.hosts[2].kill()
    await asyncio.gather(
        *(find_others(*case) for case in zip(clients, read, kept, lost, strict=True)),
    )


async def find_others(client: Client, read: Any, kept: Any, lost: Any) -> None:
    """Use the entries of a host that is gone, one after the other."""
    client.trace.clear()
    assert not await is_of_proxy(read)
    client.trace.note("asked", "owner")
    client.check("the host of the proxy is gone")
    for channel, stale_after in ((kept, "the host is gone, and a replica is the owner"), (lost, "the host is gone")):
        before = channel.incarnation
        client.trace.clear()
        item = await channel.put(b"1", timeout=LONG_S)
        client.check(stale_after)
        assert (item.incarnation == before) is (channel is kept)
        await has(channel, *([b"0", b"1"] if channel is kept else [b"1"]))


async def is_of_proxy(channel: Any) -> bool:
    """Whether a proxy answers a read that any copy may answer. The whole channel is in the answer."""
    answer = await channel.get(st.OLDEST, st.NEWEST, max_staleness="60s")
    assert [item.payload for item in answer] == [b"0"]
    return answer.staleness_nanos is not None


async def is_replicated(channel: Any) -> bool:
    return any(one.in_sync for one in (await channel.stats()).copies)


async def until_async(holds: Callable[[], Awaitable[bool]], what: str) -> None:
    """Return as soon as `holds` is true."""
    async with asyncio.timeout(LONG_S):
        while not await holds():
            await asyncio.wait([asyncio.get_running_loop().create_future()], timeout=0.05)


async def test_both_clients_ask_another_supernode_when_one_is_gone(
    cluster: LocalCluster, clients: list[Client], other: Any
) -> None:
    for client in clients:
        killed = first_supernode(cluster, client)
        killed.kill()
        await until_async(lambda: has_leader(other), "the other supernodes have a leader")
        client.trace.clear()
        await client.surface.channel()
        client.check("this supernode is gone")
        await asyncio.to_thread(killed.restart)


def first_supernode(cluster: LocalCluster, client: Client) -> ServiceProcess:
    """The supernode that the client asks first."""
    connection = client.surface.connection
    session = getattr(connection, "_wrapped", connection)._session
    target = session.supernodes._targets[0]
    return next(one for one in cluster.supernodes if one.address == target)


async def has_leader(rt: Any) -> bool:
    try:
        return bool(await rt.hosts())
    except st.Unavailable:
        return False


async def test_both_clients_ask_a_front_end_when_all_supernodes_are_gone(
    cluster: LocalCluster, clients: list[Client]
) -> None:
    channels = await of_all(clients, lambda client: client.channel(host="h1"))
    for supernode in cluster.supernodes:
        supernode.kill()
    for client, channel in zip(clients, channels, strict=True):
        client.trace.clear()
        await channel.put(b"1")
        assert client.trace.parties("channel") == "", "known hosts need no directory"
    asking = [asyncio.ensure_future(client.call("hosts")) for client in clients]
    for client in clients:
        await until(
            lambda client=client: "front-end" in client.trace.parties("supernode"), "the client asks a front-end"
        )
    await asyncio.to_thread(run_again, cluster)
    await asyncio.wait(asking)
    for client, channel, count in zip(clients, channels, asking, strict=True):
        client.check("all supernodes are gone")
        assert isinstance(count.exception(), st.Unavailable | None)
        await until_async(lambda client=client: has_leader_through(client), "the directory answers")
        await has(channel, b"0", b"1")


async def has_leader_through(client: Client) -> bool:
    try:
        return len(await client.call("hosts")) == 3
    except st.Unavailable:
        return False
