"""A relay cuts a stream between hosts after any byte, or a host freezes at that moment: no acknowledged item is lost.

The hosts are real processes. Meanwhile a channel and a queue with replicas move from host to host under load, and a
taker keeps the leases of some messages. `make test` plays a few seeds, `make kill-moves` plays many.
"""

from __future__ import annotations

import os
import random
import threading
from collections import deque
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from typing import Any, NamedTuple

import pytest

import stampede_rt as st
from stampede_rt_local.cluster import LocalCluster
from stampede_rt_local.ports import free_ports
from stampede_rt_local.process import ServiceProcess
from tests.robustness.moves.test_real_processes import READY_S, SETTLED_S, Producer, check, try_move
from tests.robustness.moves.test_real_replicas import QueueLoad, in_sync, moved_queue
from tests.support.cluster import cluster_fixture
from tests.support.cutting_relay import CuttingRelay
from tests.support.waiting import wait_until

cluster = cluster_fixture(hosts=0, supernodes=1)
EVERY_STEP = bool(os.environ.get("STAMPEDE_EVERY_STEP"))
SEEDS = range(40 if EVERY_STEP else 3)
FAULTS_PER_SEED = 6 if EVERY_STEP else 2
FROZEN_S_MAX = 3.0 if EVERY_STEP else 1.2  # shorter than a lease, so no host is lost
BYTES_LOG2_MAX = 15  # a fault comes after 1 to 2**15 bytes
NAMES = ("left", "middle", "right")
LEASED_MAX = 20
LEASE = "30s"  # shorter than `wait_until` waits: a message whose delivery was lost comes again when its lease ends
INNER = "127.0.0.2"  # the address of the hosts themselves, behind the relay


class RelayedHosts(NamedTuple):
    """Some hosts. Their streams to each other go through the relay to `data_ports`. Clients use other ports."""

    processes: dict[str, ServiceProcess]
    relay: CuttingRelay
    data_ports: list[int]


@pytest.fixture(scope="module")
def hosts(cluster: LocalCluster) -> Iterator[RelayedHosts]:
    ports = [free_ports(3) for _ in NAMES]
    targets = {outer: (INNER, inner) for outer, inner, _ in ports} | {data: (INNER, data) for *_, data in ports}
    access = ("--frontend", cluster.address, "--secret-file", str(cluster.secret_file), "--drain-seconds", "0")
    with CuttingRelay(targets) as relay, ExitStack() as stack:
        processes = {}
        for name, (outer, inner, data) in zip(NAMES, ports, strict=True):
            words = ["--listen", f"{INNER}:{inner}", "--advertise", f"localhost:{outer}", "--name", name]
            words += ["--data-port", str(data), "--feed-transport", "tcp", *access]
            processes[name] = ServiceProcess(f"host {name}", "stampede_rt_channel_host", words)
            stack.callback(processes[name].kill)
            processes[name].start()
        for one in processes.values():
            one.wait_ready(READY_S)
        yield RelayedHosts(processes, relay, [data for *_, data in ports])


class Fault:
    """Ends the stream, or freezes one host for some time, when the hosts have exchanged some more bytes."""

    def __init__(self, hosts: RelayedHosts, source: random.Random) -> None:
        byte_count = int(2 ** source.uniform(0, BYTES_LOG2_MAX))
        self._victim = hosts.processes[source.choice(NAMES)] if source.random() < 0.4 else None
        self._frozen_s = source.uniform(0.1, FROZEN_S_MAX)
        self._is_over = threading.Event()
        what = f"{self._victim.name} freezes for {self._frozen_s:.1f} s" if self._victim else "cut"
        self.description = f"{what} after {byte_count} bytes"
        hosts.relay.stop_after(byte_count, hosts.data_ports, self._begin)

    def _begin(self) -> bool:
        if self._victim is None:
            self._is_over.set()
            return True
        self._victim.pause()
        threading.Timer(self._frozen_s, self._resume, [self._victim]).start()
        return False

    def _resume(self, victim: ServiceProcess) -> None:
        victim.resume()
        self._is_over.set()

    def wait_over(self) -> None:
        assert self._is_over.wait(SETTLED_S), self.description


class LeasedLoad(QueueLoad):
    """Keeps the leases of the latest messages, and acks the older ones. No leased message comes again."""

    def __init__(self, queue: Any) -> None:
        self._leased: deque[tuple[int, Any]] = deque()
        super().__init__(queue)

    def _takes(self) -> None:
        while not self._is_over.is_set():
            message = self._taken()
            if message is not None:
                number = int(message.payload)
                if any(number == leased for leased, _ in self._leased):
                    self.failures.append(f"{number} came again while it was leased")
                self._leased.append((number, message))
            while len(self._leased) > (0 if self._has_put_all.is_set() else LEASED_MAX):
                self._ack(*self._leased.popleft())


def wait_for_acks(load: Producer | LeasedLoad) -> None:
    """Wait until some further puts are acknowledged."""
    count = len(load.acknowledged)
    wait_until(lambda: len(load.acknowledged) > count + 20, "puts go on")


@pytest.mark.timeout(300)
@pytest.mark.parametrize("seed", SEEDS)
def test_cut_streams_and_frozen_hosts_lose_nothing(cluster: LocalCluster, hosts: RelayedHosts, seed: int) -> None:
    source = random.Random(seed)
    with st.connect(cluster.address, transport="grpc") as rt, ThreadPoolExecutor(2) as pool:
        channel = rt.channel(f"cut-{seed}", max_items=100_000, replicas=1, ack="replica")
        queue = rt.queue(f"cut-{seed}", replicas=1, ack="replica", lease=LEASE)
        wait_until(lambda: len(in_sync(channel.stats().copies)) == 1, "the channel's replica is in sync")
        wait_until(lambda: len(in_sync(queue.stats().replicas)) == 1, "the queue's replica is in sync")
        incarnation, producer, load = queue.incarnation, Producer(channel), LeasedLoad(queue)
        wait_for_acks(load)
        for _ in range(FAULTS_PER_SEED):
            fault, to = Fault(hosts, source), source.choice([name for name in NAMES if name != channel.host])
            moves = pool.submit(try_move, rt, channel, to), pool.submit(moved_queue, rt, queue.name, to)
            fault.wait_over()
            print(fault.description, to, *(one.result(SETTLED_S) or "moved" for one in moves), sep="; ")
            wait_for_acks(load)
            wait_for_acks(producer)
        load.stop()
        producer.stop()
        producer.end_of_reader()
        assert producer.reader_error is None
        check(channel, producer, may_lose=False)
        assert queue.incarnation == incarnation, "the incarnation has changed, although nothing was lost"
