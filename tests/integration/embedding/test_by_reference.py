"""Puts and gets in the host's own process: gets return the very objects, and other programs get equal items."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Iterator
from concurrent.futures import Future

import pytest

import stampede_rt as st
from stampede_rt import aio
from stampede_rt_local.cluster import LocalCluster
from tests.support.sharing.shared_cluster import shared_cluster_fixture
from tests.support.waiting import pause

pytestmark = pytest.mark.without_rules("a client token cannot host channels")
cluster = shared_cluster_fixture(hosts=1)
LIMIT_S = 60


@pytest.fixture(scope="module")
def rt(cluster: LocalCluster) -> Iterator[st.Connection]:
    with st.host(cluster.address, name="rig") as rt:
        yield rt


def test_each_read_returns_the_object_that_was_put(rt: st.Connection) -> None:
    channel = rt.channel("reference/reads", max_items=10)
    first, second = bytes(1000), b"s" * 300_000
    channel.put(first, time=100, duration=50, attributes={"lens": "wide"}, content_type="image/raw")
    channel.put(second, time=200)
    newest, oldest, before = channel.newest(), channel.oldest(), channel.before(200)
    assert newest is not None
    assert oldest is not None
    assert before is not None
    assert (newest.payload is second, oldest.payload is first, before.payload is first) == (True, True, True)
    both = channel.get(st.OLDEST, st.NEWEST)
    assert [one.payload is put for one, put in zip(both, (first, second), strict=True)] == [True, True]
    assert channel.at(120)[0].payload is first
    assert (oldest.end, oldest.duration, dict(oldest.attributes)) == (150, 50, {"lens": "wide"})
    assert oldest.content_type == "image/raw"
    assert [one.payload for one in channel.get(0, 300, payloads=False, newest_first=True)] == [None, None]


@pytest.mark.parametrize("attributes", [{}, {"lens": "wide"}])
def test_an_item_of_a_run_is_read_with_all_its_fields(rt: st.Connection, attributes: dict[str, str]) -> None:
    channel = rt.channel(f"reference/items-of-a-run-{len(attributes)}", max_items=100)
    with channel.producer() as producer:
        for place in range(50):
            producer.put(bytes([place]) * place, time=1000 + place, duration=place + 1, attributes=attributes)
    [middle], newest, before = channel.at(1020), channel.newest(), channel.before(1020)
    assert newest is not None
    assert before is not None
    for item, place in ((middle, 20), (newest, 49), (before, 19)):
        assert (item.payload, item.time, item.seq) == (bytes([place]) * place, 1000 + place, 1 + place)
        assert (item.duration, item.payload_length_bytes, dict(item.attributes)) == (place + 1, place, attributes)
    assert (middle.end, newest.end, before.end) == (1021, 1099, 1020)


def test_a_waiting_get_returns_the_object_of_a_later_put(rt: st.Connection) -> None:
    channel = rt.channel("reference/waits", max_items=10)
    found: list[st.Item | None] = []
    waiting = threading.Thread(target=lambda: found.append(channel.newest(timeout=LIMIT_S)))
    waiting.start()
    while channel.stats().waiting_gets == 0:
        pass  # each request is a round trip
    payload = b"for the one that waits"
    channel.put(payload)
    waiting.join(LIMIT_S)
    assert found[0] is not None
    assert found[0].payload is payload


async def test_a_cancelled_get_of_an_embedded_host_ends(cluster: LocalCluster) -> None:
    async with aio.host(cluster.address, name="rig-aio", drain="0s") as rt:
        channel = await rt.channel("reference/cancelled")
        waiting = asyncio.create_task(channel.newest(timeout=None))
        async with asyncio.timeout(LIMIT_S):
            while (await channel.stats()).waiting_gets == 0:
                await pause()
            waiting.cancel()
            while (await channel.stats()).waiting_gets:
                await pause()
        payload = b"y"
        await channel.put(payload)
        newest = await channel.newest()
        assert newest is not None
        assert newest.payload is payload


async def test_a_put_whose_ack_came_too_late_is_stored_once(
    cluster: LocalCluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def late(future: Future[object], timeout_s: float | None) -> object:
        await asyncio.wrap_future(future)
        raise TimeoutError  # as if the program had blocked its event loop during the put

    async with aio.host(cluster.address, name="rig-late", drain="0s") as rt:
        channel = await rt.channel("reference/late")
        monkeypatch.setattr("stampede_rt._async.calls_here.result_of", late)
        put = await channel.put(b"once", time=7)
        monkeypatch.undo()
        items = await channel.get(st.OLDEST, st.NEWEST)
        assert [(one.seq, one.time, one.payload) for one in items] == [(put.seq, 7, b"once")]


def test_other_programs_get_and_put_equal_items(rt: st.Connection, cluster: LocalCluster) -> None:
    here = rt.channel("reference/others", max_items=10)
    for transport in ("grpc", "socket", "shared"):
        with st.connect(cluster.address, transport=transport) as other:
            there = other.channel("reference/others")
            with there.subscribe() as items:
                put = here.put(b"from here" * 1000, duration="5ms", attributes={"over": transport})
                streamed, read = next(items), there.newest()
            assert read is not None
            for item in (streamed, read):
                assert (item.time, item.seq, item.payload) == (put.time, put.seq, put.payload)
                assert (item.duration, dict(item.attributes)) == (5_000_000, {"over": transport})
            there.put(b"from there")
            both = here.get(put.time, st.NEWEST)
            assert [(one.seq, one.payload) for one in both] == [(put.seq, put.payload), (put.seq + 1, b"from there")]


def test_reads_continue_after_a_channel_moved_away_and_back(rt: st.Connection) -> None:
    channel = rt.channel("reference/moved", max_items=10)
    payload = b"moved"
    channel.put(payload, time=7)
    rt.move("reference/moved", "h1")
    away = channel.newest()
    channel.put(b"there", time=8)
    rt.move("reference/moved", "rig")
    back = channel.get(st.OLDEST, st.NEWEST)
    assert away is not None
    assert [away.payload, *[one.payload for one in back]] == [payload, payload, b"there"]


def test_threads_that_read_at_the_same_time_see_whole_states(rt: st.Connection) -> None:
    channel = rt.channel("reference/threads", max_items=5)
    channel.put(b"0" * 9)
    wrong: list[object] = []
    ended = threading.Event()

    def read() -> None:
        while not ended.is_set():
            items = channel.get(st.OLDEST, st.NEWEST)
            seqs = [one.seq for one in items]
            if seqs != [*range(seqs[0], seqs[0] + len(seqs))] or not 1 <= len(seqs) <= 5:
                wrong.append(seqs)

    readers = [threading.Thread(target=read) for _ in range(3)]
    for reader in readers:
        reader.start()
    try:
        for number in range(200):
            channel.put(str(number).encode())
    finally:
        ended.set()
        for reader in readers:
            reader.join(LIMIT_S)
    assert wrong == []


def test_a_refused_put_at_an_embedded_host_has_its_reason(rt: st.Connection) -> None:
    channel = rt.channel("reference/refused", max_items=10)
    channel.advance(1000)
    with pytest.raises(st.TooOld, match="reference/refused"):
        channel.put(b"late", time=500)
    with pytest.raises(st.ItemTooLarge):
        channel.put(bytes(17 * 2**20))


def test_a_producer_puts_large_items_by_reference_and_small_items_in_runs(
    rt: st.Connection, cluster: LocalCluster
) -> None:
    channel = rt.channel("reference/produced", max_items=500)
    large, labelled = b"l" * 300_000, b"with labels"
    with st.connect(cluster.address, transport="shared") as other:
        with other.channel("reference/produced").subscribe() as items, channel.producer() as producer:
            producer.put(large, time=5, duration=3)
            producer.put(labelled, time=9, attributes={"lens": "wide"}, content_type="image/raw")
            for number in range(300):
                producer.put(str(number).encode(), time=10 + number)
            producer.flush()
            found = [next(items) for _ in range(302)]
        assert (producer.accepted, producer.rejections) == (302, 0)
    assert channel.at(5)[0].payload is large
    assert [item.payload for item in found] == [large, labelled, *[str(number).encode() for number in range(300)]]
    assert (found[0].duration, found[1].content_type, dict(found[1].attributes)) == (3, "image/raw", {"lens": "wide"})
    assert [item.time for item in found] == [5, 9, *range(10, 310)]


async def test_an_awaited_producer_puts_by_reference(cluster: LocalCluster) -> None:
    async with aio.host(cluster.address, name="rig-producing", drain="0s") as rt:
        channel = await rt.channel("reference/awaited", max_items=10)
        payload = b"awaited" * 100_000
        async with channel.producer() as producer:
            await producer.put(b"first")
            await producer.put(payload)
        newest = await channel.newest()
        assert newest is not None
        assert newest.payload is payload


def test_a_producer_whose_puts_may_wait_uses_a_stream(rt: st.Connection) -> None:
    channel = rt.channel("reference/waiting", max_items=3, max_age="1h", on_full="block")
    with channel.producer() as producer:
        for number in range(3):
            producer.put(str(number).encode())
    assert [item.payload for item in channel.get(st.OLDEST, st.NEWEST)] == [b"0", b"1", b"2"]


def test_a_producer_continues_when_its_channel_moves_and_learns_of_refusals(rt: st.Connection) -> None:
    channel = rt.channel("reference/produced-away", max_items=10)
    with channel.producer() as producer:
        producer.put(b"here", time=7)
        producer.flush()
        rt.move("reference/produced-away", "h1")
        producer.put(b"there", time=8)
        producer.flush()
        rt.move("reference/produced-away", "rig")
        producer.put(b"back", time=9)
        producer.flush()
        channel.advance(100)
        producer.put(b"late", time=50)
        with pytest.raises(st.TooOld, match="advance"):
            producer.flush()
    assert [item.payload for item in channel.get(0, 100)] == [b"here", b"there", b"back"]
