"""Moves of channels between real processes, while they are in use (paper, sections 4.1 and 4.2)."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Iterator
from typing import Any

import pytest

import stampede_rt as st
from stampede_rt_local.cluster import LocalCluster
from tests.integration.proxies.readers import eventually, produced, reading
from tests.support.cluster import cluster_fixture

cluster = cluster_fixture(hosts=3, supernodes=1)
numbers = itertools.count()
MOVES = 10
BEFORE = 10**18
FAR = 2**62


@pytest.fixture
def rt(cluster: LocalCluster) -> Iterator[Any]:
    with st.connect(cluster.address, transport="grpc") as made:
        yield made


@pytest.fixture
def channel(rt: Any) -> Any:
    return rt.channel(f"cam/{next(numbers)}", max_items=100_000, host="h1")


def owner(rt: Any, channel: Any) -> str:
    return next(one.host for one in rt.channels(channel.name))


def test_a_moved_channel_keeps_its_items_and_its_incarnation(rt: Any, channel: Any) -> None:
    before = [channel.put(b"%d" % number) for number in range(300)]
    moved = rt.move(channel, "h2")
    assert (moved.channel, moved.host, moved.held) == (channel.name, "h2", 300)
    assert moved.blackout_nanos > 0
    assert owner(rt, channel) == "h2"
    after = channel.put(b"another")
    assert (after.seq, after.incarnation) == (301, before[0].incarnation)
    found = channel.get(st.OLDEST, st.NEWEST)
    assert [one.payload for one in found] == [*(one.payload for one in before), b"another"]
    assert channel.stats().accepted == 301


def test_a_channel_does_not_move_to_its_own_host(rt: Any, channel: Any) -> None:
    channel.put(b"x")
    assert rt.move(channel, "h1").blackout_nanos == 0


def test_an_unused_channel_can_move(rt: Any) -> None:
    channel = rt.channel(f"cam/{next(numbers)}", host="h1")
    assert rt.move(channel.name, "h3").held == 0
    assert channel.put(b"first").seq == 1


def test_the_error_says_that_the_destination_of_a_move_does_not_exist(rt: Any, channel: Any) -> None:
    with pytest.raises(st.HostNotFound, match="no live host 'h9'"):
        rt.move(channel, "h9")


def test_a_waiting_get_keeps_its_resolved_interval_after_a_move(rt: Any, channel: Any) -> None:
    before = channel.put(b"before", time=BEFORE)
    found: list[Any] = []
    end = BEFORE + 10**9
    waiting = threading.Thread(target=lambda: found.append(channel.get(st.NEWEST, end, after=before, timeout=30)))
    waiting.start()
    eventually(lambda: channel.stats().waiting_gets == 1, "the get waits")
    rt.move(channel, "h2")
    eventually(lambda: channel.stats().waiting_gets == 1, "the get waits at the new host")
    channel.put(b"after", time=BEFORE + 1)
    waiting.join(20)
    assert [item.payload for items in found for item in items] == [b"after"]
    assert found[0].interval.start == BEFORE


def test_a_consumer_keeps_its_position_after_a_move(rt: Any, channel: Any) -> None:
    counted = rt.channel(f"counted/{next(numbers)}", consumers=1, host="h1")
    items = [counted.put(b"x") for _ in range(5)]
    counted.consume([items[0], items[2]])
    rt.move(counted, "h2")
    assert counted.stats().collected["consumption"] == 1
    counted.consume(items[1])
    assert counted.stats().collected["consumption"] == 3


def test_many_moves_in_a_row_neither_lose_nor_repeat_items(rt: Any, channel: Any) -> None:
    """Checks a producer with single puts and one with a stream, subscriptions, a callback, blocked gets, and a group's
    cuts.
    """
    other = rt.channel(f"mic/{next(numbers)}", max_items=100_000, host="h1")
    group = rt.group(f"both/{next(numbers)}", [channel, other])
    cuts, got = CutCollector(group.subscribe()), ItemFollower(channel)
    called: list[int] = []
    listener = channel.on_item(lambda item: called.append(item.seq), st.OLDEST)
    with produced(channel) as producing, produced(other) as beside, reading(channel, 3) as readers:
        stream = channel.producer()
        for move in range(MOVES):
            stream.put(b"streamed")
            rt.move(channel, ("h2", "h3", "h1")[move % 3])
        stream.flush()
        producing.stop()
        beside.stop()
        end = channel.put(b"end").seq
        for reader in readers:
            eventually(lambda reader=reader: reader.last == end, "each reader has everything")  # type: ignore[misc]
            assert reader.seqs == [*range(1, end + 1)]
        eventually(lambda: got.seqs and got.seqs[-1] == end, "the blocked gets have everything")
        eventually(lambda: called and called[-1] == end, "the callback has everything")
    got.stop()
    stream.close()
    cuts.check()
    assert (stream.accepted, stream.rejections) == (MOVES, 0)
    listener.cancel()
    assert got.seqs == [*range(got.seqs[0], end + 1)]
    assert called == [*range(1, end + 1)]
    assert channel.stats().accepted == end


class ItemFollower:
    """Gets each item after the last one, with gets that wait."""

    def __init__(self, channel: Any) -> None:
        self.seqs: list[int] = []
        self._channel, self._stopped = channel, threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        last = None
        while not self._stopped.is_set():
            found = self._channel.get(st.OLDEST, FAR, after=last, timeout=1)
            self.seqs += [item.seq for item in found]
            last = found[-1] if found else last

    def stop(self) -> None:
        self._stopped.set()
        self._thread.join(20)


class CutCollector:
    """A stream of cuts of a group."""

    def __init__(self, subscription: Any) -> None:
        self.cuts: list[int] = []
        self.error: st.StampedeError | None = None
        self._subscription = subscription
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        try:
            for event in self._subscription:
                self.cuts.append(event.time)
        except st.StampedeError as error:
            self.error = error

    def check(self) -> None:
        """Check that the stream goes on, and that its cuts only rise. Then close the stream."""
        eventually(lambda: self.cuts, "the stream of cuts goes on")
        self._subscription.close()
        self._thread.join(20)
        assert self.error is None
        assert self.cuts == sorted(set(self.cuts))
