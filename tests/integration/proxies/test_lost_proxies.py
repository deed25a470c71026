"""Killed or frozen owners and proxies, and cut links: readers go on, or learn of the loss."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

import stampede_rt as st
from stampede_rt_local.cluster import LocalCluster
from stampede_rt_local.process import ServiceProcess
from tests.integration.proxies.readers import all_saw, eventually, produced, reading, wait_for_puts
from tests.support.cluster import cluster_fixture
from tests.support.cutting_relay import CUTS
from tests.support.relayed_cluster import running_relayed_cluster

cluster = cluster_fixture(hosts=3, supernodes=1, scope="function")


@contextmanager
def frozen(process: ServiceProcess) -> Iterator[None]:
    """Stop the process during the block."""
    os.kill(process.pid, signal.SIGSTOP)
    try:
        yield
    finally:
        os.kill(process.pid, signal.SIGCONT)


def opened(rt: Any) -> Any:
    return rt.channel("cam", max_items=100_000, host="h1")


def has_readers(rt: Any, channel: Any, host: str) -> bool:
    return any(one.host == host and one.subscriptions for one in rt.proxies(channel))


def test_readers_of_a_killed_proxy_continue_at_the_owner(cluster: LocalCluster) -> None:
    with st.connect(cluster.address, transport="grpc") as rt:
        channel = opened(rt)
        rt.proxy(channel, "h2")
        with reading(channel, 6) as readers, produced(channel) as producing:
            eventually(lambda: has_readers(rt, channel, "h2"), "some readers are at the proxy")
            cluster.hosts[1].kill()
            wait_for_puts(producing, 100)
            all_saw(readers, producing.stop())
            eventually(lambda: rt.proxies(channel) == [], "the directory no longer lists the proxy")
            assert channel.stats().subscriptions == 6


def test_readers_of_a_frozen_proxy_continue_at_the_owner(cluster: LocalCluster) -> None:
    with st.connect(cluster.address, transport="grpc") as rt:
        channel = opened(rt)
        rt.proxy(channel, "h2")
        with reading(channel, 4) as readers, produced(channel) as producing:
            eventually(lambda: has_readers(rt, channel, "h2"), "some readers are at the proxy")
            with frozen(cluster.hosts[1]):
                wait_for_puts(producing, 100)
                eventually(lambda: channel.stats().subscriptions == 4, "all readers are at the owner")
                all_saw(readers, producing.stop())


def test_a_proxy_serves_its_readers_while_the_owner_is_frozen(cluster: LocalCluster) -> None:
    """The owner is frozen for less than its lease.

    The owner comes back with its items, and the proxy continues at its place.
    """
    with st.connect(cluster.address, transport="grpc") as rt:
        channel = opened(rt)
        rt.proxy(channel, "h2")

        def read_at_proxy() -> list[int]:
            answer = channel.get(st.OLDEST, st.NEWEST, max_staleness="60s")
            return [] if answer.staleness_nanos is None else [one.seq for one in answer]

        with reading(channel, 4) as readers:
            first = channel.put(b"an item").seq
            eventually(lambda: has_readers(rt, channel, "h2"), "some readers are at the proxy")
            all_saw(readers, first)
            eventually(lambda: read_at_proxy() == [first], "the proxy answers gets")
            with frozen(cluster.hosts[0]):
                assert read_at_proxy() == [first]
            with produced(channel) as producing:
                wait_for_puts(producing, 50)
                all_saw(readers, producing.stop())
            eventually(lambda: rt.proxies(channel)[0].ready, "the proxy serves readers")


def test_readers_of_a_proxy_learn_of_the_loss_of_the_owner_and_continue_with_the_new_one(
    cluster: LocalCluster,
) -> None:
    with st.connect(cluster.address, transport="grpc") as rt:
        channel = opened(rt)
        rt.proxy(channel, "h2")
        incarnation = channel.incarnation
        with reading(channel, 4) as readers:
            all_saw(readers, channel.put(b"an item").seq)
            cluster.hosts[0].kill()
            item = channel.put(b"of the next incarnation")
            assert item.incarnation != incarnation
            eventually(
                lambda: all(isinstance(one.error, st.IncarnationLost) for one in readers),
                "all readers learn of the loss",
            )
        if channel.host != "h2":  # otherwise the proxy's host has become the owner, and the proxy has ended
            eventually(lambda: rt.proxies(channel)[0].ready, "the proxy follows the new owner")
            eventually(lambda: rt.proxies(channel)[0].held == 1, "the proxy has only the items of the new incarnation")
        with reading(channel, 4) as readers:
            all_saw(readers, item.seq)


@pytest.mark.parametrize("transport", ["grpc", "tcp"])
def test_a_proxy_continues_after_a_broken_link(transport: str) -> None:
    """The link from the owner to the proxy breaks in all ways; the readers of the proxy miss and repeat nothing."""
    with (
        running_relayed_cluster(hosts=1, feed_transport=transport) as relayed,
        st.connect(relayed.address, transport="grpc") as rt,
    ):
        channel = rt.channel("cam", max_items=100_000, host=relayed.host)
        rt.proxy(channel, "h1")
        with reading(channel, 4) as readers, produced(channel) as producing:
            eventually(lambda: has_readers(rt, channel, "h1"), "some readers are at the proxy")
            for how in CUTS:
                wait_for_puts(producing, 30)
                relayed.relay.cut(how)
            wait_for_puts(producing, 30)
            all_saw(readers, producing.stop())
            eventually(lambda: rt.proxies(channel)[0].reconnects >= 1, "the feed was opened again")
            over_tcp = any("transport=tcp" in line for line in relayed.cluster.hosts[0].last_lines)
            assert over_tcp == (transport == "tcp")
