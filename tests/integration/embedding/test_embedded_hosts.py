"""Hosts inside programs: other programs use the channels of such a host, and it leaves in order, whatever its
program does.
"""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

import stampede_rt as st
from stampede_rt import aio
from stampede_rt.cluster.connecting import parse_target
from stampede_rt.cluster.embedding import HostOptions
from stampede_rt_channel_host.embedded import embed
from stampede_rt_local.cluster import LocalCluster
from tests.support.cluster import cluster_fixture
from tests.support.waiting import wait_until

pytestmark = pytest.mark.without_rules("a client token cannot host channels")
cluster = cluster_fixture(hosts=1, supernodes=1)
LIMIT_S = 90


def names_of_hosts(rt: st.Connection) -> set[str]:
    return {host.name for host in rt.hosts() if host.alive}


def test_other_programs_use_a_channel_of_an_embedded_host_and_continue_when_it_leaves(cluster: LocalCluster) -> None:
    with st.connect(cluster.address) as other:
        with st.host(cluster.address, name="rig-1") as rt:
            here = rt.channel("embedded/1", max_items=10)
            here.put(b"first", time=1)
            there = other.channel("embedded/1", create=False)
            assert (here.host, there.host) == ("rig-1", "rig-1")
            there.put(b"second", time=2)
            assert [item.payload for item in here.get(st.OLDEST, st.NEWEST)] == [b"first", b"second"]
            assert "rig-1" in names_of_hosts(other)
            with other.channel("embedded/1").subscribe(start=st.OLDEST) as items:
                assert next(items).payload == b"first"
                incarnation = there.incarnation
        assert [item.payload for item in there.get(st.OLDEST, st.NEWEST)] == [b"first", b"second"]
        assert (there.host, there.incarnation) == ("h1", incarnation), "the items of the embedded host have moved"
        assert "rig-1" not in names_of_hosts(other)


def test_a_program_with_a_host_hosts_its_new_channels_and_queues_by_default(cluster: LocalCluster) -> None:
    with st.connect(cluster.address) as other, st.host(cluster.address, name="rig-2") as rt:
        other.channel("embedded/elsewhere", host="h1")
        assert rt.channel("embedded/here", max_items=5).host == "rig-2"
        assert rt.channel("embedded/elsewhere").host == "h1"
        assert rt.channel("embedded/named", host="h1").host == "h1"
        assert rt.channel("embedded/beside", beside="embedded/named").host == "h1"
        assert rt.queue("embedded/queue").info.host == "rig-2"
        with pytest.raises(st.ChannelNotFound):
            rt.channel("embedded/none", create=False)
        with pytest.raises(st.ChannelExists):
            rt.channel("embedded/here", max_items=3)


def test_a_private_host_gets_only_channels_that_name_it(cluster: LocalCluster) -> None:
    with st.connect(cluster.address) as other, st.host(cluster.address, name="rig-private", private=True) as rt:
        (load,) = [one.load for one in rt.hosts() if one.name == "rig-private"]
        assert load is not None
        assert load.private
        assert {other.channel(f"embedded/not-here/{at}").host for at in range(4)} == {"h1"}
        assert other.queue("embedded/no-queue").info.host == "h1"
        assert rt.channel("embedded/mine").host == "rig-private"
        assert other.channel("embedded/named-here", host="rig-private").host == "rig-private"


async def test_several_hosts_live_in_one_program_with_and_without_asyncio(cluster: LocalCluster) -> None:
    async with aio.host(cluster.address, name="rig-3") as rt, aio.host(cluster.address, name="rig-4") as second:
        camera = await rt.channel("embedded/3")
        await camera.put(b"frame")
        same = await second.channel("embedded/3")
        newest = await same.newest()
        assert newest is not None
        assert newest.payload == b"frame"
        assert (same.host, (await second.channel("embedded/4")).host) == ("rig-3", "rig-4")


def test_a_host_refuses_puts_beyond_its_memory(cluster: LocalCluster) -> None:
    with st.host(cluster.address, name="rig-5", max_memory="1MiB", drain="0s") as rt:
        channel = rt.channel("embedded/5", max_items=100)
        for _ in range(6):
            channel.put(bytes(100_000))
        with pytest.raises(st.Overloaded):
            channel.put(bytes(500_000), timeout=0)


def test_a_host_that_cannot_listen_reports_the_reason(cluster: LocalCluster) -> None:
    message = r"in use by another process; .*another port with listen$"
    with socket.create_server(("127.0.0.1", 0)) as taken, pytest.raises(st.InvalidArgument, match=message):
        st.host(cluster.address, listen=f"127.0.0.1:{taken.getsockname()[1]}")
    with pytest.raises(st.InvalidArgument, match="cannot host channels"):
        st.host(cluster.address, listen="no address")


def test_the_error_names_the_missing_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.metadata.entry_points", lambda group: [])
    with pytest.raises(st.InvalidArgument, match=r"\[server\]"):
        st.host("localhost:1")


def test_a_client_token_cannot_start_a_host() -> None:
    with pytest.raises(st.PermissionDenied, match="a process with a client token cannot host channels"):
        st.host("localhost:1", secret="stampede-token-1.a.b")


@contextmanager
def program(cluster: LocalCluster, source: str) -> Iterator[subprocess.Popen[str]]:
    """A program that is a host. The block gets its process."""
    started = subprocess.Popen(
        [sys.executable, "-c", f"import os, signal, sys\nimport stampede_rt as st\n{source}"],
        env={**os.environ, "STAMPEDE_URL": cluster.address}, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        yield started
    finally:
        started.kill()
        started.communicate(timeout=LIMIT_S)


def line_of(started: subprocess.Popen[str]) -> str:
    assert started.stdout is not None
    return started.stdout.readline().strip()


def test_a_program_that_forgets_to_close_ends_and_its_channels_move(cluster: LocalCluster) -> None:
    source = """
rt = st.host(name="rig-6")
rt.channel("embedded/6").put(b"kept", time=5)
rt.queue("embedded/queue-6").put(b"kept, too")
"""
    with program(cluster, source) as started:
        assert started.wait(LIMIT_S) == 0
    with st.connect(cluster.address) as rt:
        item = rt.channel("embedded/6", create=False).newest()
        assert item is not None
        assert item.payload == b"kept"
        message = rt.queue("embedded/queue-6", create=False).get(timeout=LIMIT_S)
        assert message is not None
        assert message.payload == b"kept, too"
        assert "rig-6" not in names_of_hosts(rt)


def test_a_restarted_program_waits_for_the_name_of_its_former_process(cluster: LocalCluster) -> None:
    """A program that ends without a close remains a peer until the lease of the peer ends."""
    made: list[st.Connection] = []

    def start_again() -> None:
        made.append(st.host(cluster.address, name="rig-8"))

    with st.connect(cluster.address) as other, st.connect(cluster.address, name="rig-8") as former:
        restarting = threading.Thread(target=start_again)
        restarting.start()
        wait_until(lambda: "rig-8" in names_of_hosts(other), "the host has started")
        former.close()
        restarting.join(LIMIT_S)
        assert [one.name for one in made] == ["rig-8"]
        made[0].close()


def test_a_host_that_is_closed_before_its_loop_runs_leaves_the_cluster() -> None:
    options = HostOptions.parse(None, None, "1GiB", "0s", False)
    host = embed(parse_target("localhost:1", name=None, secret=None, zone=None), options)
    host.ask_to_leave()
    with pytest.raises(st.Unavailable, match="was stopped before the directory"):
        host.start(LIMIT_S)
    host.leave()
    assert not host.is_alive


def test_a_get_without_a_limit_ends_with_the_connection(cluster: LocalCluster) -> None:
    failed: list[BaseException] = []

    def wait(channel: st.Channel) -> None:
        try:
            channel.newest(timeout=None)
        except st.StampedeError as error:
            failed.append(error)

    with st.host(cluster.address, name="rig-waits", drain="0s") as rt:
        channel = rt.channel("embedded/waits")
        waiting = threading.Thread(target=wait, args=[channel], daemon=True)
        waiting.start()
        while channel.stats().waiting_gets == 0:
            pass  # each request is a round trip
    waiting.join(LIMIT_S)
    assert len(failed) == 1


def test_a_forked_child_of_an_embedded_host_neither_serves_nor_keeps_the_port_nor_deregisters_the_host(
    cluster: LocalCluster,
) -> None:
    source = """
rt = st.host(name="rig-7")
rt.channel("embedded/7").put(b"x")
child = os.fork()
if child == 0:
    rt.close()
    try:
        rt.channel("embedded/other")
    except st.ForkedProcess:
        sys.stdin.readline()
    os._exit(0)
print(child, *[host.endpoints[0] for host in rt.hosts() if host.name == "rig-7"], flush=True)
signal.pause()
"""
    with st.connect(cluster.address) as rt, program(cluster, source) as started:
        child, target = line_of(started).split()
        host, port = target.rsplit(":", 1)
        try:
            channel = rt.channel("embedded/7", create=False)
            assert channel.newest() is not None, "the close in the child has ended nothing"
            socket.create_connection((host, int(port))).close()
            started.kill()
            started.wait(LIMIT_S)
            with pytest.raises(ConnectionRefusedError):
                socket.create_connection((host, int(port)))
            os.kill(int(child), 0)  # the child still runs
        finally:
            os.kill(int(child), signal.SIGKILL)
