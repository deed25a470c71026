"""Moves of queues between real processes, while they are in use (paper, section 3.5)."""

from __future__ import annotations

import itertools
import json
import threading
from collections.abc import Iterator
from typing import Any

import pytest

import stampede_rt as st
from stampede_rt.cli.commands import run
from stampede_rt_local.cluster import LocalCluster
from tests.support.cluster import cluster_fixture, drained
from tests.support.waiting import wait_until

cluster = cluster_fixture(hosts=2, supernodes=1)
numbers = itertools.count()
MOVES = 6


@pytest.fixture
def rt(cluster: LocalCluster) -> Iterator[Any]:
    with st.connect(cluster.address, transport="grpc") as made:
        yield made


def host_of(rt: Any, name: str) -> str:
    return next(one.host for one in rt.queues(name))


def test_a_moved_queue_has_its_messages_its_leases_and_its_counters(rt: Any) -> None:
    queue = rt.queue(f"jobs/{next(numbers)}", host="h1", lease="60s")
    for number in range(5):
        queue.put(b"%d" % number)
    first, second = queue.get(timeout=5), queue.get(timeout=5)
    moved = rt.move_queue(queue.name, "h2")
    assert (moved.channel, moved.host, moved.held) == (queue.name, "h2", 5)
    assert moved.blackout_nanos > 0
    assert host_of(rt, queue.name) == "h2"
    first.ack()
    second.nack()
    assert sorted(queue.get(timeout=5).payload for _ in range(4)) == [b"1", b"2", b"3", b"4"]
    stats = queue.stats()
    assert (stats.accepted, stats.consumed, stats.held, stats.leased) == (5, 1, 4, 4)
    assert queue.put(b"5").seq == 6


def test_a_queue_does_not_move_to_its_own_host_and_a_missing_queue_is_reported(rt: Any) -> None:
    queue = rt.queue(f"jobs/{next(numbers)}", host="h1")
    queue.put(b"x")
    assert rt.move_queue(queue.name, "h1").blackout_nanos == 0
    with pytest.raises(st.QueueNotFound, match="no queue 'none'"):
        rt.move_queue("none", "h1")
    with pytest.raises(st.HostNotFound, match="no live host 'h9'"):
        rt.move_queue(queue.name, "h9")


def test_the_command_moves_a_queue(rt: Any, cluster: LocalCluster, capsys: pytest.CaptureFixture[str]) -> None:
    queue = rt.queue(f"jobs/{next(numbers)}", host="h1")
    queue.put(b"x")
    assert run(["move", "--queue", queue.name, "h2", "-o", "json", "--url", cluster.address]) == 0
    moved = json.loads(capsys.readouterr().out)
    assert (moved["queue"], moved["held"]) == (queue.name, 1)
    assert queue.get(timeout=5).payload == b"x"


def test_moves_in_a_row_under_load_neither_lose_nor_repeat_messages(rt: Any) -> None:
    queue = rt.queue(f"jobs/{next(numbers)}", host="h1", lease="60s")
    stopped, put, taken = threading.Event(), [], []

    def produce() -> None:
        while not stopped.wait(0.002):
            put.append(queue.put(b"%d" % len(put)).seq)

    def take() -> None:
        while (message := queue.get(timeout=1)) is not None or not stopped.is_set():
            if message is not None:
                taken.append(int(message.payload))
                message.ack()

    threads = [threading.Thread(target=one, daemon=True) for one in (produce, take, take)]
    for thread in threads:
        thread.start()
    for move in range(MOVES):
        passed = len(taken)
        wait_until(lambda passed=passed: len(taken) > passed + 10, "messages pass")  # type: ignore[misc]
        rt.move_queue(queue.name, ("h2", "h1")[move % 2])
    stopped.set()
    for thread in threads:
        thread.join(40)
    assert put == [*range(1, len(put) + 1)]
    assert sorted(taken) == [*range(len(put))]
    assert queue.stats().consumed == len(put)


def test_a_drained_host_has_no_queue_and_no_mailbox(rt: Any, cluster: LocalCluster) -> None:
    queue = rt.queue(f"jobs/{next(numbers)}", host="h1")
    queue.put(b"x")
    names = [f"robot{next(numbers)}" for _ in range(4)]  # the mailboxes of these peers are at both hosts
    robots = [st.connect(cluster.address, name=name, transport="grpc") for name in names]
    try:
        for name in names:
            rt.send(rt.peers(name)[0], name.encode())
        assert drained(cluster, "h1").left == {}
        assert host_of(rt, queue.name) == "h2"
        assert queue.get(timeout=5).payload == b"x"
        assert [robot.mailbox.get(timeout=5).payload for robot in robots] == [name.encode() for name in names]
        rt.send(rt.peers(names[0])[0], b"later")
        assert robots[0].mailbox.get(timeout=5).payload == b"later"
    finally:
        for robot in robots:
            robot.close()
