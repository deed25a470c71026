"""Streams over sockets and over gRPC: the choice of a transport, and transports that fail."""

from __future__ import annotations

import asyncio
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import stampede_rt as st
from stampede_rt import aio
from stampede_rt_local.cluster import LocalCluster
from tests.support.cluster import cluster_fixture, running_cluster

cluster = cluster_fixture(hosts=1, supernodes=1, data_ports=True)


@pytest.fixture
def sockets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder in which hosts put their sockets if they start from now on."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    return tmp_path / "stampede"


@pytest.fixture
def own_cluster(sockets: Path) -> Iterator[LocalCluster]:
    with running_cluster(hosts=1, supernodes=1) as made:
        yield made


@pytest.mark.parametrize(
    ("chosen", "used"),
    [("grpc", "grpc"), ("best", "socket"), ("socket", "socket"), ("tcp", "tcp"), ("shared", "shared")],
)
async def test_both_clients_use_the_chosen_transport_and_say_which(
    cluster: LocalCluster, chosen: str, used: str
) -> None:
    def blocking() -> str | None:
        with st.connect(cluster.address, transport=chosen) as rt:
            channel = rt.channel("transports/said")
            channel.put(b"x")
            return channel.stats().transport

    assert await asyncio.to_thread(blocking) == used
    async with aio.connect(cluster.address, transport=chosen) as rt:
        channel = await rt.channel("transports/said")
        await channel.put(b"x")
        assert (await channel.stats()).transport == used


def test_the_command_line_shows_the_transport(cluster: LocalCluster) -> None:
    with st.connect(cluster.address) as rt:
        rt.channel("transports/shown")
    for chosen, used in (("grpc", "grpc"), ("best", "socket"), ("tcp", "tcp"), ("shared", "shared")):
        environment = os.environ | {"STAMPEDE_URL": cluster.address, "STAMPEDE_TRANSPORT": chosen}
        found = subprocess.run(
            [sys.executable, "-m", "stampede_rt.cli", "info", "transports/shown"],
            env=environment, capture_output=True, text=True, timeout=30, check=True,
        )  # fmt: skip
        [line] = [line for line in found.stdout.splitlines() if line.startswith("transport")]
        assert line.split() == ["transport", used]


@pytest.mark.parametrize("wrong", ["", "udp"])
def test_an_unknown_transport_is_refused(wrong: str) -> None:
    with pytest.raises(st.InvalidArgument, match='give "best", "grpc", "socket", "tcp" or "shared"'):
        st.connect("localhost:1", transport=wrong)


def _paths(folder: Path) -> list[Path]:
    return list(folder.iterdir())


def _use(rt: st.Connection, text: bytes) -> str | None:
    channel = rt.channel("transports/used")
    channel.put(text)
    newest = channel.newest()
    assert newest is not None
    assert newest.payload == text
    return channel.stats().transport


async def _await_use(rt: aio.Connection, text: bytes) -> str | None:
    channel = await rt.channel("transports/used")
    await channel.put(text)
    newest = await channel.newest()
    assert newest is not None
    assert newest.payload == text
    return (await channel.stats()).transport


async def test_a_program_that_cannot_reach_the_socket_uses_grpc(own_cluster: LocalCluster, sockets: Path) -> None:
    for path in _paths(sockets):
        path.unlink()
    with st.connect(own_cluster.address, transport="best") as rt:
        assert _use(rt, b"1") == "grpc"
    async with aio.connect(own_cluster.address, transport="best") as awaited:
        assert await _await_use(awaited, b"2") == "grpc"
        queue = await awaited.queue("transports/jobs")
        await queue.put(b"job")
        assert (await queue.stats()).held == 1
    with (
        st.connect(own_cluster.address, transport="socket") as rt,
        pytest.raises(st.Unavailable, match=r"no stream over a socket leads to .*No such file.*to use gRPC"),
    ):
        rt.channel("transports/used").put(b"3", timeout=3)


async def test_programs_find_the_new_socket_of_a_restarted_host(own_cluster: LocalCluster, sockets: Path) -> None:
    [host] = own_cluster.hosts
    async with aio.connect(own_cluster.address, transport="socket") as awaited:
        with st.connect(own_cluster.address, transport="socket") as rt:
            assert _use(rt, b"1") == await _await_use(awaited, b"2") == "socket"
            [former] = _paths(sockets)
            host.kill()
            host.restart()
            assert await asyncio.to_thread(_use, rt, b"3") == await _await_use(awaited, b"4") == "socket"
            [present] = _paths(sockets)  # the new process has removed the socket of the former process
            assert present != former


async def test_a_host_that_stops_removes_its_socket(own_cluster: LocalCluster, sockets: Path) -> None:
    own_cluster.stop()
    assert _paths(sockets) == []


async def test_a_program_that_sees_no_unix_socket_of_the_host_uses_its_tcp_port(sockets: Path) -> None:
    with running_cluster(hosts=1, supernodes=1, data_ports=True) as cluster:
        for path in _paths(sockets):
            path.unlink()

        def blocking() -> str | None:
            with st.connect(cluster.address, transport="socket") as rt:
                return _use(rt, b"1")

        assert await asyncio.to_thread(blocking) == "tcp"
        async with aio.connect(cluster.address, transport="socket") as awaited:
            assert await _await_use(awaited, b"2") == "tcp"


def test_a_host_without_a_data_port_has_no_streams_over_tcp(own_cluster: LocalCluster) -> None:
    with (
        st.connect(own_cluster.address, transport="tcp") as rt,
        pytest.raises(st.Unavailable, match=r"no stream over a socket leads to .* it offers none to this caller"),
    ):
        rt.channel("transports/none").put(b"1", timeout=3)
