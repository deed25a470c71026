"""kill -9 and SIGSTOP at each step of a move of a channel or queue with a replica: no item or message is lost.

All hosts and supernodes are real processes. `make test` tries some steps. `make kill-moves` tries all, in moves to the
host of the replica and in moves to a host without a copy.
"""

from __future__ import annotations

import itertools
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

import stampede_rt as st
from stampede_rt_local.cluster import LocalCluster
from stampede_rt_local.process import ServiceProcess
from tests.robustness.moves.stepped_host import (
    DESTINATION_STEPS,
    QUEUE_DESTINATION_STEPS,
    QUEUE_SOURCE_STEPS,
    SOURCE_STEPS,
)
from tests.robustness.moves.test_real_processes import (
    FROZEN_S,
    READY_S,
    SETTLED_S,
    Hosts,
    Producer,
    start_again,
    try_move,
    victim_of,
)
from tests.support.cluster import cluster_fixture
from tests.support.waiting import wait_until

cluster = cluster_fixture(hosts=0, supernodes=3)
EVERY_STEP = bool(os.environ.get("STAMPEDE_EVERY_STEP"))
TO_REPLICA, TO_OTHER_HOST = "to the replica", "to a host without a copy"
STEPS = [*DESTINATION_STEPS, *SOURCE_STEPS]
QUEUE_STEPS = [*QUEUE_DESTINATION_STEPS, *QUEUE_SOURCE_STEPS]
VICTIMS, FAULTS = ("source", "destination", "leader"), ("kill", "stop")
SHORT_OF_CHANNELS = [("destination", "kill", "destination: is the owner", TO_REPLICA)]
SHORT_OF_QUEUES = [("destination", "kill", "destination: owns the queue", TO_REPLICA)]
HELD_MAX = 50
Case = tuple[str, str, str, str]


def cases(steps: list[str], short: list[Case]) -> list[Case]:
    return [*itertools.product(VICTIMS, FAULTS, steps, (TO_REPLICA, TO_OTHER_HOST))] if EVERY_STEP else short


@pytest.fixture(scope="module")
def hosts(cluster: LocalCluster, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Hosts]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", str(Path(__file__).parents[3]))  # where the host's program is
        made = Hosts(cluster, tmp_path_factory.mktemp("plans"), ("left", "middle", "right"))
        made.ready()
        yield made
    for one in made.processes.values():
        print(f"--- {one.name}", *one.last_lines, sep="\n")
        one.kill()


class QueueLoad:
    """Puts each number until the put is acknowledged, and takes and acks all messages meanwhile.

    Waits while more than HELD_MAX messages are in the queue. On a busy machine two calls for each message take longer
    than one put, and then the queue would become longer during the whole move.
    """

    def __init__(self, queue: Any) -> None:
        self.put: list[int] = []
        self.acked: set[int] = set()
        self.perhaps_acked: set[int] = set()
        self.failures: list[str] = []
        self._queue = queue
        self._has_put_all, self._is_over = threading.Event(), threading.Event()
        self._threads = [threading.Thread(target=one, daemon=True) for one in (self._puts, self._takes)]
        for one in self._threads:
            one.start()

    def _puts(self) -> None:
        number = 0
        while not self._has_put_all.wait(0.002):
            if len(self.put) - len(self.acked | self.perhaps_acked) > HELD_MAX:
                continue
            try:
                self._queue.put(b"%d" % number, timeout=2, message_id=str(number))
            except st.StampedeError:
                continue  # the next try has the same id
            self.put.append(number)
            number += 1

    def _takes(self) -> None:
        while not self._is_over.is_set():
            message = self._taken()
            if message is not None:
                self._ack(int(message.payload), message)

    def _taken(self) -> Any:
        try:
            return self._queue.get(timeout=0.5)
        except st.StampedeError:
            return None

    def _ack(self, number: int, message: Any) -> None:
        if number in self.acked:
            self.failures.append(f"{number} came back after its ack")
        try:
            message.ack()
            self.acked.add(number)
        except st.StampedeError:
            self.perhaps_acked.add(number)

    @property
    def acknowledged(self) -> list[int]:
        """The acknowledged puts."""
        return self.put

    def stop(self) -> None:
        """End the puts, and wait until the queue is empty."""
        self._has_put_all.set()
        self._threads[0].join(SETTLED_S)
        wait_until(lambda: self.failures or {*self.put} <= self.acked | self.perhaps_acked, "all messages are taken")
        wait_until(lambda: self._queue.stats().held == 0, "the queue is empty")
        self._is_over.set()
        self._threads[1].join(SETTLED_S)
        assert not self.failures, self.failures


def in_sync(replicas: Any) -> list[bytes]:
    return [one.host_id for one in replicas if one.in_sync]


class Scenario:
    """A move, with a fault at one step. `copies` returns the replicas. `owner` is the name of the first owner."""

    def __init__(self, rt: Any, hosts: Hosts, copies: Callable[[], Any], owner: str) -> None:
        self.rt, self.hosts, self.source = rt, hosts, owner
        wait_until(lambda: len(in_sync(copies())) == 1, "the replica is in sync")
        (there,) = in_sync(copies())
        self.replica = next(one.name for one in rt.hosts() if one.host_id == there)

    def play(self, case: Case, move: Callable[[str], st.StampedeError | None], load: Any) -> None:
        """Move under load, and let the fault happen. Then check that the move ends, and that the load goes on."""
        victim, fault, step, to = case
        others = {*self.hosts.processes} - {self.source, self.replica}
        destination = self.replica if to == TO_REPLICA else others.pop()
        wait_until(lambda: len(load.acknowledged) > 20, "items before the move")
        process = victim_of(self.rt, self.hosts, victim, self.source, destination)
        number = signal.SIGKILL if fault == "kill" else signal.SIGSTOP
        plan = self.hosts.plan(step, process, number, self.source, destination)
        with ThreadPoolExecutor(1) as pool:
            moving = pool.submit(move, destination)
            wait_until(lambda: not plan.exists() or moving.done(), f"the move is at the step {step!r}")
            assert not plan.exists(), moving.result()
            self._resume(victim, fault, process)
            failure = moving.result(SETTLED_S)
        count = len(load.acknowledged)
        wait_until(lambda: len(load.acknowledged) > count + 20, "puts go on")
        load.stop()
        print(*case, "->", failure or "moved")

    def _resume(self, victim: str, fault: str, process: ServiceProcess) -> None:
        if fault == "stop":
            time.sleep(FROZEN_S)
            process.resume()
        elif victim == "leader":
            start_again(process)
            process.wait_ready(READY_S)


@pytest.mark.timeout(300)
@pytest.mark.parametrize("case", cases(STEPS, SHORT_OF_CHANNELS), ids="/".join)
def test_a_channel_with_a_replica_loses_nothing(cluster: LocalCluster, hosts: Hosts, case: Case) -> None:
    hosts.ready()
    with st.connect(cluster.address, transport="grpc") as rt:
        wait_until(lambda: {one.name for one in rt.hosts()} >= {*hosts.processes}, "all hosts are there")
        channel = rt.channel("/".join(case).replace(" ", "-").replace(":", ""), max_items=100_000, replicas=1,
                             ack="replica")  # fmt: skip
        scenario = Scenario(rt, hosts, lambda: channel.stats().copies, channel.host)
        producer = Producer(channel)
        scenario.play(case, lambda to: try_move(rt, channel, to), producer)
        producer.end_of_reader()
        assert producer.reader_error is None
        incarnations = {incarnation for _, incarnation in producer.acknowledged}
        assert len(incarnations) == 1, "the incarnation has changed, although nothing was lost"
        held = [int(item.payload) for item in channel.get(st.OLDEST, st.NEWEST)]
        assert len({*held}) == len(held)
        assert {number for number, _ in producer.acknowledged} | {*producer.seen} <= {*held}


@pytest.mark.timeout(300)
@pytest.mark.parametrize("case", cases(QUEUE_STEPS, SHORT_OF_QUEUES), ids="/".join)
def test_a_queue_with_a_replica_loses_nothing(cluster: LocalCluster, hosts: Hosts, case: Case) -> None:
    hosts.ready()
    with st.connect(cluster.address, transport="grpc") as rt:
        wait_until(lambda: {one.name for one in rt.hosts()} >= {*hosts.processes}, "all hosts are there")
        name = "/".join(case).replace(" ", "-").replace(":", "")
        queue = rt.queue(name, replicas=1, ack="replica", lease="3s")
        owner = next(one.host for one in rt.queues() if one.name == name)
        scenario, incarnation = Scenario(rt, hosts, lambda: queue.stats().replicas, owner), queue.incarnation
        scenario.play(case, lambda to: moved_queue(rt, name, to), QueueLoad(queue))
        assert queue.incarnation == incarnation, "the incarnation has changed, although nothing was lost"


def moved_queue(rt: Any, name: str, destination: str) -> st.StampedeError | None:
    try:
        rt.move_queue(name, destination, timeout="40s")
    except st.StampedeError as error:
        return error
    return None
