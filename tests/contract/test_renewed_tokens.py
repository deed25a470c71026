"""Client tokens that are renewed in their file while the client uses them."""

from __future__ import annotations

import asyncio
import inspect
from collections.abc import AsyncIterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

import stampede_rt as st
from stampede_rt_local.cluster import LocalCluster
from tests.contract.queues.rig import Rig
from tests.support.operator import Operator, operating
from tests.support.waiting import pause

S = 10**9


class TokenFile:
    """The file of a client's token."""

    def __init__(self, operator: Operator, path: Path) -> None:
        self._operator = operator
        self.path = path

    async def write(self, valid_nanos: int) -> None:
        """Put a new token into the place of the file."""
        token = await asyncio.to_thread(self._operator.new_token, "tester-renewed", valid_nanos)
        new = self.path.with_suffix(".new")
        new.touch(mode=0o600)
        new.write_text(token)
        new.rename(self.path)


@pytest.fixture
def file(cluster: LocalCluster, tmp_path: Path) -> Any:
    with operating(cluster) as operator:
        yield TokenFile(operator, tmp_path / "token")


@pytest.fixture(params=["aio", "sync"])
async def rig(request: pytest.FixtureRequest, cluster: LocalCluster) -> AsyncIterator[Rig]:
    with ThreadPoolExecutor(16) as pool:
        made = Rig(cluster.address, pool if request.param == "sync" else None)
        yield made
        for connection in made.connections:
            await connection.aclose()


async def opened(stream: Any) -> Any:
    """A stream of either client."""
    return await stream if inspect.isawaitable(stream) else stream


async def test_open_streams_continue_with_a_renewed_token_without_a_gap(rig: Rig, file: TokenFile) -> None:
    await file.write(3 * S)
    rt = await rig.connect(secret=file.path)
    name = rig.name()
    channel, queue = await rt.channel(name), await rt.queue(name)
    group = await rt.group(name, [channel])
    async with await opened(channel.subscribe()) as items, await opened(group.subscribe()) as cuts:
        await channel.put(b"0")
        assert (await anext(aiter(items))).payload == b"0"
        await anext(aiter(cuts))
        await file.write(3600 * S)
        number = 0
        while not (items.reconnects and cuts.reconnects):  # ends with the first token
            number += 1
            await channel.put(b"%d" % number)
            assert (await anext(aiter(items))).payload == b"%d" % number
            await anext(aiter(cuts))
            await queue.put(b"%d" % number)
            message = await queue.get(timeout=10)
            assert message.payload == b"%d" % number
            await message.ack()
            await pause(0.02)


class WaitingCalls:
    """All kinds of waits of a client, under way over the streams of one connection."""

    def __init__(self, rig: Rig, rt: Any, peer: Any) -> None:
        self.rig, self.rt, self.peer, self.name = rig, rt, peer, rig.name()
        self.streams: list[Any] = []
        self.waiting: dict[str, asyncio.Future[Any]] = {}

    async def begin(self) -> None:
        """Begin all waits. `bring` makes the items and messages for which they wait."""
        rt = self.rt
        channel, full = (
            await rt.channel(self.name),
            await rt.channel(f"{self.name}/full", max_items=1, max_age="1h", on_full="block"),
        )
        group, queue = await rt.group(self.name, [channel]), await rt.queue(self.name)
        await full.put(b"first")
        for kind, opening in {
            "subscription": channel.subscribe(),
            "cuts": group.subscribe(),
            "matches": group.match(channel, "1ms"),
            "names": rt.watch(f"{self.name}/new"),
            "peers": rt.watch_peers(f"{self.name}/peer"),
        }.items():
            stream = await opened(opening)
            self.streams.append(stream)
            await stream.__aenter__()
            self.waiting[kind] = asyncio.ensure_future(anext(aiter(stream)))
        for kind, wait in {
            "get": channel.newest(timeout=30),
            "get in group": group[self.name].newest(timeout=30),
            "queue": queue.get(timeout=30),
            "mailbox": self.peer.mailbox.get(timeout=30),
            "full put": full.put(b"second", timeout=30),
        }.items():
            self.waiting[kind] = asyncio.ensure_future(wait)

    async def bring(self, own: Any, **credential: Any) -> None:
        """End each wait by an item, a message or a change, made over `own` and a connection with `credential`."""
        channel = await own.channel(self.name)
        for _ in range(2):  # the second item makes the first one visible in the group
            await channel.put(b"x")
        await (await own.queue(self.name)).put(b"x")
        await own.channel(f"{self.name}/new")
        await (await own.channel(f"{self.name}/full")).configure(max_items=2)
        await own.send(self.peer.name, b"x")
        other = await self.rig.connect(name=f"{self.name}/peer", **credential)
        await other.mailbox.get(timeout=0)

    async def check(self) -> None:
        """Check the result of each wait."""
        found = dict(zip(self.waiting, await asyncio.gather(*self.waiting.values()), strict=True))
        payloads = {found[kind].payload for kind in ("subscription", "get", "get in group", "queue", "mailbox")}
        assert payloads == {b"x"}
        assert found["full put"].payload == b"second"

    async def close(self) -> None:
        for stream in self.streams:
            await stream.__aexit__(None, None, None)


async def ticking(own: Any, rt: Any, name: str, until_unix_nano: float) -> None:
    """Follow a channel over `rt` until that time, and until the stream has opened again.

    On a slow machine the stream may open with the renewed token, and need not open again.
    """
    channel = await own.channel(name)
    async with await opened((await rt.channel(name)).subscribe()) as items:
        while st.now() < until_unix_nano or not (items.reconnects or st.now() > until_unix_nano + 10 * S):
            await channel.put(b"tick")
            await anext(aiter(items))
            await pause(0.02)


@pytest.mark.parametrize("renewed", [True, False])
async def test_waiting_calls_continue_with_a_renewed_token_and_end_without_one(
    rig: Rig, file: TokenFile, renewed: bool
) -> None:
    own = await rig.connect()
    await file.write(3 * S)
    ends = st.now() + 3 * S
    rt, peer = await rig.connect(secret=file.path), await rig.connect(secret=file.path, name=rig.name())
    await peer.mailbox.get(timeout=0)
    waits = WaitingCalls(rig, rt, peer)
    async with asyncio.timeout(50):
        await waits.begin()
        if renewed:
            await file.write(3600 * S)
            await ticking(own, rt, f"{waits.name}/tick", ends + 1.5 * S)  # a host looks for ended tokens each second
            assert not [kind for kind, one in waits.waiting.items() if one.done()]
            await waits.bring(own)
            await waits.check()
        else:
            ended = await asyncio.gather(*waits.waiting.values(), return_exceptions=True)
            refused = {kind: str(one) for kind, one in zip(waits.waiting, ended, strict=True)}
            assert [type(one) for one in ended] == [st.PermissionDenied] * len(ended), refused
            assert all("the token of tester-renewed has ended" in one for one in refused.values()), refused
    await waits.close()
