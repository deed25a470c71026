"""Queues with replicas, between real processes: owners and replicas that are killed or frozen under load."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

import stampede_rt as st
from stampede_rt_local.cluster import LocalCluster
from tests.integration.proxies.readers import eventually
from tests.integration.replicas.test_replicas import frozen, host_of


@pytest.fixture
def cluster(three_hosts: LocalCluster) -> LocalCluster:
    return three_hosts


class Load:
    """A producer and two takers. Each message has a number; the takers acknowledge every message."""

    def __init__(self, address: str) -> None:
        self.put: list[int] = []  # acknowledged puts
        self.acked: list[int] = []  # messages whose acknowledgement has succeeded
        self.came_back: list[int] = []  # deliveries after such an acknowledgement
        self.errors: list[BaseException] = []
        self._address = address
        self._is_over = threading.Event()
        self._has_put_all = threading.Event()
        self._threads = [
            threading.Thread(target=self._guard, args=(work,)) for work in (self._puts, *[self._takes] * 2)
        ]

    def start(self) -> None:
        for thread in self._threads:
            thread.start()

    def stop(self) -> None:
        """End the puts, wait until the takers have all messages, and end them."""
        self._has_put_all.set()
        self._threads[0].join()
        eventually(lambda: self.errors or {*self.put} <= {*self.acked}, "the takers have all messages")
        self._is_over.set()
        for thread in self._threads:
            thread.join()
        assert not self.errors, self.errors
        assert not self.came_back

    def wait_for_puts(self, count: int) -> None:
        goal = len(self.acked) + count
        eventually(lambda: self.errors or len(self.acked) >= goal, f"{count} more messages pass")

    def _guard(self, work: Any) -> None:
        try:
            with st.connect(self._address, transport="grpc") as rt:
                work(rt.queue("jobs", create=False))
        except Exception as error:  # noqa: BLE001  # the test shows it
            self.errors.append(error)

    def _puts(self, queue: Any) -> None:
        number = 0
        while not self._has_put_all.is_set():
            queue.put(b"%d" % number)
            self.put.append(number)
            number += 1

    def _takes(self, queue: Any) -> None:
        while not self._is_over.is_set():
            message = queue.get(timeout=0.2)
            if message is not None:
                number = int(message.payload)
                if number in self.acked:
                    self.came_back.append(number)
                message.ack()
                self.acked.append(number)


@contextmanager
def load(cluster: LocalCluster) -> Iterator[Load]:
    running = Load(cluster.address)
    running.start()
    try:
        yield running
    finally:
        running._has_put_all.set()
        running._is_over.set()


def opened(rt: Any, replicas: int = 1, **policy: Any) -> Any:
    """The queue. A message that was on its way to its taker when the owner died comes again when its lease ends."""
    return rt.queue("jobs", host="h1", replicas=replicas, ack="replica", lease="5s", **policy)


def in_sync(queue: Any) -> list[bytes]:
    return [one.host_id for one in queue.stats().replicas if one.in_sync]


def owner_of(rt: Any) -> str:
    return str(next(one.host for one in rt.queues() if one.name == "jobs"))


@pytest.mark.parametrize(("feeds", "replicas"), [("tcp", 1), ("grpc", 2)], indirect=["feeds"])
def test_no_acknowledged_put_is_lost_and_no_settled_message_is_repeated_when_the_owner_is_killed(
    cluster: LocalCluster, replicas: int
) -> None:
    with st.connect(cluster.address, transport="grpc") as rt:
        queue = opened(rt, replicas)
        eventually(lambda: len(in_sync(queue)) == replicas, "the replicas are in sync")
        incarnation = queue.incarnation
        for message in (b"0", bytes(1_500_000)):  # larger than any message between hosts
            assert queue.put(message).copies == replicas + 1
            queue.get(timeout=5).ack()
        queue.put(b"1000000")
        leased = queue.get(timeout=5)
        leased.extend("10m")  # the message stays leased while the owner dies
        with load(cluster) as running:
            running.wait_for_puts(50)
            cluster.hosts[0].kill()
            running.wait_for_puts(50)
            running.stop()
        leased.ack()
        assert queue.incarnation == incarnation
        assert owner_of(rt) in ("h2", "h3")
        assert queue.stats().held == 0
        eventually(lambda: len(in_sync(queue)) >= 1, "the owner has a replica")


@pytest.mark.parametrize("feeds", ["socket"], indirect=True)
def test_a_frozen_owner_is_replaced_by_one_owner_and_nothing_is_lost(cluster: LocalCluster) -> None:
    with st.connect(cluster.address, transport="grpc") as rt:
        queue = opened(rt)
        eventually(lambda: len(in_sync(queue)) == 1, "the replica is in sync")
        with load(cluster) as running:
            running.wait_for_puts(50)
            with frozen(cluster.hosts[0]):
                running.wait_for_puts(50)
            running.wait_for_puts(50)
            running.stop()
        assert owner_of(rt) != "h1"
        assert queue.stats().held == 0


@pytest.mark.parametrize(("feeds", "how"), [("socket", "killed"), ("tcp", "frozen")], indirect=["feeds"])
def test_a_queue_gets_another_replica_when_one_is_lost(cluster: LocalCluster, how: str) -> None:
    with st.connect(cluster.address, transport="grpc") as rt:
        queue = opened(rt)
        eventually(lambda: len(in_sync(queue)) == 1, "the replica is in sync")
        (lost,) = in_sync(queue)
        process = host_of(cluster, rt, lost)
        with load(cluster) as running:
            running.wait_for_puts(50)
            if how == "killed":
                process.kill()
                running.wait_for_puts(50)
                eventually(lambda: in_sync(queue) not in ([], [lost]), "another host has the replica")
            else:
                with frozen(process):
                    eventually(lambda: lost not in in_sync(queue), "the directory lists the replica as out of sync")
                running.wait_for_puts(50)
            running.stop()
        assert owner_of(rt) == "h1"


def test_a_queue_moves_with_its_replicas_and_the_hosts_change_places(cluster: LocalCluster) -> None:
    with st.connect(cluster.address, transport="grpc") as rt:
        queue = opened(rt)
        eventually(lambda: len(in_sync(queue)) == 1, "the replica is in sync")
        (there,) = in_sync(queue)
        name = next(one.name for one in rt.hosts() if one.host_id == there)
        with load(cluster) as running:
            running.wait_for_puts(50)
            rt.move_queue("jobs", name)
            running.wait_for_puts(50)
            replica = in_sync(queue)
            cluster.hosts[int(name[1:]) - 1].kill()
            running.wait_for_puts(50)
            running.stop()
        assert len(replica) == 1
        assert owner_of(rt) == "h1"


def test_a_queue_without_enough_replicas_delivers_and_acknowledges_nothing(cluster: LocalCluster) -> None:
    with st.connect(cluster.address, transport="grpc") as rt:
        queue = opened(rt, 2, min_replicas=2)
        eventually(lambda: len(in_sync(queue)) == 2, "the replicas are in sync")
        queue.put(b"before")
        process = host_of(cluster, rt, in_sync(queue)[0])
        process.kill()
        with pytest.raises(st.NotReplicated):
            queue.put(b"after", timeout=0.5)
        assert queue.get(timeout=0.5) is None
        queue.configure(min_replicas=1)
        message = queue.get(timeout=30)
        assert (message.payload, message.deliveries) == (b"before", 1)
        message.ack()
