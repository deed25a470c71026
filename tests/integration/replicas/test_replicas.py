"""Channels with replicas, between real processes: owners and replicas that are killed or frozen under a producer."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

import stampede_rt as st
from stampede_rt.files.editing import verify
from stampede_rt_local.cluster import LocalCluster
from stampede_rt_local.process import ServiceProcess
from tests.integration.proxies.readers import all_saw, awaited_reading, eventually, produced, reading, wait_for_puts
from tests.support.waiting import wait_until


@pytest.fixture
def cluster(three_hosts: LocalCluster) -> LocalCluster:
    return three_hosts


@contextmanager
def frozen(process: ServiceProcess) -> Iterator[None]:
    """Stop the process during the block."""
    os.kill(process.pid, signal.SIGSTOP)
    try:
        yield
    finally:
        os.kill(process.pid, signal.SIGCONT)


def opened(rt: Any, replicas: int = 1, **policy: Any) -> Any:
    return rt.channel("cam", max_items=100_000, host="h1", replicas=replicas, ack="replica", **policy)


def in_sync(channel: Any) -> list[bytes]:
    return [one.host_id for one in channel.stats().copies if one.in_sync]


def host_of(cluster: LocalCluster, rt: Any, host_id: bytes) -> ServiceProcess:
    name = next(one.name for one in rt.hosts() if one.host_id == host_id)
    return cluster.hosts[int(name[1:]) - 1]


def owner_of(rt: Any, channel: Any) -> str:
    return str(next(one.host for one in rt.channels() if one.name == channel.name))


def holds_all(channel: Any, last: int) -> None:
    """Check that every acknowledged item is there once, with the same seq."""
    assert [item.seq for item in channel.get(st.OLDEST, st.NEWEST)] == [*range(1, last + 1)]


@pytest.mark.parametrize(("feeds", "replicas"), [("grpc", 1), ("socket", 2)], indirect=["feeds"])
def test_no_acknowledged_or_read_item_is_lost_or_repeated_when_the_owner_is_killed(
    cluster: LocalCluster, replicas: int
) -> None:
    with st.connect(cluster.address, transport="grpc") as rt:
        channel = opened(rt, replicas)
        eventually(lambda: len(in_sync(channel)) == replicas, "the replicas are in sync")
        incarnation = channel.incarnation
        with reading(channel, 2) as readers, produced(channel) as producing:
            wait_for_puts(producing, 100)
            cluster.hosts[0].kill()
            wait_for_puts(producing, 100)
            last = producing.stop()
            all_saw(readers, last)
        assert channel.incarnation == incarnation
        assert owner_of(rt, channel) in ("h2", "h3")
        holds_all(channel, last)
        eventually(lambda: len(in_sync(channel)) == 1, "the owner has found another replica")


def got_all_but_the_lost(seqs: list[int], inherited: int, last: int) -> bool:
    """Whether a reader got the items that the former owner had sent, and then all items of the new owner that it
    lacked.
    """
    # The number of items from the former owner.
    seen = next((at for at, seq in enumerate(seqs) if seq != at + 1), len(seqs))
    if seen == len(seqs):  # the reader had seen no item that was lost
        return seqs == [*range(1, last + 1)]
    return seen >= inherited - 1 and seqs[seen:] == [*range(inherited, last + 1)]


@pytest.mark.parametrize("transport", ["grpc", None])
def test_each_reader_learns_of_the_loss_when_a_lagging_replica_takes_over(
    cluster: LocalCluster, transport: Any
) -> None:
    with st.connect(cluster.address, transport=transport) as rt:
        channel = rt.channel("cam", max_items=100_000, host="h1", replicas=1)
        eventually(lambda: len(in_sync(channel)) == 1, "the replica is in sync")
        incarnation = channel.incarnation
        with (
            reading(channel, 2) as readers,
            awaited_reading(cluster.address, "cam", transport) as awaited,
            produced(channel) as producing,
        ):
            wait_for_puts(producing, 100)
            early = channel.get(st.OLDEST, st.NEWEST)[50]
            eventually(lambda: channel.stats().copies[0].waiting == 0 or producing.last > 400, "the replica is near")
            cluster.hosts[0].kill()
            wait_for_puts(producing, 100)
            last = producing.stop()
            inherited = channel.stats().inherited_next_seq
            assert inherited is not None
            assert channel.incarnation != incarnation
            for one in (*readers, awaited):
                eventually(lambda one=one: one.last == last, "the reader has the last item")  # type: ignore[misc]
                assert one.error is None
                assert got_all_but_the_lost(one.seqs, inherited, last)
                assert one.subscription.losses == 1
        later = channel.get(st.OLDEST, st.NEWEST, after=early)  # a position of the former incarnation
        assert [item.seq for item in later] == [*range(early.seq + 1, last + 1)]
        assert later.reason == "LOST"
        eventually(lambda: len(in_sync(channel)) == 1, "the owner has found another replica")


def test_a_recording_continues_after_a_loss_and_names_it(cluster: LocalCluster, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with st.connect(cluster.address) as rt:
        channel = rt.channel("cam", max_items=100_000, host="h1", replicas=1)
        eventually(lambda: len(in_sync(channel)) == 1, "the replica is in sync")
        with rt.record(channel, path) as recorder, produced(channel) as producing:
            wait_for_puts(producing, 100)
            cluster.hosts[0].kill()
            wait_for_puts(producing, 100)
            producing.stop()
            last = channel.put(b"the last").seq
            inherited = channel.stats().inherited_next_seq
            wait_until(lambda: recorder.recorded >= last, "all items are recorded")
    assert inherited is not None
    assert recorder.summary is not None
    lost, anew = sorted(recorder.summary.channels, key=lambda one: one.start or 0)
    assert [(gap.reason, gap.items) for gap in lost.gaps] == [("LOST", None)]
    assert lost.recorded >= inherited - 1
    assert (anew.recorded, anew.complete, anew.gaps) == (last - inherited + 1, True, ())
    assert not verify(path).summary.complete


@pytest.mark.parametrize("feeds", ["tcp"], indirect=True)
def test_a_frozen_owner_is_replaced_by_one_owner_and_nothing_is_lost(cluster: LocalCluster) -> None:
    with st.connect(cluster.address, transport="grpc") as rt:
        channel = opened(rt)
        eventually(lambda: len(in_sync(channel)) == 1, "the replica is in sync")
        incarnation = channel.incarnation
        with reading(channel, 2) as readers, produced(channel) as producing:
            wait_for_puts(producing, 100)
            with frozen(cluster.hosts[0]):
                wait_for_puts(producing, 100)
            wait_for_puts(producing, 100)
            last = producing.stop()
            all_saw(readers, last)
        assert (channel.incarnation, owner_of(rt, channel) == "h1") == (incarnation, False)
        holds_all(channel, last)
        eventually(lambda: len(in_sync(channel)) == 1, "there is a replica again")


@pytest.mark.parametrize(("feeds", "how"), [("tcp", "killed"), ("socket", "frozen")], indirect=["feeds"])
def test_puts_continue_with_another_replica_when_one_is_lost(cluster: LocalCluster, how: str) -> None:
    with st.connect(cluster.address, transport="grpc") as rt:
        channel = opened(rt)
        eventually(lambda: len(in_sync(channel)) == 1, "the replica is in sync")
        (lost,) = in_sync(channel)
        process = host_of(cluster, rt, lost)
        with reading(channel, 2) as readers, produced(channel) as producing:
            wait_for_puts(producing, 100)
            if how == "killed":
                process.kill()
                wait_for_puts(producing, 100)
                eventually(lambda: in_sync(channel) not in ([], [lost]), "another host has the replica")
            else:
                with frozen(process):
                    eventually(lambda: lost not in in_sync(channel), "the directory lists the replica as out of sync")
                wait_for_puts(producing, 100)
            last = producing.stop()
            all_saw(readers, last)
        assert owner_of(rt, channel) == "h1"
        holds_all(channel, last)


def test_a_channel_gets_replicas_and_loses_them_again_while_it_is_used(cluster: LocalCluster) -> None:
    with st.connect(cluster.address, transport="grpc") as rt:
        channel = rt.channel("cam", max_items=100_000, host="h1")
        with reading(channel, 2) as readers, produced(channel) as producing:
            wait_for_puts(producing, 50)
            channel.configure(replicas=2, ack="replica", min_replicas=2)
            eventually(lambda: len(in_sync(channel)) == 2, "the replicas are in sync")
            wait_for_puts(producing, 50)
            assert channel.put(b"an item").copies == 3
            channel.configure(replicas=0, ack="host")
            wait_for_puts(producing, 50)
            eventually(lambda: channel.stats().copies == [], "the replicas are gone")
            producing.stop()
            last = channel.put(b"the last").seq
            all_saw(readers, last)
        holds_all(channel, last)
