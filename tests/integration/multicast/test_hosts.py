"""Multicast while hosts move channels or are killed, and while programs send datagrams to the group."""

from __future__ import annotations

import itertools
import queue
import socket
from collections.abc import Iterator
from typing import Any

import pytest

import stampede_rt as st
from stampede_rt.transports.multicast_joining import join_group, received
from stampede_rt_local.cluster import LocalCluster
from tests.integration.proxies.readers import BackgroundReader
from tests.support.cluster import cluster_fixture
from tests.support.waiting import wait_until

GROUP = "239.255.7.8:7588"
cluster = cluster_fixture(hosts=2, supernodes=1, multicast=GROUP)
numbers = itertools.count()
PUTS = 50


@pytest.fixture
def rt(cluster: LocalCluster) -> Iterator[Any]:
    with st.connect(cluster.address, transport="grpc") as made:
        yield made


def following(channel: Any, reader: BackgroundReader) -> bool:
    """Put an item. Returns whether the reader takes the items from datagrams."""
    channel.put(b"an item")
    return bool(reader.subscription.multicast.following)


def check_has_all(channel: Any, reader: BackgroundReader) -> None:
    end = channel.put(b"end").seq
    wait_until(lambda: reader.last == end or reader.error, "the reader has everything")
    assert (reader.error, reader.seqs) == (None, [*range(1, end + 1)])


def test_a_reader_follows_the_datagrams_of_the_host_to_which_the_channel_moves(rt: Any) -> None:
    channel = rt.channel(f"cam/{next(numbers)}", max_items=10**5, host="h1")
    reader = BackgroundReader(channel.subscribe(via="multicast"))
    wait_until(lambda: following(channel, reader), "the reader hears the datagrams of the first host")
    for host in ("h2", "h1", "h2"):
        rt.move(channel, host)
        for _ in range(PUTS):
            channel.put(b"an item")
    wait_until(
        lambda: following(channel, reader) and channel.stats().multicast is not None,
        "the reader hears the datagrams of the last host",
    )
    check_has_all(channel, reader)
    reader.close()


def test_datagrams_of_others_are_dropped_and_counted(rt: Any) -> None:
    channel = rt.channel(f"cam/{next(numbers)}", max_items=10**5, host="h1")
    subscription = channel.subscribe(via="multicast")
    reader = BackgroundReader(subscription)
    with (
        join_group(GROUP, "127.0.0.1:1") as overhears,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sends,
    ):
        wait_until(lambda: following(channel, reader), "the reader hears the datagrams")
        sends.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton("127.0.0.1"))
        to = (GROUP.partition(":")[0], int(GROUP.partition(":")[2]))
        for _ in range(PUTS):
            channel.put(b"an item")
            for datagram in received(overhears):
                changed = datagram[:-1] + bytes([datagram[-1] ^ 1])
                other_key = datagram[:12] + bytes([datagram[12] ^ 1]) + datagram[13:]
                for one in (datagram, changed, other_key, b"not of this program"):
                    sends.sendto(one, to)
        check_has_all(channel, reader)
    counts = subscription.multicast
    assert min(counts.forged, counts.repeated, counts.other_key, counts.foreign) > 0
    assert counts.items > 0
    reader.close()


def test_a_callback_continues_after_its_host_was_killed(cluster: LocalCluster, rt: Any) -> None:
    called: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
    channel = rt.channel(f"cam/{next(numbers)}", max_age="60s", host="h1")
    handle = channel.on_item(lambda item: called.put(item.payload), via="multicast")
    channel.put(b"before")
    assert called.get(timeout=10) == b"before"
    cluster.hosts[0].kill()
    for payload in (b"after 1", b"after 2"):
        channel.put(payload)
    assert [called.get(timeout=30) for _ in range(2)] == [b"after 1", b"after 2"]
    assert (handle.losses, handle.active, handle.error) == (1, True, None)
    handle.cancel()
    assert handle.join(10)
