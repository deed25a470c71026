"""Moves of recorded channels between real hosts with one object store: each read answers as before the move."""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator
from typing import Any

import pytest

import stampede_rt as st
from stampede_rt_local.cluster import LocalCluster
from tests.support.cluster import running_cluster
from tests.support.waiting import wait_until

MS = 10**6
HELD, ITEMS = 8, 60
numbers = itertools.count()


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LocalCluster]:
    """Two hosts with one object store. They close no file because of its age."""
    store, folder = tmp_path_factory.mktemp("store"), tmp_path_factory.mktemp("folder")
    with running_cluster(hosts=2, supernodes=1, archive=f"file://{store}", archive_folder=folder) as running:
        yield running


@pytest.fixture
def rt(cluster: LocalCluster) -> Iterator[Any]:
    with st.connect(cluster.address, transport="grpc") as made:
        yield made


class Filled:
    """A channel at h1 with ITEMS items, of which memory holds HELD. `known` has an instant after each of them."""

    def __init__(self, rt: Any, **policy: Any) -> None:
        policy = {"max_items": HELD} | policy
        self.channel = rt.channel(f"rig/{next(numbers)}", host="h1", archive="7d", **policy)
        self.began, self.count = time.time_ns() - 10**9, 0
        self.known: list[tuple[int, int]] = []  # an instant of the host, and the number of items that it had then
        self.put(ITEMS)

    def put(self, count: int) -> None:
        for _ in range(count):
            self.channel.put(b"%d" % self.count, time=self.began + self.count * MS)
            self.count += 1
            self.known.append((self.channel.stats().host_time, self.count))

    def archived(self) -> None:
        """Wait until memory holds only HELD items, because the archive has the others."""
        wait_until(lambda: self.channel.stats().held == HELD, "the archive has the earlier items")

    def check(self) -> None:
        """Check each kind of read: it has all items, and no reason."""
        whole = [*range(self.count)]
        found = self.channel.get(self.began, self.began + self.count * MS)
        assert (payloads(found), found.reason) == (whole, None)
        oldest = self.channel.oldest()
        assert oldest is not None
        assert oldest.payload == b"0"
        assert payloads(self.channel.at(self.began + 7 * MS + 5)) == [7]
        page = self.channel.get(st.OLDEST, self.began + self.count * MS, limit=5)
        assert (payloads(page), page.truncated) == (whole[:5], False)
        for instant, count in self.known:
            past = self.channel.get(st.OLDEST, self.began + self.count * MS, as_of=instant)
            assert (payloads(past), past.reason) == (whole[:count], None), (instant, count)


def payloads(items: Any) -> list[int]:
    return [int(item.payload) for item in items]


@pytest.mark.parametrize("max_items", [HELD, 10 * ITEMS])
def test_reads_after_a_move_know_when_each_item_was_accepted(rt: Any, max_items: int) -> None:
    """Also the items that only memory had at the move, and the items whose file comes to the store after it."""
    filled = Filled(rt, max_items=max_items)
    rt.move(filled.channel, "h2")
    filled.check()
    filled.put(5)
    rt.move(filled.channel, "h1")
    filled.check()


def test_the_instant_of_an_advance_moves_along(rt: Any) -> None:
    filled = Filled(rt)
    before = filled.channel.stats().host_time
    filled.channel.advance(filled.began + 10**9)
    after = filled.channel.stats().host_time
    rt.move(filled.channel, "h2")
    advances = [filled.channel.get(st.OLDEST, st.NEWEST, as_of=one).past.advance for one in (before, after)]
    assert advances == [None, filled.began + 10**9]


def test_subscriptions_after_a_move_wait_for_the_last_file_of_the_former_owner(rt: Any) -> None:
    filled = Filled(rt)
    filled.archived()
    first = filled.channel.oldest()
    rt.move(filled.channel, "h2")
    with filled.channel.subscribe(start=st.OLDEST) as begun, filled.channel.subscribe(after=first) as resumed:
        assert [int(next(begun).payload) for _ in range(ITEMS)] == [*range(ITEMS)]
        assert [int(next(resumed).payload) for _ in range(ITEMS - 1)] == [*range(1, ITEMS)]
        assert (begun.dropped, resumed.dropped) == (0, 0)


def test_a_subscription_through_a_group_reports_no_items_that_it_gets(rt: Any) -> None:
    filled = Filled(rt)
    filled.archived()
    group = rt.group(f"rig/{next(numbers)}", [filled.channel])
    rt.move(filled.channel, "h2")
    with group[filled.channel].subscribe(start=st.OLDEST) as items:
        filled.put(1)
        assert [int(next(items).payload) for _ in range(ITEMS)] == [*range(ITEMS)]
        assert items.dropped == 0
