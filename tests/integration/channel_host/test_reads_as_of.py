"""Reads of recorded channels as of an earlier instant, at a real host."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterator

import pytest

import stampede_rt as st
from stampede_rt import aio
from stampede_rt_local.cluster import LocalCluster
from tests.support.cluster import recorded_cluster_fixture

MS, SECOND = 10**6, 10**9

cluster = recorded_cluster_fixture()


@pytest.fixture
def rt(cluster: LocalCluster) -> Iterator[st.Connection]:
    with st.connect(cluster.address, secret=cluster.secret.text) as connection:
        yield connection


def host_now(channel: st.Channel) -> int:
    return channel.stats().host_time


def payloads(items: st.Items) -> bytes:
    return b" ".join(item.payload for item in items)


def answers(channel: st.Channel, began: int, as_of: int | None) -> list[object]:
    """The answers to reads of every kind, except the kinds whose answers depend on the moment of the call."""
    interval = channel.get(began, began + SECOND, as_of=as_of)
    newest = channel.newest(as_of=as_of)
    found = [
        [(item.payload, item.time, item.end, item.seq) for item in interval],
        (interval.complete, interval.truncated, interval.more, interval.reason),
        newest and (newest.payload, newest.seq),
        channel.oldest(as_of=as_of),
        channel.before(began + 5 * MS, as_of=as_of),
        payloads(channel.at(began + 5 * MS, as_of=as_of)),
        payloads(channel.get(st.OLDEST, st.NEWEST, limit=2, newest_first=True, as_of=as_of)),
        payloads(channel.get(st.NEWEST - "3ms", st.NEWEST, match="start", as_of=as_of)),
    ]
    page = channel.get(st.OLDEST, st.NEWEST, limit=2, as_of=as_of)
    return [*found, payloads(page), page.more, payloads(channel.get(st.OLDEST, st.NEWEST, after=page[-1], as_of=as_of))]


def test_a_read_as_of_an_instant_gets_the_answer_that_the_host_gave_at_that_instant(rt: st.Connection) -> None:
    channel, began = rt.channel("past/live", max_age="60s", archive="7d"), time.time_ns() - SECOND
    live: list[tuple[int, list[object]]] = []
    for number in range(10):
        channel.put(b"%d" % number, time=began + number * MS)
        if number % 3 == 2:
            channel.put(b"late", time=began + (number - 2) * MS + 5)
        live.append((host_now(channel), answers(channel, began, None)))
    for as_of, expected in live:
        assert answers(channel, began, as_of) == expected


def test_items_that_memory_has_dropped_are_known_as_of_an_instant(rt: st.Connection) -> None:
    channel, began = rt.channel("past/dropped", max_items=3, archive="7d"), time.time_ns() - SECOND
    instants = []
    for number in range(100):
        channel.put(b"%d" % number, time=began + number * MS)
        instants.append(host_now(channel))
    assert len(channel.get(st.OLDEST, st.NEWEST, as_of=instants[40])) == 41
    assert channel.newest(as_of=instants[6]).payload == b"6"
    now = channel.get(st.NOW, st.NOW, as_of=instants[50])
    assert now.interval is not None
    assert (now.interval.start, payloads(now)) == (instants[50], b"50")
    assert now.past is not None
    assert now.past.next_change is not None
    assert instants[50] < now.past.next_change <= instants[51]
    assert now.past.next_items == (52, began + 51 * MS, began + 51 * MS)
    assert channel.get(st.NOW, st.NOW, as_of=instants[99]).past == (None, None, None)


def test_a_read_as_of_an_instant_before_the_first_item_is_empty(rt: st.Connection) -> None:
    channel = rt.channel("past/first", max_age="60s", archive="7d")
    before = host_now(channel)
    channel.put(b"first")
    empty = channel.get(st.OLDEST, st.NEWEST, as_of=before)
    assert (len(empty), empty.reason, empty.interval) == (0, "NOT_YET", None)
    assert channel.newest(as_of=before) is None
    assert len(channel.get(before, before + SECOND, as_of=before)) == 0


def test_a_read_as_of_an_instant_is_refused_if_the_host_cannot_answer_it(rt: st.Connection) -> None:
    plain, recorded = rt.channel("past/plain"), rt.channel("past/refused", max_age="60s", archive="7d")
    recorded.put(b"x")
    with pytest.raises(st.InvalidArgument, match="not recorded"):
        plain.get(st.OLDEST, st.NOW, as_of=st.now() - SECOND)
    with pytest.raises(st.InvalidArgument, match="ahead of the host's clock"):
        recorded.newest(as_of=st.now() + 3600 * SECOND)
    with pytest.raises(st.InvalidArgument, match="cannot wait"):
        recorded.newest(as_of=st.now() - SECOND, timeout=1)


def test_the_asyncio_client_reads_as_of_an_instant(cluster: LocalCluster) -> None:
    async def read() -> tuple[bytes, bytes]:
        async with aio.connect(cluster.address, secret=cluster.secret.text) as rt:
            channel = await rt.channel("past/aio", max_age="60s", archive="7d")
            await channel.put(b"one")
            then = (await channel.stats()).host_time
            await channel.put(b"two")
            known = await channel.newest(as_of=then)
            latest = await channel.newest()
            assert known is not None
            assert latest is not None
            return known.payload, latest.payload

    assert asyncio.run(read()) == (b"one", b"two")


def test_an_advance_completes_an_interval_from_its_acceptance_on(rt: st.Connection) -> None:
    channel, began = rt.channel("past/advance", max_age="60s", archive="7d"), time.time_ns() - SECOND
    channel.put(b"one", time=began)
    interval = (began, began + 5 * MS)
    before = host_now(channel)
    assert channel.advance(began + 10 * MS) == began + 10 * MS
    after = host_now(channel)
    first, second = channel.get(*interval, as_of=before), channel.get(*interval, as_of=after)
    assert (first.complete, second.complete) == (False, True)
    assert first.past is not None
    assert second.past is not None
    assert (first.past.advance, second.past.advance) == (None, began + 10 * MS)
    assert (first.past.next_items, second.past.next_change) == (None, None)
    assert channel.get(*interval, as_of=first.past.next_change).complete
    channel.put(b"two", time=began + 20 * MS)
    assert channel.get(*interval, as_of=host_now(channel)).complete


def test_a_channel_that_is_recorded_later_says_that_its_archive_lacks_the_earlier_items(rt: st.Connection) -> None:
    """In an earlier version, such a read said NOT_YET until the archive had its first item."""
    channel, began = rt.channel("past/recorded-later", max_items=3), time.time_ns() - SECOND
    channel.put(b"early", time=began)
    channel.configure(archive="7d")
    early = channel.get(began, began, as_of=host_now(channel))
    assert (payloads(early), early.reason, early.truncated) == (b"", "COLLECTED", True)
    channel.put(b"late", time=began + MS)
    late = channel.get(began, st.NOW, as_of=host_now(channel))
    assert (payloads(late), late.reason) == (b"late", "COLLECTED")
