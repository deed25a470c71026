"""Outages that last longer than any call: streams report that they are broken, and go on afterwards."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

import stampede_rt as st
from stampede_rt import aio
from stampede_rt._async import stream_reconnector as reconnecting_async
from stampede_rt._sync import stream_reconnector as reconnecting_sync
from stampede_rt_local.cluster import LocalCluster
from tests.support.cluster import cluster_fixture
from tests.support.waiting import wait_until

cluster = cluster_fixture(hosts=1, supernodes=1, durable=False, scope="function")
LIMIT_S = 45


@contextmanager
def outage(cluster: LocalCluster) -> Iterator[None]:
    """Stop all services during the block. Afterwards start them at the same addresses, without their data."""
    for process in cluster.processes():
        process.kill()
    yield
    for process in reversed(list(cluster.processes())):
        process.restart()


class OutageLog:
    """The lines that streams write when they have been broken for 10 s."""

    def __init__(self, caplog: pytest.LogCaptureFixture) -> None:
        self._caplog = caplog

    def broken(self, *names: str) -> bool:
        lines = [record.getMessage() for record in self._caplog.records]
        return all(any(name in line and "has been broken" in line for line in lines) for name in names)


@pytest.mark.without_rules("a restarted cluster in memory forgets its rules and the keys of tokens")
def test_after_a_long_outage_all_streams_of_the_program_continue(
    cluster: LocalCluster, caplog: pytest.LogCaptureFixture
) -> None:
    logged, got, taken = OutageLog(caplog), [], []
    with st.connect(cluster.address) as rt:
        camera, queue, plain = rt.channel("outage/camera"), rt.queue("outage/work"), rt.channel("outage/plain")
        listener = camera.on_item(lambda item: got.append(item.payload))
        camera.put(b"before")
        wait_until(lambda: got == [b"before"], "the listener has the first item")
        assert (listener.connected, listener.reconnects) == (True, 0)
        subscription, watch = plain.subscribe(), rt.watch_peers()
        raised: dict[str, BaseException] = {}

        def follow(name: str, one: Any) -> None:
            try:
                for found in one:
                    taken.append(found)
                    found.ack()
            except st.StampedeError as error:
                raised[name] = error

        streams = {"subscription": subscription, "queue": queue, "watch": watch}
        threads = [threading.Thread(target=follow, args=pair, daemon=True) for pair in streams.items()]
        for thread in threads:
            thread.start()
        with outage(cluster):
            wait_until(lambda: logged.broken("on_item", "subscription to channel", "watch"), "the outage is logged")
            assert [one.connected for one in (listener, subscription, watch)] == [False] * 3
            assert listener.active
        wait_until(lambda: listener.connected, "on_item is back")
        camera.put(b"after")
        wait_until(lambda: b"after" in got, "on_item goes on")
        queue.put(b"after")
        wait_until(lambda: [message.payload for message in taken] == [b"after"], "the iteration over the queue goes on")
        wait_until(lambda: len(raised) == 2, "the subscription and the watch report that all was lost")
        assert isinstance(raised["subscription"], st.IncarnationLost)
        assert isinstance(raised["watch"], st.WatchRestart)
        assert (listener.losses, listener.error) == (1, None)


@pytest.mark.without_rules("a restarted cluster in memory forgets its rules and the keys of tokens")
async def test_after_a_long_outage_all_awaited_streams_of_the_program_continue(
    cluster: LocalCluster, caplog: pytest.LogCaptureFixture
) -> None:
    logged, got = OutageLog(caplog), []
    async with aio.connect(cluster.address) as rt:
        camera, queue = await rt.channel("outage/camera"), await rt.queue("outage/work")
        listener = await camera.on_item(lambda item: got.append(item.payload))
        await camera.put(b"before")
        await asyncio.to_thread(wait_until, lambda: got == [b"before"], "the listener has the first item")

        async def take() -> bytes:
            async for message in queue:
                await message.ack()
                return message.payload
            raise AssertionError("the iteration ended")

        taking = asyncio.ensure_future(take())
        with outage(cluster):
            await asyncio.to_thread(wait_until, lambda: logged.broken("on_item"), "the outage is logged")
            assert (listener.connected, listener.active) == (False, True)
        await asyncio.to_thread(wait_until, lambda: listener.connected, "on_item is back")
        await camera.put(b"after")
        await asyncio.to_thread(wait_until, lambda: b"after" in got, "on_item goes on")
        await queue.put(b"after")
        async with asyncio.timeout(LIMIT_S):
            assert await taking == b"after"


def test_streams_that_may_not_wait_say_that_their_host_is_gone(
    cluster: LocalCluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reconnecting_sync, "TRY_TIMEOUT_S", 0.5)
    monkeypatch.setattr(reconnecting_async, "TRY_TIMEOUT_S", 0.5)
    with st.connect(cluster.address) as rt:
        camera = rt.channel("outage/short")
        group = rt.group("outage/group", [camera])
        streams = [
            camera.subscribe(reconnect="0s"),
            group.subscribe(reconnect="0s"),
            group.match(camera, "1ms", reconnect="0s"),
            rt.watch(reconnect="0s"),
        ]
        listener = camera.on_item(print, reconnect="0s")
        for process in cluster.processes():
            process.kill()
        for one in streams:
            with pytest.raises(st.Unavailable):
                next(one)
        assert listener.join(LIMIT_S)
        assert isinstance(listener.error, st.Unavailable)


def test_a_connection_that_was_cut_is_counted_and_nothing_is_missed(cluster: LocalCluster) -> None:
    with st.connect(cluster.address, transport="socket") as rt:  # through shared memory a reader has no connection
        camera = rt.channel("outage/cut", max_age="60s")
        group = rt.group("outage/cut-group", [camera])
        with camera.subscribe() as items, group.match(camera, "1ms") as matches, group.subscribe() as cuts:
            for number in range(3):
                camera.put(b"%d" % number)
                assert next(items).payload == b"%d" % number
                assert next(matches)[camera].payload == b"%d" % number
                assert (items.reconnects, matches.reconnects, cuts.reconnects) == (number, number, number)
                cuts._streams[0].conversation._call.cancel()
                for stream in (items, matches):
                    stream._stream._call.cancel()  # type: ignore[attr-defined]
                camera.put(b"between", time=st.now() - 10**9)
                assert next(items).payload == b"between"
                camera.put(b"next")
                next(cuts)
                assert next(items).payload == b"next"
                while next(matches)[camera].payload != b"next":
                    pass
