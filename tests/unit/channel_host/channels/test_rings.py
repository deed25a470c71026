"""Rings of a host: a worker thread takes their memory, they fit the runs of their channels, and memory may be short."""

from __future__ import annotations

import asyncio
import gc
import math
import mmap
import os
import threading
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import pytest

from stampede_rt.errors import Overloaded, StampedeError, Unavailable
from stampede_rt.ring.layout import CHANGES_WORD, HEAD
from stampede_rt.ring.ring_view import RingView
from stampede_rt.transports import futexes
from stampede_rt.v1 import channel_pb2
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.values.model import Policy
from stampede_rt.wire.records import policy_to_spec
from stampede_rt.wire.runs import encode_run
from stampede_rt_channel_host.channels import rings as rings_module
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.limits.memory import MemoryBudget
from stampede_rt_channel_host.channels.puts.incoming_run import IncomingRun
from stampede_rt_channel_host.channels.ring_memory import RingMemory
from stampede_rt_channel_host.channels.rings import MEMORY_SHARE, REVIEW_SECONDS, Rings
from stampede_rt_channel_host.cluster.records import recorded_channel
from stampede_rt_channel_host.core.channel import run_to_end
from stampede_rt_channel_host.core.ring_writer import ClockReading
from stampede_rt_runtime.sockets.stream_socket import LOCAL_PEER
from tests.support.clock import ManualClock
from tests.support.waiting import until

pytestmark = pytest.mark.skipif(not futexes.is_supported(), reason="shared memory needs Linux on x86-64")

MIB = 2**20
LIMIT_S = 20.0


class Reader:
    """The stream of one reader, and a ring that came over it."""

    def __init__(self, host: Host) -> None:
        self.view: RingView | None = None
        self.refusals: list[str] = []
        self.gone = asyncio.Event()
        self.serving = asyncio.ensure_future(host.rings.serve(host.hosted, self))  # type: ignore[arg-type]

    def peer(self) -> str:
        return LOCAL_PEER

    async def read(self) -> None:
        await self.gone.wait()

    async def write(self, message: bytes) -> None:
        self.refusals.append(pb.ShareMemoryResponse.FromString(message).detail)

    async def write_with_file(self, message: bytes, file: int) -> None:
        memory_bytes = pb.ShareMemoryResponse.FromString(message).memory_bytes
        self.view = RingView(memoryview(mmap.mmap(file, memory_bytes, prot=mmap.PROT_READ)))

    async def ring(self) -> RingView:
        """The ring, once it has come. Raises the host's error."""
        await until(lambda: self.view is not None or self.serving.done())
        if self.view is None:
            self.serving.result()
        assert self.view is not None
        return self.view


class Host:
    """A host with one channel."""

    def __init__(self, bytes_max: int = 2**30) -> None:
        clock = ManualClock()
        self.memory, self._now = MemoryBudget(bytes_max), clock.time_unix_nano
        self.rings = Rings(self.memory, lambda: ClockReading(1, 1, 0))
        self.rings.fence_boottime = lambda: 2**62
        spec = policy_to_spec(Policy(max_items=100))
        record = channel_pb2.ChannelRecord(name="a", epoch=1, incarnation=5, spec=spec)
        self.hosted = HostedChannel(recorded_channel(record), self.memory, self._now, lambda _: None)

    def put(self, *payloads: bytes) -> None:
        for payload in payloads:
            run = IncomingRun(encode_run([payload], times=None), producer_id=0, first_number=1, wait_nanos=None)
            assert self.hosted.puts.put(run, self._now()) is not None

    @property
    def ring_bytes(self) -> int:
        """The memory of all rings, as the host's budget counts it."""
        return self.memory.used_bytes - self.hosted.footprint_bytes()


def payloads_in(view: RingView) -> list[bytes]:
    facts = view.facts()
    assert facts is not None
    return [view.copy_item(view.slot(number)) or b"" for number in range(facts[HEAD])]


class Worker:
    """A worker thread that takes memory only when the test allows it."""

    def __init__(self) -> None:
        self.may_begin = threading.Event()
        self.made: list[RingMemory] = []
        self.calls = 0

    def __call__(self, size: Any) -> RingMemory:
        self.calls += 1
        assert threading.current_thread() is not threading.main_thread()
        assert self.may_begin.wait(LIMIT_S)
        memory = RingMemory(size)
        self.made.append(memory)
        return memory


@pytest.fixture
def worker(monkeypatch: pytest.MonkeyPatch) -> Iterator[Worker]:
    held = Worker()
    monkeypatch.setattr(rings_module, "RingMemory", held)
    yield held
    held.may_begin.set()


def is_closed(file: int) -> bool:
    try:
        os.fstat(file)
    except OSError:
        return True
    return False


async def test_items_that_come_while_a_thread_takes_the_memory_are_in_the_ring_once(worker: Worker) -> None:
    host = Host()
    host.put(b"0", b"1")
    readers = [Reader(host), Reader(host)]
    await until(lambda: worker.calls)
    host.put(b"2", b"3")
    later = Reader(host)
    await asyncio.sleep(0)
    worker.may_begin.set()
    views = [await one.ring() for one in (*readers, later)]
    assert worker.calls == 1
    host.put(b"4")
    assert [payloads_in(view) for view in views] == [[b"0", b"1", b"2", b"3", b"4"]] * 3
    assert views[0].words[CHANGES_WORD] == 2, "the readers share one ring"


@pytest.mark.parametrize("how", ["ended", "changed"])
async def test_a_channel_that_ends_or_changes_meanwhile_gets_no_ring(worker: Worker, how: str) -> None:
    host = Host()
    readers = [Reader(host), Reader(host)]
    await until(lambda: worker.calls)
    if how == "ended":
        run_to_end(host.hosted.ending(Unavailable("the channel has moved")))
    else:
        host.hosted.update(replace(host.hosted.record, epoch=2))
    worker.may_begin.set()
    for reader in readers:
        with pytest.raises(Unavailable, match="ask again"):
            await reader.ring()
    assert (host.hosted.ring, host.ring_bytes, len(host.rings)) == (None, 0, 0)
    await until(lambda: is_closed(worker.made[0].file))


async def test_a_reader_that_asks_after_a_change_gets_a_ring_of_its_own(worker: Worker) -> None:
    host = Host()
    former = Reader(host)
    await until(lambda: worker.calls)
    host.hosted.close_ring()
    later = Reader(host)
    await until(lambda: worker.calls == 2)
    worker.may_begin.set()
    with pytest.raises(Unavailable):
        await former.ring()
    host.put(b"x")
    assert payloads_in(await later.ring()) == [b"x"]


async def test_a_ring_whose_readers_have_gone_meanwhile_is_dropped(
    worker: Worker, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rings_module, "KEPT_SECONDS", 0.0)
    host = Host()
    reader = Reader(host)
    await until(lambda: worker.calls)
    reader.serving.cancel()
    worker.may_begin.set()
    await until(lambda: worker.made and is_closed(worker.made[0].file))
    assert (host.hosted.ring, host.ring_bytes) == (None, 0)


def test_a_host_that_ends_meanwhile_leaves_no_file(worker: Worker) -> None:
    async def stopped() -> None:
        Reader(Host())
        await until(lambda: worker.calls)
        threading.Timer(0, worker.may_begin.set).start()

    asyncio.run(stopped())
    files = [one.file for one in worker.made]
    worker.made.clear()
    gc.collect()
    assert len(files) == 1
    assert is_closed(files[0])


async def test_a_ring_for_items_that_grow_meanwhile_takes_the_longer_ones(worker: Worker) -> None:
    host = Host()
    host.put(b"small")
    reader = Reader(host)
    await until(lambda: worker.calls)
    host.put(bytes(300_000))
    worker.may_begin.set()
    view = await reader.ring()
    assert [len(one) for one in payloads_in(view)] == [5, 300_000]
    assert [one.size.data_bytes for one in worker.made] == [4 * MIB, 12 * MIB]
    await until(lambda: worker.made[0].mapped.closed)
    assert host.ring_bytes == worker.made[1].size.whole_bytes


async def test_memory_that_the_system_refuses_does_not_count(monkeypatch: pytest.MonkeyPatch) -> None:
    def full(size: Any) -> RingMemory:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(rings_module, "RingMemory", full)
    host = Host()
    with pytest.raises(Overloaded, match="No space left"):
        await Reader(host).ring()
    assert host.ring_bytes == 0


async def test_a_short_share_gives_a_shorter_ring_and_a_longer_one_when_there_is_memory() -> None:
    host = Host(bytes_max=8 * MIB * MEMORY_SHARE)
    host.put(bytes(300_000))
    reader = Reader(host)
    await reader.ring()
    assert host.hosted.ring is not None
    assert host.hosted.ring.fit.data_bytes == 6 * MIB
    host.put(bytes(1_000_000))
    assert host.hosted.ring is not None, "a ring takes runs of up to a quarter of its data"
    host.memory.bytes_max = 2**30
    host.rings.review(asyncio.get_running_loop().time() + REVIEW_SECONDS)
    assert host.hosted.ring is None
    await reader.serving
    await Reader(host).ring()
    assert host.hosted.ring.fit.data_bytes == 40 * MIB


async def test_a_longer_ring_takes_the_runs_that_were_too_long_for_the_short_one() -> None:
    """In an earlier version, the longer ring had room for the newest runs only. The next large item ended it again."""
    host = Host(bytes_max=8 * MIB * MEMORY_SHARE)
    host.put(bytes(300_000))
    reader = Reader(host)
    await reader.ring()
    host.put(*(b"%d" % number for number in range(100)))
    host.memory.bytes_max = 2**30
    host.rings.review(asyncio.get_running_loop().time() + REVIEW_SECONDS)
    await reader.serving
    await Reader(host).ring()
    assert host.hosted.ring is not None
    assert host.hosted.ring.fit.data_bytes == 12 * MIB


async def test_a_host_without_memory_for_any_ring_refuses_and_gives_one_later() -> None:
    host = Host(bytes_max=MIB * MEMORY_SHARE)
    host.put(bytes(300_000))
    with pytest.raises(Overloaded, match="--memory-bytes-max"):
        await Reader(host).ring()
    host.memory.bytes_max *= 2
    assert len(payloads_in(await Reader(host).ring())) == 1


async def test_a_ring_that_grew_for_one_large_item_becomes_small_again() -> None:
    host = Host()
    host.put(b"0")
    small = Reader(host)
    await small.ring()
    host.put(bytes(400_000))
    await small.serving
    large = Reader(host)
    await large.ring()
    assert host.hosted.ring is not None
    assert host.hosted.ring.fit.data_bytes == 16 * MIB
    host.put(*(b"%d" % number for number in range(100)))
    now_s = math.ceil(asyncio.get_running_loop().time())  # whole seconds, so that no sum is rounded
    for periods in (1, 1.5, 2, 2.5):
        host.rings.review(now_s + periods * REVIEW_SECONDS)
        assert host.hosted.ring is not None, "the large item came in the last two periods"
    host.rings.review(now_s + 3 * REVIEW_SECONDS)
    assert host.hosted.ring is None
    await large.serving
    await Reader(host).ring()
    assert host.hosted.ring.fit.data_bytes == 4 * MIB
    host.rings.review(now_s + 9 * REVIEW_SECONDS)
    host.rings.review(now_s + 10 * REVIEW_SECONDS)
    assert host.hosted.ring is not None, "an idle ring stays"


async def test_one_item_that_is_too_large_for_every_ring_bars_its_channel_only_while_it_is_new() -> None:
    host = Host()
    host.put(b"0")
    reader = Reader(host)
    await reader.ring()
    host.put(bytes(16 * MIB))
    await reader.serving
    refused = Reader(host)
    await refused.serving
    assert refused.refusals == ["the channel's items are too large"]
    host.put(*(b"%d" % number for number in range(100)))
    assert payloads_in(await Reader(host).ring())


async def test_a_worker_thread_frees_the_memory_of_a_ring(monkeypatch: pytest.MonkeyPatch) -> None:
    """In an earlier version, the event loop stopped for milliseconds when a large ring ended, for instance in a put."""
    close, threads = RingMemory.close, list[threading.Thread]()

    def noted(memory: RingMemory) -> None:
        threads.append(threading.current_thread())
        close(memory)

    monkeypatch.setattr(RingMemory, "close", noted)
    host = Host()
    host.put(b"0")
    await Reader(host).ring()
    assert host.hosted.ring is not None
    memory = host.hosted.ring.memory
    host.hosted.close_ring()
    assert host.ring_bytes == 0
    await until(lambda: memory.mapped.closed)
    assert threads
    assert threading.main_thread() not in threads


@pytest.mark.parametrize("error", [None, StampedeError("")])
def test_the_file_of_a_ring_closes_with_its_last_user(error: StampedeError | None) -> None:
    memory = RingMemory(rings_module.ring_size(4096))
    file = memory.file
    if error is None:
        memory.close()
        memory.close()
    else:
        del memory
        gc.collect()
    assert is_closed(file)
