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

S = 10**9


class TokenFile:
    """The file of a client's token."""

    def __init__(self, operator: Operator, path: Path) -> None:
        self._operator = operator
        self.path = path

    async def write(self, valid_nanos: int) -> None:
        """Put a new token into the place of the file."""
        token = await asyncio.to_thread(self._operator.new_token, "renewed", valid_nanos)
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


async def test_streams_go_on_with_the_renewed_token_without_a_gap(rig: Rig, file: TokenFile) -> None:
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


async def test_a_stream_whose_token_nobody_renews_ends(rig: Rig, file: TokenFile) -> None:
    await file.write(2 * S)
    rt = await rig.connect(secret=file.path)
    channel = await rt.channel(rig.name())
    async with await opened(channel.subscribe()) as items:
        with pytest.raises(st.PermissionDenied, match="the token of renewed has ended"):
            await anext(aiter(items))
