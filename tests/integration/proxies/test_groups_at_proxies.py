"""Reads through a group at proxies of its members: they show no item at or past the cut (paper, sections 3.3, 4.1)."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Any

import pytest

import stampede_rt as st
from stampede_rt_local.cluster import LocalCluster
from tests.integration.proxies.readers import eventually, produced, reading, wait_for_puts
from tests.support.cluster import cluster_fixture

cluster = cluster_fixture(hosts=3, supernodes=1)
numbers = itertools.count()


@pytest.fixture
def rt(cluster: LocalCluster) -> Iterator[Any]:
    with st.connect(cluster.address, transport="grpc") as made:
        yield made


class Pair:
    """Two channels of one group at h1, and a proxy of the first at h2."""

    def __init__(self, rt: Any) -> None:
        number = next(numbers)
        self.first, self.second = (rt.channel(f"{number}/{name}", max_items=100_000, host="h1") for name in "ab")
        self.group = rt.group(f"g/{number}", [self.first, self.second])
        rt.proxy(self.first, "h2")

    def at_proxy(self) -> st.Items | None:
        """The answer of the proxy through the group; None if it has not answered."""
        answer = self.group[self.first].get(st.OLDEST, st.NEWEST, max_staleness="10s")
        return answer if answer.staleness_nanos is not None else None


def test_a_proxy_shows_only_the_items_before_the_cut(rt: Any) -> None:
    pair = Pair(rt)
    base = st.now() - 10**9
    for at in (10, 20, 30, 40):
        pair.first.put(b"%d" % at, time=base + at)
    pair.second.put(b"b", time=base + 25)
    pair.group[pair.first].newest()  # so that the owner knows the group

    def shown() -> list[bytes]:
        answer = pair.at_proxy()
        return [] if answer is None else [item.payload for item in answer]

    eventually(lambda: shown() == [b"10", b"20"], "the items before the time of the other channel")
    pair.second.put(b"b", time=base + 35)
    eventually(lambda: shown() == [b"10", b"20", b"30"], "the cut has advanced")


def test_a_read_at_a_later_cut_than_the_proxy_knows_goes_to_the_owner(rt: Any) -> None:
    pair = Pair(rt)
    base = st.now() - 10**9
    for at in range(1, 30):
        pair.first.put(b"%d" % at, time=base + at)
        pair.second.put(b"b", time=base + at)
        seen = pair.group[pair.second].newest()  # the next read through the group must not be at an earlier cut
        answer = pair.group[pair.first].get(st.OLDEST, st.NEWEST, max_staleness="10s")
        assert answer.cut is not None
        assert seen is None or answer.cut > seen.time


def test_subscriptions_through_a_group_move_to_proxies_without_gaps_or_duplicates(rt: Any) -> None:
    pair = Pair(rt)
    with produced(pair.first) as producing, produced(pair.second), reading(pair.group[pair.first], 6) as readers:
        wait_for_puts(producing, 50)
        rt.proxy(pair.first, "h3")
        eventually(lambda: all(one.subscriptions for one in rt.proxies(pair.first)), "readers have moved there")
        wait_for_puts(producing, 100)
        rt.remove_proxy(pair.first, "h2")
        eventually(lambda: len(rt.proxies(pair.first)) == 1, "one proxy is left")
        wait_for_puts(producing, 100)
        goal = producing.last - 20
        eventually(lambda: all(one.last >= goal for one in readers), "all readers have read further")
    for reader in readers:
        assert reader.error is None
        assert reader.seqs == [*range(reader.seqs[0], reader.seqs[-1] + 1)]
