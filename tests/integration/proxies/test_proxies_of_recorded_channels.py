"""Proxies of recorded channels. A proxy has no archive, so readers of archived items use the owner."""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Iterator
from typing import Any

import pytest

import stampede_rt as st
from stampede_rt_local.cluster import LocalCluster
from tests.integration.proxies.readers import BackgroundReader, eventually
from tests.support.cluster import running_cluster

ITEMS, HELD = 60, 10
numbers = itertools.count()


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LocalCluster]:
    with running_cluster(hosts=2, supernodes=1, archive=tmp_path_factory.mktemp("archive")) as running:
        yield running


@pytest.fixture
def rt(cluster: LocalCluster) -> Iterator[Any]:
    with st.connect(cluster.address, transport="grpc") as made:
        yield made


class RecordedSetup:
    """A recorded channel with a proxy, and a group of this channel. Memory holds only the last items."""

    def __init__(self, rt: Any) -> None:
        self._rt, self.name = rt, f"cam/{next(numbers)}"
        channel = rt.channel(self.name, max_items=HELD, archive="1h", host="h1")
        self.items = [channel.put(b"%d" % number) for number in range(ITEMS)]
        channel.advance(self.items[-1].time + 1)  # so that the group shows the last item, too
        eventually(lambda: channel.stats().held == HELD, "the archive has the other items")
        self.proxy = rt.proxy(channel, "h2")
        self.group = rt.group(f"group/{self.name}", [channel])

    def channel(self) -> Any:
        """Another handle: another reader."""
        return self._rt.channel(self.name)

    def put(self) -> st.Item:
        """Another item, which the group shows."""
        item = self.channel().put(b"another")
        self.channel().advance(item.time + 1)
        return item


@pytest.fixture
def recorded(rt: Any) -> RecordedSetup:
    return RecordedSetup(rt)


def at_proxies(rt: Any, recorded: RecordedSetup) -> int:
    return sum(one.subscriptions or 0 for one in rt.proxies(recorded.name))


@pytest.mark.parametrize("through_group", [False, True])
@pytest.mark.parametrize("begins", ["at the oldest item", "after an archived item"])
def test_a_subscription_gets_the_archived_items_although_there_is_a_proxy(
    rt: Any, recorded: RecordedSetup, begins: str, through_group: bool
) -> None:
    """In an earlier version the second reader got only the items in the memory of the proxy."""
    place = {"start": st.OLDEST} if begins == "at the oldest item" else {"after": recorded.items[4]}
    expected = [item.seq for item in recorded.items[0 if "start" in place else 5 :]]
    readers = []
    with contextlib.ExitStack() as opened:
        for _ in range(2):  # the owner wants to send the second one to the proxy
            source = recorded.group[recorded.channel()] if through_group else recorded.channel()
            readers.append(BackgroundReader(source.subscribe(**place)))
            opened.callback(readers[-1].close)
            eventually(lambda: len(readers[-1].seqs) == len(expected), "the reader has all items")
        live = BackgroundReader(recorded.channel().subscribe())
        opened.callback(live.close)
        eventually(lambda: at_proxies(rt, recorded) >= 1, "the reader that needs no archive is at the proxy")
        expected.append(recorded.put().seq)
        for reader in readers:
            eventually(lambda reader=reader: len(reader.seqs) == len(expected), "the reader has the new item")
            assert reader.seqs == expected
            assert (reader.subscription.dropped, reader.subscription.losses) == (0, 0)
        eventually(lambda: live.seqs == expected[-1:], "the proxy sends the new item")


def test_a_get_that_needs_the_archive_goes_to_the_owner(recorded: RecordedSetup) -> None:
    channel, group = recorded.channel(), recorded.group
    archived = recorded.items[3]
    for source in (channel, group[channel]):
        whole = source.get(st.OLDEST, st.NEWEST, max_staleness="10s")
        assert (len(whole), whole.staleness_nanos, whole.truncated) == (ITEMS, None, False)
        assert source.get(archived.time, recorded.items[8].time, max_staleness="10s")[0].seq == archived.seq
    past = channel.get(st.OLDEST, st.NEWEST, as_of=st.now() - 1, max_staleness="10s")
    assert len(past) == ITEMS


@pytest.mark.parametrize("through_group", [False, True])
def test_a_reader_that_uses_the_proxy_gets_archived_items_from_the_owner(
    recorded: RecordedSetup, through_group: bool
) -> None:
    """In an earlier version a get through the group said COLLECTED, and had only the items in the memory of the proxy.

    If the proxy refuses a get of archived items, this connection sends it no gets for a while. So the proxy must be
    able to answer the first get.
    """
    source = recorded.group[recorded.channel()] if through_group else recorded.channel()

    def at_proxy() -> bool:
        answer = source.get(recorded.items[-5].time, recorded.items[-1].time, max_staleness="10s")
        return len(answer) == 5 and answer.staleness_nanos is not None

    eventually(at_proxy, "the proxy answers")
    across = source.get(recorded.items[3].time, recorded.items[-3].time, max_staleness="10s")
    assert [item.seq for item in across] == [item.seq for item in recorded.items[3:-2]]
    assert (across.reason, across.truncated, across.staleness_nanos) == (None, False, None)


def test_a_get_that_memory_can_answer_uses_the_proxy(recorded: RecordedSetup) -> None:
    channel = recorded.channel()

    def read() -> bool:
        answer = channel.get(recorded.items[-5].time, st.NEWEST, max_staleness="10s")
        assert len(answer) == 5
        return answer.staleness_nanos is not None

    eventually(read, "the proxy answers")
    held = channel.get(st.OLDEST, st.NEWEST, max_staleness="10s", within="memory")
    assert (len(held), held.staleness_nanos is not None) == (HELD, True)
