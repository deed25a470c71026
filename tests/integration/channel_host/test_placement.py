"""The choice of the host of a new channel: by the loads that real hosts report, or beside another channel."""

from __future__ import annotations

import asyncio
import json
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Event, Thread

import pytest

import stampede_rt as st
from stampede_rt import aio
from stampede_rt.cli.main import main as stampede
from stampede_rt_local.cluster import LocalCluster
from tests.support.cluster import cluster_fixture
from tests.support.waiting import wait_until

cluster = cluster_fixture(hosts=2, supernodes=1, durable=False)
PATIENCE_SECONDS = 60.0
BUSY_PERMILLE, IDLE_PERMILLE = 150, 100
STARVED_LOAD = 5  # the load of the machine for each processor


@pytest.fixture
def rt(cluster: LocalCluster) -> Iterator[st.Connection]:
    with st.connect(cluster.address) as made:
        yield made


@contextmanager
def keeping_busy(address: str, host: str) -> Iterator[None]:
    """Put items at `host` as fast as it takes them, until the end of the block."""
    stop = Event()

    def put() -> None:
        with st.connect(address) as rt:
            channel = rt.channel("busy", host=host, max_items=1000)
            with channel.producer() as producer:
                while not stop.is_set():
                    producer.put(b"x" * 64)

    thread = Thread(target=put)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join(PATIENCE_SECONDS)


def loads(rt: st.Connection) -> dict[str, int]:
    """The share of a core that each host reported, by the host's name. Between its registration and its first report
    the load of a host is zero.
    """
    return {host.name: host.load.busy_permille for host in rt.hosts() if host.load is not None and host.load.bytes_max}


def until_one_is_busy(rt: st.Connection) -> None:
    """Wait until one host is busy. Skip the test if the machine has too little CPU time for a busy host."""

    def holds() -> bool:
        now = loads(rt)
        return now.get("h1", 0) >= BUSY_PERMILLE and now.get("h2", 1000) < IDLE_PERMILLE

    try:
        wait_until(holds, "one host is busy and the other one is idle", PATIENCE_SECONDS)
    except AssertionError:
        if os.getloadavg()[0] < STARVED_LOAD * (os.cpu_count() or 1):
            raise
        pytest.skip(f"the machine has a load of {os.getloadavg()[0]:.0f}: a host cannot take a seventh of a core")


def test_new_channels_and_queues_are_placed_on_the_idle_host_and_the_listings_show_its_load(
    cluster: LocalCluster, rt: st.Connection, capsys: pytest.CaptureFixture[str]
) -> None:
    with keeping_busy(cluster.address, "h1"):
        until_one_is_busy(rt)
        for number in range(3):
            assert rt.channel(f"new/{number}").host == "h2"
        assert rt.queue("jobs").host == "h2"
        capsys.readouterr()
        assert stampede(["hosts", "--url", cluster.address, "-o", "json"]) == 0
        rows = {row["host"]: row for row in json.loads(capsys.readouterr().out)}
    assert rows["h1"]["busy_permille"] >= BUSY_PERMILLE > IDLE_PERMILLE > rows["h2"]["busy_permille"]
    assert rows["h1"]["held_bytes"] > 0
    assert rows["h2"]["memory_bytes_max"] > 0
    assert (rows["h2"]["channels"] >= 3, rows["h2"]["machine"], rows["h2"]["alive"]) == (True, "localhost", True)


def test_the_doctor_and_the_list_of_hosts_show_the_loads(
    cluster: LocalCluster, rt: st.Connection, capsys: pytest.CaptureFixture[str]
) -> None:
    wait_until(lambda: len(loads(rt)) == len(cluster.hosts), "each host has a load", PATIENCE_SECONDS)
    assert stampede(["doctor", "--url", cluster.address, "-o", "json"]) == 0
    found = {one["part"]: one["load"] for one in json.loads(capsys.readouterr().out)}
    assert isinstance(found["host h1"], int)
    assert found["supernode s1"] is None
    assert stampede(["hosts", "--url", cluster.address]) == 0
    assert re.search(
        r"h1 +localhost:\d+ +localhost +held +\d+ +\d+ % of a core +[\d.]+ \w+ of", capsys.readouterr().out
    )


def test_both_clients_open_a_channel_beside_the_stated_channel(cluster: LocalCluster, rt: st.Connection) -> None:
    for host in ("h1", "h2"):
        first = rt.channel(f"{host}/first", host=host)
        assert rt.channel(f"{host}/second", beside=first).host == host
        assert rt.channel(f"{host}/third", beside=f"{host}/second").host == host

        async def open_fourth(near: str) -> str:
            async with aio.connect(cluster.address) as connection:
                beside = await connection.channel(f"{near}/first", create=False)
                return (await connection.channel(f"{near}/fourth", beside=beside)).host

        assert asyncio.run(open_fourth(host)) == host


def test_a_channel_beside_an_unknown_one_is_refused_with_advice(rt: st.Connection) -> None:
    with pytest.raises(st.ChannelNotFound, match="beside channel nobody, because there is no such channel; open"):
        rt.channel("lonely", beside="nobody")
    with pytest.raises(st.InvalidArgument, match="state one of them"):
        rt.channel("lonely", host="h1", beside="h1/first")
