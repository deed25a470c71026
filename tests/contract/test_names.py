"""Names, on both clients: upper and lower case differ."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

import stampede_rt as st
from stampede_rt import aio
from stampede_rt_local.cluster import LocalCluster
from tests.support.awaitable_blocking import awaitable

UPPER, LOWER = "LSL/EEG_Amp", "lsl/eeg_amp"


@pytest.fixture(params=["aio", "sync"])
async def rt(request: pytest.FixtureRequest, cluster: LocalCluster) -> AsyncIterator[Any]:
    if request.param == "aio":
        async with aio.connect(cluster.address) as connection:
            yield connection
        return
    with ThreadPoolExecutor(4) as pool, st.connect(cluster.address) as blocking:
        yield awaitable(blocking, pool)


async def test_channels_whose_names_differ_in_case_are_different_channels(rt: Any) -> None:
    upper, lower = await rt.channel(UPPER), await rt.channel(LOWER)
    assert upper.info.channel_id != lower.info.channel_id
    assert {info.name for info in await rt.channels("LSL/*")} == {UPPER}
    await _forget(upper, lower)


async def test_queues_whose_names_differ_in_case_are_different_queues(rt: Any) -> None:
    upper, lower = await rt.queue(UPPER), await rt.queue(LOWER)
    await upper.put(b"for the upper one")
    assert await lower.get(timeout=0) is None
    assert (await upper.get(timeout=10)).payload == b"for the upper one"
    assert {info.name for info in await rt.queues("LSL/*")} == {UPPER}
    await _forget(upper, lower)


async def test_groups_whose_names_differ_in_case_are_different_groups(rt: Any) -> None:
    upper, lower = await rt.channel(UPPER), await rt.channel(LOWER)
    groups = [await rt.group("Stereo", [plain(upper)]), await rt.group("stereo", [plain(lower)])]
    assert {info.name for info in await rt.groups("?tereo")} >= {"Stereo", "stereo"}
    for group in groups:
        await group.delete()
    await _forget(upper, lower)


async def test_peers_whose_names_differ_in_case_are_different_peers(rt: Any, cluster: LocalCluster) -> None:
    async with (
        aio.connect(cluster.address, name="Turtle1") as upper,
        aio.connect(cluster.address, name="turtle1") as lower,
    ):
        await rt.send("Turtle1", b"for the upper one")
        assert upper.mailbox
        assert lower.mailbox
        message = await upper.mailbox.get(timeout=10)
        assert message
        assert message.payload == b"for the upper one"
        assert await lower.mailbox.get(timeout=0) is None


async def _forget(*things: Any) -> None:
    await asyncio.gather(*(thing.delete() for thing in things))


def plain(channel: Any) -> Any:
    """Return the handle itself, without the wrapper."""
    return getattr(channel, "_wrapped", channel)
