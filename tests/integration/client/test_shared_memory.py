"""Reads from shared memory, with real processes: the programs that get this memory, the answers of the reads, and the
end of a killed program.
"""

from __future__ import annotations

import asyncio
import mmap
import os
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

import stampede_rt as st
from stampede_rt import aio
from stampede_rt._sync import shared_rings
from stampede_rt.ring.ring_view import RingView
from stampede_rt.transports import futexes, ring_mapping
from stampede_rt.transports.ring_mapping import RingMapping
from stampede_rt_local.cluster import LocalCluster
from tests.support.cluster import cluster_fixture
from tests.support.forking.forked_children import in_a_forked_child
from tests.support.operator import operating
from tests.support.sharing.shared_cluster import shared_cluster_fixture
from tests.support.waiting import until, wait_until

pytestmark = pytest.mark.skipif(not futexes.is_supported(), reason="shared memory needs Linux on x86-64")

cluster = shared_cluster_fixture(hosts=1)
own_cluster = cluster_fixture(hosts=1, supernodes=1, scope="function")


@contextmanager
def channel_of(cluster: LocalCluster, name: str, **policy: Any) -> Iterator[st.Channel]:
    """A channel with one item, whose ring is open."""
    with st.connect(cluster.address, transport="shared") as rt:
        channel = rt.channel(name, **({"max_age": "60s"} | policy))
        channel.put(b"first")
        assert channel.newest() is not None
        yield channel


def mapping_of(channel: st.Channel) -> RingMapping:
    mapping = channel._session.rings.find(channel._state)
    assert mapping is not None
    return mapping


def ring_files(pid: int) -> int:
    """The rings that a process maps."""
    return sum("stampede-ring" in line for line in Path(f"/proc/{pid}/maps").read_text().splitlines())


def count_calls(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Note each read that calls the host."""
    from stampede_rt._sync import reader

    calls: list[str] = []
    ask: Callable[..., Any] = reader.read

    def asking(*arguments: Any) -> Any:
        calls.append("read")
        return ask(*arguments)

    monkeypatch.setattr(reader, "read", asking)
    return calls


def test_reads_of_the_newest_part_make_no_call(cluster: LocalCluster, monkeypatch: pytest.MonkeyPatch) -> None:
    calls = count_calls(monkeypatch)
    with channel_of(cluster, "ring/calls") as channel:
        items = [channel.put(b"%d" % number) for number in range(20)]
        assert channel.newest() == channel.newest(after=items[0]) == items[-1]._replace(end=None)
        assert channel.newest(after=items[-1]) is None
        assert [one.seq for one in channel.at(items[10].time)] == [items[10].seq]
        assert [one.seq for one in channel.get(items[5].time, items[9].time)] == [one.seq for one in items[5:10]]
        assert channel.get(items[5].time, items[9].time, newest_first=True, limit=2)[0].seq == items[9].seq
        assert calls == []
        assert channel.get(st.OLDEST, items[2].time)
        assert calls == ["read"]


def test_an_unchanged_newest_item_is_copied_out_of_memory_once(
    cluster: LocalCluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    copies: list[int] = []
    copy = RingView.copy_payload
    monkeypatch.setattr(RingView, "copy_payload", lambda view, slot: copies.append(slot.seq) or copy(view, slot))
    with channel_of(cluster, "ring/unchanged") as channel:
        for number in range(1, 5):
            item = channel.put(b"%d" % number)
            copies.clear()
            found = [channel.newest() for _ in range(100)]
            assert found == [item._replace(end=None)] * 100
            assert found[0].attributes is not found[1].attributes  # type: ignore[union-attr]
            assert set(copies) == {item.seq}
            assert len(copies) < 50, "the reader copies the item again only after each update of the host's clock"


def test_the_default_transport_shares_memory_after_some_reads_and_shows_it(cluster: LocalCluster) -> None:
    with st.connect(cluster.address) as rt:
        channel = rt.channel("ring/default", max_age="60s")
        channel.put(b"x")
        assert channel.stats().transport == "socket"
        for _ in range(shared_rings.READS_BEFORE):
            channel.newest()
        assert channel.stats().transport == "shared"


def test_a_channel_with_consumers_is_read_over_sockets(cluster: LocalCluster) -> None:
    with st.connect(cluster.address, transport="shared") as rt:
        channel = rt.channel("ring/consumed", consumers=1)
        item = channel.put(b"x")
        assert channel.newest() is not None
        channel.consume(item)
        assert channel.newest() is None
        assert channel.stats().transport == "socket"


def test_a_host_on_another_machine_shares_no_memory_and_the_error_gives_advice(
    cluster: LocalCluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("stampede_rt._sync.session.this_machine", lambda: "another")
    monkeypatch.setattr("stampede_rt.transports.grpc_sync.this_machine", lambda: "another")
    with st.connect(cluster.address, transport="shared") as rt:
        channel = rt.channel("ring/far")
        with pytest.raises(st.Unavailable, match='leave out transport="shared"'):
            channel.newest()


def test_a_changed_policy_applies_immediately_to_readers_of_shared_memory(cluster: LocalCluster) -> None:
    with channel_of(cluster, "ring/policy") as channel:
        for number in range(5):
            channel.put(b"%d" % number)
        channel.configure(max_items=2)
        assert [one.payload for one in channel.get(st.OLDEST, st.NEWEST)] == [b"3", b"4"]
        assert not channel.at(channel.newest().time - 10**12)  # type: ignore[union-attr]


def test_an_item_that_does_not_fit_into_the_ring_gets_a_larger_ring(cluster: LocalCluster) -> None:
    with channel_of(cluster, "ring/large") as channel:
        small = mapping_of(channel)
        large = os.urandom(3 * 2**20)
        channel.put(large)
        found = channel.newest()
        assert found is not None
        assert found.payload == large
        assert not small.is_open(ring_mapping.boottime_nanos())
        known = channel._session.rings._channels[channel.info.channel_id]
        known.not_before_s = 0.0
        assert mapping_of(channel) is not small
        assert channel.newest() == found


def test_a_subscription_to_shared_memory_yields_every_item_once(cluster: LocalCluster) -> None:
    with channel_of(cluster, "ring/followed") as channel, channel.subscribe() as items:
        puts = threading.Thread(target=lambda: [channel.put(b"%d" % number) for number in range(300)])
        puts.start()
        found = [next(items) for _ in range(300)]
        puts.join()
        assert [one.payload for one in found] == [b"%d" % number for number in range(300)]
        assert items._follower is not None
        assert (items.dropped, items.skipped, items.reconnects) == (0, 0, 0)


def test_a_late_item_reaches_a_subscription_that_follows_the_ring(cluster: LocalCluster) -> None:
    with channel_of(cluster, "ring/late") as channel, channel.subscribe() as items:
        newest = channel.put(b"a")
        assert next(items).payload == b"a"
        assert items._follower is not None
        late = channel.put(b"late", time=newest.time - 1000)
        assert [next(items).seq, channel.newest().seq] == [late.seq, newest.seq]  # type: ignore[union-attr]
        assert channel.at(late.time)[0].seq == late.seq


def test_closing_a_subscription_or_the_connection_ends_a_wait_on_shared_memory(cluster: LocalCluster) -> None:
    with channel_of(cluster, "ring/closing") as channel:
        items = channel.subscribe()
        ended: list[Any] = []
        thread = threading.Thread(target=lambda: ended.append(next(items, None)))
        thread.start()
        wait_until(lambda: channel._session.rings.waits.waiting == 1)
        items.close()
        thread.join(10)
        assert ended == [None]
        waiting = threading.Thread(
            target=lambda: ended.append(_outcome(lambda: channel.newest(channel.newest(), timeout=60)))
        )
        waiting.start()
        wait_until(lambda: channel._session.rings.waits.waiting == 1)
    waiting.join(10)
    assert isinstance(ended[1], st.Unavailable)


def _outcome(call: Callable[[], Any]) -> Any:
    try:
        return call()
    except st.StampedeError as error:
        return error


async def test_asyncio_readers_of_shared_memory_share_one_waiting_thread(cluster: LocalCluster) -> None:
    async with aio.connect(cluster.address, transport="shared") as rt:
        channels = [await rt.channel(f"ring/awaited/{number}", max_age="60s") for number in range(5)]
        seen = [await one.put(b"x") for one in channels]
        waiting = [
            asyncio.ensure_future(one.newest(after, timeout=30)) for one, after in zip(channels, seen, strict=True)
        ]
        await until(lambda: channels[0]._session.rings.waits.waiting == 5)
        names = [thread.name for thread in threading.enumerate()]
        assert names.count("stampede waits for rings") == 1
        for one in channels:
            await one.put(b"y")
        assert [(await one).payload for one in waiting] == [b"y"] * 5


def test_readers_leave_the_memory_of_a_killed_host_and_no_file_remains(own_cluster: LocalCluster) -> None:
    with channel_of(own_cluster, "ring/killed") as channel:
        mapping = mapping_of(channel)
        before = channel.newest()
        own_cluster.hosts[0].kill()
        wait_until(lambda: not mapping.is_open(ring_mapping.boottime_nanos()))
        own_cluster.hosts[0].restart()
        assert channel.put(b"new").incarnation != before.incarnation  # type: ignore[union-attr]
        found = channel.newest()
        assert found is not None
        assert found.payload == b"new"
    assert not [path for path in Path("/dev/shm").iterdir() if "stampede" in path.name]


def test_a_host_keeps_nothing_of_a_killed_reader(own_cluster: LocalCluster) -> None:
    def sockets() -> set[str]:
        found = set[str]()
        for one in Path(f"/proc/{host}/fd").iterdir():
            with suppress(FileNotFoundError):  # the host has closed it meanwhile
                found.add(os.readlink(one))
        return {one for one in found if one.startswith("socket:")}

    host = _host_pid(own_cluster)
    with st.connect(own_cluster.address, transport="grpc") as rt:
        rt.channel("ring/earlier").put(b"x")  # afterwards the host has all connections of its own
    before = sockets()
    script = (
        "import stampede_rt as st\n"
        f"rt = st.connect({own_cluster.address!r}, transport='shared')\n"
        "channel = rt.channel('ring/reader', max_age='60s'); channel.put(b'x')\n"
        "seen = channel.newest(); print('mapped', flush=True); channel.newest(seen, timeout=None)\n"
    )
    with subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE) as reader:
        assert reader.stdout is not None
        assert reader.stdout.readline() == b"mapped\n"
        assert ring_files(host) == ring_files(reader.pid) == 1
        added = sockets() - before
        assert added
        reader.kill()
    wait_until(lambda: not added & sockets())
    wait_until(lambda: not ring_files(host))  # the host keeps a ring without readers for KEPT_SECONDS


def _host_pid(cluster: LocalCluster) -> int:
    """The host process itself: the started process may have a parent that watches it."""
    pid = cluster.hosts[0].pid
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    return int(children[0]) if children else pid


def test_a_reader_can_write_neither_the_mapping_nor_the_file(cluster: LocalCluster) -> None:
    with channel_of(cluster, "ring/sealed") as channel:
        mapping = mapping_of(channel)
        with pytest.raises(TypeError):
            mapping._memory[0:1] = b"x"
        connected = _ask_for_file(channel)
        file = connected[0]
        try:
            for attempt in (
                lambda: mmap.mmap(file, 4096),
                lambda: os.ftruncate(file, 0),
                lambda: os.pwrite(file, b"x", 0),
            ):
                with pytest.raises(OSError, match="not permitted"):
                    attempt()
        finally:
            os.close(file)
            connected[1].close()


def _ask_for_file(channel: st.Channel) -> tuple[int, socket.socket]:
    """Ask the host for a ring's file, as a hostile reader would. Returns the file and the socket."""
    from stampede_rt.transports.socket_connecting_sync import connect
    from stampede_rt.transports.socket_routes import opening_of
    from stampede_rt.wire.stream_frames import FrameReader

    binding = channel._session.bind(channel._state)
    endpoint = channel._session.endpoints.to(binding.target)
    connected = connect(endpoint.route, endpoint._ask_for_sockets)
    assert connected is not None
    opening = opening_of(ring_mapping.SHARE_METHOD, endpoint._metadata(), endpoint.route.ticket)
    request = ring_mapping.pb.ShareMemoryRequest(channel_id=binding.subject_id, epoch=binding.epoch)
    frame_of, kind = ring_mapping.frame_of, ring_mapping.FrameKind
    frames = frame_of(kind.OPENING, opening) + frame_of(kind.MESSAGE, request.SerializeToString())
    connected.socket.sendall(frames)
    files: list[int] = []
    ring_mapping._response(connected.socket, FrameReader(ring_mapping.RECEIVED_BYTES_MAX), files)
    return files[0], connected.socket


def test_a_client_that_chose_grpc_shares_no_memory(cluster: LocalCluster) -> None:
    with st.connect(cluster.address, transport="grpc") as rt:
        channel = rt.channel("ring/grpc", max_age="60s")
        binding = channel._session.bind(channel._state)
        endpoint = channel._session.endpoints.to(binding.target)
        stream = endpoint.open_bidi(endpoint.channels.ShareMemory)
        stream.send(ring_mapping.pb.ShareMemoryRequest(channel_id=binding.subject_id, epoch=binding.epoch))
        with pytest.raises(st.InvalidArgument, match="only over the Unix socket"):
            next(iter(stream))


def test_a_ring_ends_when_a_reader_loses_its_right_and_other_readers_get_a_new_ring(own_cluster: LocalCluster) -> None:
    with operating(own_cluster) as operator, channel_of(own_cluster, "ring/right") as own:
        operator.add("nobody", "read", "no-such-channel", "--kind", "channel")  # without any rule all is allowed
        operator.add("reader", "read,list", "ring/*", "--kind", "channel")
        with st.connect(own_cluster.address, transport="shared", secret=operator.token("reader")) as rt:
            channel = rt.channel("ring/right", create=False)
            assert channel.newest() is not None
            mapping = mapping_of(channel)
            operator.rm("reader", "read,list", "ring/*", "--kind", "channel")
            wait_until(lambda: not mapping.is_open(ring_mapping.boottime_nanos()))
            with pytest.raises(st.PermissionDenied):
                channel.newest()
        later = own.put(b"secret")
        assert own.newest().seq == later.seq  # type: ignore[union-attr]
        assert b"secret" not in bytes(mapping._memory)


def test_a_forked_child_reads_no_ring(cluster: LocalCluster) -> None:
    with channel_of(cluster, "ring/fork") as channel:
        assert in_a_forked_child(lambda: type(_outcome(channel.newest)).__name__) == "ForkedProcess"
        assert channel.newest() is not None


def test_many_openings_and_closings_leave_no_files_mappings_or_threads(cluster: LocalCluster) -> None:
    def counts() -> tuple[int, int, int]:
        return len(os.listdir("/proc/self/fd")), ring_files(os.getpid()), threading.active_count()

    with channel_of(cluster, "ring/many") as channel:
        known = channel._session.rings._channels[channel.info.channel_id]
        before = counts()
        for _ in range(int(os.environ.get("STAMPEDE_RING_OPENINGS", "200"))):
            known.mapping.close()
            known.not_before_s = 0.0
            assert channel.newest() is not None
        assert counts() == before
        assert ring_files(_host_pid(cluster)) <= 30
