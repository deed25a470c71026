"""A backup that is restored at the address of one supernode while the others of its cluster live."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

import stampede_rt as st
from stampede_rt.v1 import directory_service_pb2 as pb
from stampede_rt.v1 import directory_service_pb2_grpc
from stampede_rt_local.cluster import LocalCluster
from stampede_rt_local.process import ServiceProcess
from stampede_rt_runtime.dial import dial
from tests.support.cluster import cluster_fixture

pytestmark = pytest.mark.without_rules("it acts as an operator")

cluster = cluster_fixture(scope="function", hosts=2, supernodes=3, log_level="debug")

LIMIT_S = 40.0
CHANNELS, ITEMS = 6, 5


def supernode_command(*words: str) -> str:
    """The output of `stampede supernode ...`. The secret comes from the environment."""
    done = subprocess.run(
        [sys.executable, "-m", "stampede_rt.cli", "supernode", *words],
        env=os.environ,
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=True,
    )
    return done.stdout


def until(holds: Callable[[], bool], what: str) -> None:
    tick = threading.Event()
    for _ in range(int(LIMIT_S * 10)):
        if holds():
            return
        tick.wait(0.1)
    raise AssertionError(f"not within {LIMIT_S} s: {what}")


@contextmanager
def restored_at(address: str, backup: Path, folder: Path, *words: str) -> Iterator[subprocess.Popen[str]]:
    """A cluster of one, made of a backup, that serves at this address."""
    at = ["--data-dir", str(folder), "--listen", address]
    supernode_command("init", *at, "--id", "restored", "--restore", str(backup), *words)
    with subprocess.Popen(
        [sys.executable, "-m", "stampede_rt_supernode", *at], env=os.environ, stdout=subprocess.PIPE, text=True
    ) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline(), "the restored supernode ended before it was ready"
            yield process
        finally:
            process.send_signal(signal.SIGTERM)


async def hosts_at(cluster: LocalCluster, address: str, *, include_dead: bool) -> list[Any]:
    """The hosts that the directory at this address lists."""
    async with dial(address, secret=cluster.secret) as channel:
        stub: Any = directory_service_pb2_grpc.DirectoryServiceStub(channel)
        return list((await stub.ListHosts(pb.ListHostsRequest(include_dead=include_dead), timeout=LIMIT_S)).hosts)


def payloads(channel: st.Channel) -> list[bytes]:
    return [item.payload for item in channel.get(st.OLDEST, st.NEWEST)]


def has_logged(process: ServiceProcess, text: str) -> bool:
    return any(text in line for line in process.last_lines)


def test_hosts_and_front_ends_stay_in_their_cluster_and_lose_no_item(cluster: LocalCluster, tmp_path: Path) -> None:
    *living, gone = cluster.supernodes
    backup = tmp_path / "backup"
    with st.connect(cluster.address) as rt:
        channels = [rt.channel(f"cam/{number}", max_items=100) for number in range(CHANNELS)]
        put = [b"%d" % number for number in range(ITEMS)]
        for channel in channels:
            for payload in put:
                channel.put(payload)
        before = {one.name: (one.info.host, one.info.incarnation, one.info.epoch) for one in channels}
        assert len({host for host, _, _ in before.values()}) == len(cluster.hosts), "both hosts own channels"
        supernode_command("snapshot", "--member", living[0].address, "--out", str(backup))
        gone.kill()
        with restored_at(gone.address, backup, tmp_path / "restored"):
            for one in living:
                one.pause()  # now the restored supernode, a stranger to this cluster, is the only one that answers
            try:
                [frontend] = cluster.frontends
                for host in cluster.hosts:
                    until(
                        # Once the front-end has left the stranger out, no host learns the stranger's address any more.
                        lambda host=host: (
                            has_logged(host, "is of another cluster")
                            or has_logged(frontend, "another cluster's supernode")
                        ),
                        f"{host.name} is refused by the stranger, or the front-end leaves the stranger out",
                    )
            finally:
                for one in living:
                    one.resume()
            until(lambda: _serves(channels[0]), "puts are taken again")
            for channel in channels:
                assert payloads(channel)[:ITEMS] == put
            with st.connect(cluster.address) as newcomer:
                for name, owned in before.items():
                    info = newcomer.channel(name, create=False).info
                    assert (info.host, info.incarnation, info.epoch) == owned, "the channel keeps its owner"
                newcomer.channel("cam/new").put(b"taken by those that live")
            # the status names the stranger, whose id is "restored", as the supernode at this address
            assert "restored is there" in supernode_command("status", "--member", living[0].address)
            # The stranger knows both hosts from the backup. Neither host renews its lease there, so their leases end.
            assert len(asyncio.run(hosts_at(cluster, gone.address, include_dead=True))) == len(cluster.hosts)
            until(
                lambda: not asyncio.run(hosts_at(cluster, gone.address, include_dead=False)),
                "both leases end at the stranger",
            )
            assert len(asyncio.run(hosts_at(cluster, living[0].address, include_dead=False))) == len(cluster.hosts)


def test_hosts_and_connected_clients_follow_the_cluster_that_replaces_theirs(
    cluster: LocalCluster, tmp_path: Path
) -> None:
    backup, at = tmp_path / "backup", cluster.supernodes[1].address
    with st.connect(cluster.address) as rt:
        former_id, kept = rt.cluster_id, rt.channel("cam/kept", max_items=100)
        kept.put(b"before")
        supernode_command("snapshot", "--member", at, "--out", str(backup))
        for one in cluster.supernodes:
            one.kill()
        with restored_at(at, backup, tmp_path / "restored", "--take-over"):
            until(
                lambda: _serves(rt.channel("cam/new")), "a channel is made in the new cluster, and its host takes puts"
            )
            until(lambda: _serves(kept), "the host of an older channel takes puts of a client of the new cluster")
            assert payloads(kept)[0] == b"before"
            # `rt.cluster_id` changes only when the client next measures its round trips. So look at new clients.
            until(lambda: _binds_elsewhere(cluster, former_id), "the front-end binds new clients to the new cluster")


def _binds_elsewhere(cluster: LocalCluster, former_id: str) -> bool:
    try:
        with st.connect(cluster.address) as rt:
            return rt.cluster_id != former_id
    except st.StampedeError:
        return False


def _serves(channel: st.Channel) -> bool:
    try:
        channel.put(b"after")
    except st.StampedeError:
        return False
    return True
