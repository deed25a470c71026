"""kill -9 and SIGSTOP of the source, the destination and the directory's leader at each step of a move.

All hosts and supernodes are real processes. `make test` tries some steps. `make kill-moves` tries all.
"""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

import stampede_rt as st
from stampede_rt_local.cluster import LocalCluster
from stampede_rt_local.process import ServiceProcess
from tests.robustness.moves.stepped_host import DESTINATION_STEPS, SOURCE_STEPS
from tests.support.cluster import cluster_fixture
from tests.support.waiting import wait_until

cluster = cluster_fixture(hosts=0, supernodes=3)
EVERY_STEP = bool(os.environ.get("STAMPEDE_EVERY_STEP"))
READY_S, FROZEN_S, SETTLED_S = 40.0, 8.0, 60.0  # FROZEN_S is longer than a lease
STEPS = [*DESTINATION_STEPS, *SOURCE_STEPS]
SHORT = [
    ("destination", "kill", "destination: is the owner"),
    ("source", "stop", "source: has handed over"),
    ("leader", "kill", "destination: has everything"),
]
ALL = [
    (victim, fault, step)
    for victim in ("source", "destination", "leader")
    for fault in ("kill", "stop")
    for step in STEPS
]
LATE = ("destination: has removed the fallback", "destination: releases the source", "source: is released")


class Hosts:
    """Some hosts. The plan of each is a file with a step, a signal and a process. A test's channel is at `source`."""

    def __init__(self, cluster: LocalCluster, folder: Path, names: Sequence[str] = ("left", "right")) -> None:
        self.cluster, self.folder = cluster, folder
        self.processes = {name: self._made(name) for name in names}

    def _made(self, name: str) -> ServiceProcess:
        words = ["--plan", str(self.folder / name), "--listen", "localhost:0", "--name", name, "--drain-seconds", "0"]
        words += ["--frontend", self.cluster.address, "--secret-file", str(self.cluster.secret_file)]
        process = ServiceProcess(f"host {name}", "tests.robustness.moves.stepped_host", words)
        process.start()
        return process

    def ready(self) -> None:
        """Start the killed processes again, and wait until all are ready."""
        for one in self.processes.values():
            if not one.alive:
                start_again(one)
        for one in self.processes.values():
            one.wait_ready(READY_S)

    def plan(self, step: str, victim: ServiceProcess, number: signal.Signals, source: str, destination: str) -> Path:
        """Plan a signal to the victim at this step of the move. Returns the file. The host removes it at that step."""
        plan = self.folder / (source if step.startswith("source") else destination)
        plan.write_text(f"{step}|{victim.pid}|{int(number)}")
        return plan


def start_again(process: ServiceProcess) -> None:
    """Start a process again that another process has killed."""
    process.kill()  # waits for the end of the former run
    process.start()


@pytest.fixture(scope="module")
def hosts(cluster: LocalCluster, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Hosts]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", str(Path(__file__).parents[3]))  # where the host's program is
        made = Hosts(cluster, tmp_path_factory.mktemp("plans"))
        made.ready()
        yield made
    for one in made.processes.values():
        print(f"--- {one.name}", *one.last_lines, sep="\n")
        one.kill()


class Producer:
    """Puts each number once, and notes the acknowledged ones. A thread reads the channel meanwhile."""

    def __init__(self, channel: Any) -> None:
        self.acknowledged: list[tuple[int, int]] = []  # with the incarnation
        self.seen: list[int] = []
        self.reader_error: st.StampedeError | None = None
        self._channel, self._subscription = channel, channel.subscribe(st.OLDEST)
        self._stopped = threading.Event()
        self._threads = [threading.Thread(target=one, daemon=True) for one in (self._put, self._read)]
        for one in self._threads:
            one.start()

    def _put(self) -> None:
        number = 0
        while not self._stopped.wait(0.002):
            number += 1
            try:
                item = self._channel.put(b"%d" % number, timeout=2)
            except st.StampedeError:
                continue  # the test does not know whether the host accepted the item
            self.acknowledged.append((number, item.incarnation))

    def _read(self) -> None:
        try:
            for item in self._subscription:
                self.seen.append(int(item.payload))
        except st.StampedeError as error:
            self.reader_error = error

    def stop(self) -> None:
        self._stopped.set()
        self._threads[0].join(SETTLED_S)
        assert not self._threads[0].is_alive(), "a put is stuck"

    def end_of_reader(self) -> None:
        """Check that the reader is not stuck: it has the last acknowledged item, or it got IncarnationLost."""
        last = self.acknowledged[-1][0]
        wait_until(lambda: self.reader_error is not None or last in self.seen[-1:], "the reader has everything")
        self._subscription.close()
        assert self.reader_error is None or isinstance(self.reader_error, st.IncarnationLost), self.reader_error
        assert len(set(self.seen)) == len(self.seen), "the reader got an item twice"


def victim_of(rt: Any, hosts: Hosts, victim: str, source: str, destination: str) -> ServiceProcess:
    if victim != "leader":
        return hosts.processes[source if victim == "source" else destination]
    leader = next(one.supernode_id for one in rt.supernodes() if one.is_leader)
    return next(one for one in hosts.cluster.supernodes if one.name.endswith(leader))


def may_lose(victim: str, step: str) -> bool:
    """Whether the victim is the only host with the items at that step.

    If the victim dies then, its items are lost, as with any owner without a replica.
    """
    if victim == "source":
        return step in (*STEPS[:3], *SOURCE_STEPS)  # the source may still be the owner
    return victim == "destination" and step in (*LATE, "destination: tells the source", "source: learns of the commit")


@pytest.mark.timeout(300)
@pytest.mark.parametrize(("victim", "fault", "step"), ALL if EVERY_STEP else SHORT)
def test_a_move_leaves_one_owner_and_loses_nothing_if_a_process_dies_or_freezes(
    cluster: LocalCluster, hosts: Hosts, victim: str, fault: str, step: str
) -> None:
    hosts.ready()
    with st.connect(cluster.address, transport="grpc") as rt, ThreadPoolExecutor(1) as pool:
        wait_until(lambda: {one.name for one in rt.hosts()} >= {*hosts.processes}, "both hosts are there")
        channel = rt.channel(f"{victim}/{fault}/{STEPS.index(step)}", max_items=100_000)
        source = channel.host
        destination = next(name for name in hosts.processes if name != source)
        process = victim_of(rt, hosts, victim, source, destination)
        producer = Producer(channel)
        wait_until(lambda: len(producer.acknowledged) > 20, "items before the move")
        number = signal.SIGKILL if fault == "kill" else signal.SIGSTOP
        plan = hosts.plan(step, process, number, source, destination)
        move = pool.submit(try_move, rt, channel, destination)
        wait_until(lambda: not plan.exists() or move.done(), f"the move is at the step {step!r}")
        assert not plan.exists(), move.result()
        if fault == "stop":
            time.sleep(FROZEN_S)
            process.resume()
        elif victim == "leader":
            start_again(process)
            process.wait_ready(READY_S)
        failure = move.result(SETTLED_S)
        count = len(producer.acknowledged)
        wait_until(lambda: len(producer.acknowledged) > count + 20, "puts go on")
        producer.stop()
        producer.end_of_reader()
        check(channel, producer, may_lose=may_lose(victim, step))
        print(victim, fault, step, "->", failure or "moved")


def try_move(rt: Any, channel: Any, destination: str) -> st.StampedeError | None:
    """Move the channel. Returns the error if the move fails."""
    try:
        rt.move(channel, destination, timeout="40s")
    except st.StampedeError as error:
        return error
    return None


def check(channel: Any, producer: Producer, *, may_lose: bool) -> None:
    """Check that the owner has every acknowledged item once; after a loss, only those of the new incarnation."""
    incarnations = {incarnation for _, incarnation in producer.acknowledged}
    assert len(incarnations) == 1 or (may_lose and len(incarnations) == 2), incarnations
    last = producer.acknowledged[-1][1]
    held = [int(item.payload) for item in channel.get(st.OLDEST, st.NEWEST)]
    assert len(set(held)) == len(held)
    assert {number for number, incarnation in producer.acknowledged if incarnation == last} <= set(held)
