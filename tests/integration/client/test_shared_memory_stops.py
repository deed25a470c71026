"""Reads from shared memory, with real processes: while a reader or a host is stopped, through a group, from a proxy."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

import pytest

import stampede_rt as st
from stampede_rt.ring.layout import FENCE_WORD
from stampede_rt.transports import futexes, ring_mapping
from stampede_rt_local.cluster import LocalCluster
from tests.integration.client.test_shared_memory import count_calls, mapping_of
from tests.support.cluster import cluster_fixture
from tests.support.waiting import wait_until

pytestmark = pytest.mark.skipif(not futexes.is_supported(), reason="shared memory needs Linux on x86-64")

cluster = cluster_fixture(hosts=2, supernodes=1)

PAYLOAD_BYTES = 300_000
READER = """
import sys, zlib, stampede_rt as st
address, name = sys.argv[1:]
with st.connect(address, transport="shared") as rt:
    channel = rt.channel(name, create=False)
    with channel.subscribe(after=channel.newest()) as items:
        print(0, 0, 0, flush=True)
        for item in items:
            assert item.payload[:4] == zlib.crc32(item.payload[4:]).to_bytes(4, "little"), "a torn item"
            print(item.seq, items.dropped, channel.newest().seq, flush=True)
"""


@contextmanager
def reader_of(cluster: LocalCluster, name: str) -> Iterator[subprocess.Popen[str]]:
    """A process that reads all items after the newest one."""
    arguments = [sys.executable, "-c", READER, cluster.address, name]
    with subprocess.Popen(arguments, stdout=subprocess.PIPE, text=True) as reader:
        try:
            yield reader
        finally:
            reader.send_signal(signal.SIGCONT)
            reader.kill()


def next_report(reader: subprocess.Popen[str]) -> tuple[int, int, int]:
    """The seq of the reader's next item, the number of items dropped before, and the seq of the newest item."""
    assert reader.stdout is not None
    seq, dropped, newest = map(int, reader.stdout.readline().split())
    return seq, dropped, newest


def checked_payload(number: int) -> bytes:
    """A large payload with a checksum."""
    import zlib

    filling = number.to_bytes(4, "little") * (PAYLOAD_BYTES // 4)
    return zlib.crc32(filling).to_bytes(4, "little") + filling


@pytest.mark.parametrize(("held", "dropped_max"), [(100, 0), (10, 30)])
def test_a_stopped_reader_delays_no_other_caller_and_continues_at_its_position(
    cluster: LocalCluster, held: int, dropped_max: int
) -> None:
    """The ring has room for 16 items. When the reader goes on, the host sends the items that the ring has
    overwritten, or reports them as dropped.
    """
    name = f"stopped/reader/{held}"
    with st.connect(cluster.address, transport="shared") as rt:
        channel = rt.channel(name, max_items=held)
        channel.put(checked_payload(0))
        with reader_of(cluster, name) as reader:
            next_report(reader)
            for number in (1, 2):
                channel.put(checked_payload(number))
            assert [next_report(reader)[0] for _ in range(2)] == [2, 3]
            wait_until(lambda: not channel.stats().subscriptions)  # the reader follows the ring
            reader.send_signal(signal.SIGSTOP)
            last = [channel.put(checked_payload(number)) for number in range(40)][-1]
            assert channel.newest().seq == last.seq == 43  # type: ignore[union-attr]
            reader.send_signal(signal.SIGCONT)
            seqs, dropped, newest = [3], 0, 0
            while seqs[-1] < last.seq:
                seq, dropped, newest = next_report(reader)
                seqs.append(seq)
            assert seqs == sorted(set(seqs))
            assert (len(seqs) - 1, newest) == (40 - dropped, last.seq)
            # The reader may have taken an item just before the stop.
            assert max(0, dropped_max - 3) <= dropped <= dropped_max


def test_readers_of_a_stopped_host_learn_of_the_loss_and_read_its_memory_no_more(cluster: LocalCluster) -> None:
    """The readers read the host's memory while its lease lasts. Then another host has the channel."""
    with st.connect(cluster.address, transport="shared") as rt, ThreadPoolExecutor() as pool:
        channel = rt.channel("stopped/host", max_age="600s", host="h1")
        before = channel.put(b"before")
        mapping = mapping_of(channel)
        with channel.subscribe() as items:
            waiting = [pool.submit(next, items), pool.submit(channel.newest, before, timeout=60)]
            wait_until(lambda: channel._session.rings.waits.waiting == 2)
            cluster.hosts[0].pause()
            try:
                for one in waiting:
                    with pytest.raises(st.IncarnationLost):
                        one.result(60)
                assert not mapping.is_open(ring_mapping.boottime_nanos())
                after = channel.put(b"after")
                assert channel.newest() == after._replace(end=None)
            finally:
                cluster.hosts[0].resume()
            wait_until(lambda: mapping.view.words[FENCE_WORD] == 0 or not mapping.may_be_open)
            assert channel.newest() == after._replace(end=None)


def test_items_that_a_group_hides_are_not_read_from_memory(
    cluster: LocalCluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = count_calls(monkeypatch)
    with st.connect(cluster.address, transport="shared") as rt:
        fast, slow = (rt.channel(f"grouped/{one}", max_age="600s", host="h1") for one in ("fast", "slow"))
        group = rt.group("grouped/both", [fast, slow])
        base = fast.put(b"0").time
        slow.put(b"0", time=base)
        for number in range(1, 5):
            fast.put(b"%d" % number, time=base + number)
        assert fast.newest().payload == b"4"  # type: ignore[union-attr]
        assert calls == []
        slow.put(b"2", time=base + 2)
        view = group[fast]
        wait_until(lambda: view.newest() is not None)
        calls.clear()
        assert view.newest().payload == b"1"
        assert [one.payload for one in view.get(st.OLDEST, st.NEWEST)] == [b"0", b"1"]
        assert calls == ["read", "read"]
        assert [one.payload for one in view.at(base + 4)] == []


def test_readers_of_shared_memory_stay_at_the_owner_although_there_is_a_proxy(cluster: LocalCluster) -> None:
    with st.connect(cluster.address, transport="shared") as rt:
        channel = rt.channel("proxied", max_age="600s", host="h1")
        first = channel.put(b"first")
        rt.proxy(channel, "h2")
        assert channel.newest() == first._replace(end=None)
        with channel.subscribe() as items:
            later = [channel.put(b"%d" % number) for number in range(20)]
            assert [next(items).seq for _ in later] == [one.seq for one in later]
            assert items._follower is not None
            assert channel.newest().seq == later[-1].seq
            assert channel.stats().transport == "shared"
            assert [one.subscriptions for one in rt.proxies(channel)] == [0]
