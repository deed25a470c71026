"""Hosts that give their channels away: by command, and when they get SIGTERM."""

from __future__ import annotations

import asyncio
import itertools
import json
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

import stampede_rt as st
from stampede_rt import aio
from stampede_rt.cli.commands import run
from stampede_rt.values.balancing import DIFFERENCE_PERMILLE_MIN
from stampede_rt.values.model import HostInfo
from stampede_rt_local.cluster import LocalCluster
from stampede_rt_local.process import ServiceProcess
from tests.integration.proxies.readers import all_saw, eventually, produced, reading, wait_for_puts
from tests.support.cluster import acting_as_operator, cluster_fixture

cluster = cluster_fixture(hosts=2, supernodes=1)
numbers = itertools.count()
READY_S = 40.0


def hosts_of(rt: Any, names: list[str]) -> set[str]:
    return {one.host for one in rt.channels() if one.name in names}


def is_quiet(host: HostInfo) -> bool:
    return host.load is not None and host.load.busy_permille < DIFFERENCE_PERMILLE_MIN


def test_a_drained_host_owns_nothing_and_members_of_a_group_stay_together(cluster: LocalCluster) -> None:
    with st.connect(cluster.address, transport="grpc") as rt:
        names = [f"cam/{next(numbers)}" for _ in range(12)]
        channels = [rt.channel(name, host="h1") for name in names]
        group = rt.group("pair", channels[:2])
        for channel in channels:
            channel.put(b"x")
        assert len(group.newest()) == 2
        with acting_as_operator(cluster), st.connect(cluster.address, transport="grpc") as operator:
            drained = operator.drain("h1")
        assert (drained.host, drained.left) == ("h1", {})
        assert drained.moved >= len(names)
        assert hosts_of(rt, names) == {"h2"}
        assert [channel.newest().payload for channel in channels] == [b"x"] * len(names)


def test_stampede_move_and_stampede_host_drain_move_channels(
    cluster: LocalCluster, capsys: pytest.CaptureFixture[str]
) -> None:
    with st.connect(cluster.address, transport="grpc") as rt:
        channel = rt.channel(f"cam/{next(numbers)}", host="h1")
        channel.put(b"x")
        with acting_as_operator(cluster):
            assert run(["host", "drain", "h1", "-o", "json", "--url", cluster.address]) == 0
        assert json.loads(capsys.readouterr().out)["left"] == {}
        assert run(["move", channel.name, "h1", "-o", "json", "--url", cluster.address]) == 0
        moved = json.loads(capsys.readouterr().out)
        assert (moved["channel"], moved["host"], moved["held"]) == (channel.name, "h1", 1)
        with (
            acting_as_operator(cluster),
            st.connect(cluster.address, transport="grpc") as operator,
            pytest.raises(st.HostNotFound, match="no live host 'h9'"),
        ):
            operator.drain("h9")


def test_a_cluster_without_load_is_balanced(cluster: LocalCluster, capsys: pytest.CaptureFixture[str]) -> None:
    with st.connect(cluster.address, transport="grpc") as rt:
        channel = rt.channel(f"cam/{next(numbers)}", host="h1")
        # At first a host may report the work of its start, or of an earlier test.
        eventually(lambda: all(is_quiet(one) for one in rt.hosts()), "both hosts have reported that they are quiet")
        assert rt.rebalance(apply=True, over="1ms") == []
        for over in ("0s", "-1s", "1000d"):
            with pytest.raises(st.InvalidArgument, match=f"over is {over}; measure for more than 0 s and at most 1 h"):
                rt.rebalance(over=over)
        assert run(["rebalance", "--over", "1ms", "--url", cluster.address]) == 0
        assert "differ by less" in capsys.readouterr().out
        assert hosts_of(rt, [channel.name]) == {"h1"}


@pytest.mark.parametrize("timeout", ["0s", "-1s", "61s"])
def test_a_drain_has_a_time_that_hosts_allow(cluster: LocalCluster, timeout: str) -> None:
    """In an earlier version, "0s" stood for 60 s, and a longer time was cut to 60 s."""
    with (
        st.connect(cluster.address) as rt,
        pytest.raises(st.InvalidArgument, match=f"timeout is {timeout}; a drain takes more than 0 s and at most 60 s"),
    ):
        rt.drain("h1", timeout=timeout)


@contextmanager
def leaving_host(cluster: LocalCluster) -> Iterator[ServiceProcess]:
    words = ["--listen", "localhost:0", "--name", "leaving", "--frontend", cluster.address, "--drain-seconds", "20"]
    words += ["--secret-file", str(cluster.secret_file)]
    leaving = ServiceProcess("host leaving", "stampede_rt_channel_host", words)
    try:
        leaving.start()
        leaving.wait_ready(READY_S)
        yield leaving
    finally:
        leaving.kill()


def test_a_stopping_host_moves_its_channels_away_under_load(cluster: LocalCluster) -> None:
    with leaving_host(cluster) as leaving, st.connect(cluster.address, transport="grpc") as rt:
        channel = rt.channel(f"cam/{next(numbers)}", max_items=100_000, host="leaving")
        first = channel.put(b"first")
        with produced(channel) as producing, reading(channel, 2) as readers:
            leaving.ask_to_stop()
            eventually(lambda: hosts_of(rt, [channel.name]) != {"leaving"}, "the channel has gone")
            wait_for_puts(producing, 50)
            last = producing.stop()
            end = channel.put(b"end")
            all_saw(readers, end.seq)
        assert (end.incarnation, end.seq) == (first.incarnation, last + 1)
        assert hosts_of(rt, [channel.name]) <= {"h1", "h2"}


async def test_channels_that_move_to_a_host_while_it_stops_are_not_lost(cluster: LocalCluster) -> None:
    """In an earlier version, a stopping host gave only the channels away that it owned when its drain began."""
    with leaving_host(cluster) as leaving:
        async with aio.connect(cluster.address, transport="grpc") as rt:
            channels = [await rt.channel(f"cam/{next(numbers)}", max_items=10, host="h1") for _ in range(40)]
            for channel in channels:
                await channel.put(b"kept")
            moves = [asyncio.create_task(rt.move(channel, "leaving")) for channel in channels]
            await asyncio.wait(moves, return_when=asyncio.FIRST_COMPLETED)
            leaving.ask_to_stop()
            await asyncio.gather(*moves, return_exceptions=True)  # the host refuses the moves that begin later
            await asyncio.to_thread(eventually, lambda: leaving.ended, "the host has ended")
            newest = [await channel.newest() for channel in channels]
        assert [item and item.payload for item in newest] == [b"kept"] * len(channels)
