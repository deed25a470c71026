"""Reads of a recorded channel that memory answers alone: they know that the archive has the earlier items."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import pytest

import stampede_rt as st
from stampede_rt._sync import shared_rings
from stampede_rt.transports import futexes
from stampede_rt_local.cluster import LocalCluster
from tests.support.cluster import running_cluster
from tests.support.waiting import wait_until

MS, ITEMS, HELD = 10**6, 20, 8
names = itertools.count()


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LocalCluster]:
    with running_cluster(hosts=2, supernodes=1, archive=tmp_path_factory.mktemp("archive")) as running:
        yield running


@pytest.fixture
def rt(cluster: LocalCluster) -> Iterator[st.Connection]:
    with st.connect(cluster.address) as connection:
        yield connection


@dataclass(frozen=True)
class Filled:
    """A recorded channel with items one millisecond apart. Memory has only the last HELD of them."""

    channel: st.Channel
    began: int

    def numbers(self, items: Any) -> list[int]:
        return [(item.time - self.began) // MS for item in items]


@pytest.fixture
def filled(rt: st.Connection) -> Filled:
    channel = rt.channel(f"memory/{next(names)}", max_items=HELD, archive="1h", host="h1")
    began = st.now() - 10**9
    for number in range(ITEMS):
        channel.put(b"%d" % number, time=began + number * MS)
    channel.advance(began + ITEMS * MS)
    wait_until(lambda: channel.stats().held == HELD)
    return Filled(channel, began)


def test_oldest_is_the_oldest_item_of_the_archive_even_if_the_interval_lies_in_memory(filled: Filled) -> None:
    channel, began = filled.channel, filled.began
    later = channel.get(st.OLDEST + "15ms", st.NOW, match="start")
    assert (filled.numbers(later), later.interval.start) == ([15, 16, 17, 18, 19], began + 15 * MS)
    earlier = channel.get(began + 15 * MS, st.OLDEST + "16ms", match="start")
    assert filled.numbers(earlier) == [15, 16]
    assert filled.numbers(channel.at(st.OLDEST + "17ms")) == [17]
    waited = channel.get(st.OLDEST + "15ms", st.OLDEST + "1s", match="start", complete=True, timeout=0.01)
    assert filled.numbers(waited) == [15, 16, 17, 18, 19]


def test_a_subscription_from_oldest_begins_at_the_oldest_item_of_the_archive(filled: Filled) -> None:
    with filled.channel.subscribe(start=st.OLDEST + "15ms") as items:
        assert filled.numbers(itertools.islice(items, 5)) == [15, 16, 17, 18, 19]


def test_a_group_and_a_copy_read_from_the_oldest_item_of_the_archive(rt: st.Connection, filled: Filled) -> None:
    place, options = (st.OLDEST + "15ms", st.NEWEST), {"match": "start"}
    group = rt.group(f"group/{filled.channel.name}", [filled.channel])
    assert filled.numbers(group[filled.channel].get(*place, **options)) == [15, 16, 17, 18, 19]
    rt.proxy(filled.channel, "h2")
    reader = rt.channel(filled.channel.name)
    assert filled.numbers(reader.get(*place, **options, max_staleness="1h")) == [15, 16, 17, 18, 19]
    assert filled.numbers(group[reader].get(*place, **options, max_staleness="1h")) == [15, 16, 17, 18, 19]


@pytest.mark.skipif(not futexes.is_supported(), reason="shared memory needs Linux on x86-64")
def test_shared_memory_calls_no_answer_truncated_if_the_archive_has_the_earlier_items(
    cluster: LocalCluster, filled: Filled
) -> None:
    with st.connect(cluster.address, transport="shared") as rt:
        reader = rt.channel(filled.channel.name)
        for _ in range(shared_rings.READS_BEFORE):
            assert reader.newest() is not None
        wait_until(lambda: reader.stats().transport == "shared")
        latest = reader.get(filled.began, st.NOW, newest_first=True, limit=3)
        assert (filled.numbers(latest), latest.truncated, latest.more) == ([19, 18, 17], False, True)
        in_memory = reader.get(filled.began, st.NOW, newest_first=True, limit=3, within="memory")
        assert (filled.numbers(in_memory), in_memory.truncated) == ([19, 18, 17], True)
