"""Moves of recorded channels between real hosts: the archive of the new host begins with the oldest item in memory."""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator
from typing import Any

import pytest

import stampede_rt as st
from stampede_rt_local.cluster import LocalCluster
from tests.support.cluster import drained, running_cluster
from tests.support.waiting import wait_until

MS = 10**6
HELD = 20
numbers = itertools.count()


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LocalCluster]:
    """Two hosts with an archive, and a third host without one."""
    with running_cluster(hosts=3, supernodes=1, archive=tmp_path_factory.mktemp("archive")) as running:
        plain = running.hosts[2]
        plain.stop()
        at = plain.arguments.index("--archive")
        del plain.arguments[at : at + 2]
        plain.restart()
        yield running


@pytest.fixture
def rt(cluster: LocalCluster) -> Iterator[Any]:
    with st.connect(cluster.address, transport="grpc") as made:
        yield made


def filled(rt: Any, **policy: Any) -> tuple[Any, int]:
    """A channel at h1 with 100 items, and the time of the first item. The archive has all items, and memory the last
    ones.
    """
    channel = rt.channel(f"rig/{next(numbers)}", host="h1", max_items=HELD, archive="7d", **policy)
    began = time.time_ns() - 10**9
    put(channel, began, 0, 99)
    channel.put(b"99", time=began + 99 * MS, ack="disk")
    wait_until(lambda: channel.stats().held == HELD, "the archive has the earlier items")
    return channel, began


def put(channel: Any, began: int, first: int, end: int) -> None:
    for number in range(first, end):
        channel.put(b"%d" % number, time=began + number * MS)


def read(channel: Any, began: int, first: int, end: int) -> Any:
    return channel.get(began + first * MS, began + (end - 1) * MS)


def payloads(items: Any) -> list[int]:
    return [int(item.payload) for item in items]


def test_a_recorded_channel_moves_with_its_memory_and_is_recorded_at_the_new_host(rt: Any) -> None:
    channel, began = filled(rt)
    incarnation = channel.incarnation
    with channel.subscribe(after=channel.newest()) as items:
        rt.move(channel, "h2")
        put(channel, began, 100, 200)
        assert [int(next(items).payload) for _ in range(100)] == [*range(100, 200)]
    assert channel.incarnation == incarnation
    wait_until(lambda: channel.stats().held == HELD, "the new host has archived the items that moved, too")
    assert payloads(read(channel, began, 100 - HELD, 200)) == [*range(100 - HELD, 200)]
    earlier = read(channel, began, 0, 10)
    assert (len(earlier), earlier.reason) == (0, "COLLECTED")
    rt.move(channel, "h1")
    put(channel, began, 200, 210)
    assert payloads(read(channel, began, 0, 100)) == [*range(100)], "the first host has its part of the archive"
    assert payloads(read(channel, began, 190, 210)) == [*range(190, 210)]
    whole = channel.get(began, st.NEWEST)
    assert whole.reason == "LOST"
    assert set(payloads(whole)) == {*range(100), *range(200 - HELD, 210)}


def test_puts_that_waited_for_the_disk_are_on_the_disk_of_the_new_host(rt: Any, cluster: LocalCluster) -> None:
    channel, began = filled(rt, ack="disk")
    rt.move(channel, "h2")
    cluster.hosts[1].kill()
    cluster.hosts[1].restart()
    wait_until(
        lambda: payloads(read(channel, began, 100 - HELD, 100)) == [*range(100 - HELD, 100)],
        "the restarted host serves the archived items again",
    )


def test_the_instants_of_acceptance_move_along_also_after_a_crash(rt: Any, cluster: LocalCluster) -> None:
    channel, began = filled(rt, ack="disk")
    known = []
    for count in range(101, 105):
        channel.put(b"%d" % (count - 1), time=began + (count - 1) * MS)
        known.append((channel.stats().host_time, count))
    cluster.hosts[0].kill()
    cluster.hosts[0].restart()
    wait_until(lambda: payloads(read(channel, began, 0, 104)) == [*range(104)], "the restarted host serves")
    rt.move(channel, "h2")
    for instant, count in known:
        assert payloads(channel.get(began, began + 104 * MS, as_of=instant)) == [*range(104 - HELD, count)]


def test_a_move_back_repeats_no_item_that_was_archived_before_the_first_move(rt: Any) -> None:
    """The feed joins items. The archive of the first host may end within such a run."""
    channel, began = rt.channel(f"rig/{next(numbers)}", host="h1", max_items=1000, archive="7d"), time.time_ns() - 10**9
    put(channel, began, 0, 40)
    wait_until(lambda: channel.stats().archive.items, "the archive has items")
    put(channel, began, 40, 60)
    rt.move(channel, "h2")
    rt.move(channel, "h1")
    put(channel, began, 60, 61)
    assert payloads(channel.get(began - 1, began + 61 * MS)) == [*range(61)]
    channel.configure(max_items=1)
    wait_until(lambda: channel.stats().held == 1, "the archive has all items")
    assert payloads(channel.get(began - 1, began + 61 * MS)) == [*range(61)]


def test_no_move_or_drain_gives_a_recorded_channel_to_a_host_without_an_archive(rt: Any, cluster: LocalCluster) -> None:
    channel, _ = filled(rt)
    with pytest.raises(st.InvalidArgument, match="this host has no archive; move it to a host that has one"):
        rt.move(channel, "h3")
    assert drained(cluster, "h1").left == {}
    assert next(one.host for one in rt.channels(channel.name)) == "h2"
