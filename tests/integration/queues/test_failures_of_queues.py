"""Queues through failures: takers, hosts and supernodes that die, streams that break."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Callable
from typing import Any, TypeVar

import pytest

import stampede_rt as st
from stampede_rt_local.cluster import LocalCluster
from tests.support.cluster import cluster_fixture
from tests.support.processes import started
from tests.support.sharing.shared_cluster import shared_cluster_fixture

Result = TypeVar("Result")
cluster = shared_cluster_fixture(hosts=1)
fragile = cluster_fixture(hosts=2, supernodes=3, scope="function")

TAKE_AND_HOLD = """
import sys
import stampede_rt as st
with st.connect(sys.argv[1]) as rt:
    message = rt.queue(sys.argv[2], prefetch=5).get(timeout=10)
    print(message.payload.decode(), flush=True)
    sys.stdin.read()
"""


def killed_taker(address: str, queue: str) -> str:
    """The payload that a process took before it was killed."""
    command = [sys.executable, "-c", TAKE_AND_HOLD, address, queue]
    with started(command) as process:
        assert process.stdout is not None
        return process.stdout.readline().strip()


def taken(queue: st.Queue, count: int) -> list[tuple[bytes, int]]:
    """Take and acknowledge the next messages. Returns their payloads and the numbers of their deliveries."""
    found = []
    for _ in range(count):
        message = queue.get(timeout=20)
        assert message is not None
        message.ack()
        found.append((message.payload, message.deliveries))
    return found


def test_no_message_is_lost_when_a_taker_is_killed(cluster: LocalCluster) -> None:
    with st.connect(cluster.address) as rt:
        queue = rt.queue("work/killed", lease="1s")
        for number in range(4):
            queue.put(str(number).encode())
        assert killed_taker(cluster.address, "work/killed") == "0"
        # The longer lease is for later deliveries, so that their acks are in time even on a slow machine.
        queue.configure(lease="60s")
        while queue.stats().policy.lease_nanos != 60 * 10**9:
            assert queue.stats().held == 4
        found = taken(queue, 4)
        assert sorted(payload for payload, _ in found) == [b"0", b"1", b"2", b"3"]
        assert dict(found)[b"0"] == 2
        stats = queue.stats()
        assert (stats.consumed, stats.held) == (4, 0)


def test_threads_that_share_a_handle_get_each_message_once(cluster: LocalCluster) -> None:
    with st.connect(cluster.address) as rt, rt.queue("work/shared", prefetch=8) as queue:
        found: list[bytes] = []

        def work() -> None:
            for message in queue:
                with message:
                    found.append(message.payload)

        workers = [threading.Thread(target=work) for _ in range(4)]
        for worker in workers:
            worker.start()
        for number in range(200):
            queue.put(str(number).encode())
        while queue.stats().consumed < 200:
            assert any(worker.is_alive() for worker in workers)
        queue.close()
        for worker in workers:
            worker.join(10)
        assert sorted(found, key=int) == [str(number).encode() for number in range(200)]


def test_a_process_ends_even_if_it_does_not_close_its_connection(cluster: LocalCluster) -> None:
    code = (
        "import sys, threading, stampede_rt as st\n"
        "rt = st.connect(sys.argv[1], name='careless')\n"
        "queue = rt.queue('work/careless')\n"
        "threading.Thread(target=queue.get, daemon=True).start()\n"
        "while not queue.stats().waiting_gets: pass\n"
        "rt.channel('careless').on_item(print)\n"
    )
    done = subprocess.run([sys.executable, "-c", code, cluster.address], capture_output=True, text=True, timeout=30)
    assert done.returncode == 0, done.stderr


def test_an_interrupt_ends_a_get_that_waits(cluster: LocalCluster) -> None:
    # The signal goes to the thread that sends it, and does not wake the main thread. But only the main thread can run
    # the handler.
    code = (
        "import signal, sys, threading, stampede_rt as st\n"
        "rt = st.connect(sys.argv[1])\n"
        "queue = rt.queue('work/interrupted')\n"
        "def interrupt():\n"
        "    while not queue.stats().waiting_gets: pass\n"
        "    signal.pthread_kill(threading.get_ident(), signal.SIGINT)\n"
        "threading.Thread(target=interrupt).start()\n"
        "try:\n"
        "    queue.get()\n"
        "except KeyboardInterrupt:\n"
        "    while queue.stats().waiting_gets: pass\n"
        "    queue.put(b'x')\n"
        "    print(queue.get(timeout=10).deliveries)\n"
        "    rt.close()\n"
    )
    done = subprocess.run([sys.executable, "-c", code, cluster.address], capture_output=True, text=True, timeout=120)
    assert (done.stdout, done.returncode) == ("1\n", 0), done.stderr


def owner(cluster: LocalCluster, queue: st.Queue) -> Any:
    return next(host for host in cluster.hosts if queue.host in host.name or host.name in queue.host)


def in_the_end(call: Callable[[], Result]) -> Result:
    """The result of `call` once the host is replaced, however long that takes on a busy machine."""
    while True:
        try:
            return call()
        except (st.Unavailable, st.DeadlineExceeded):
            continue


def test_a_queue_of_a_lost_host_is_reopened_elsewhere_as_a_new_incarnation(fragile: LocalCluster) -> None:
    with st.connect(fragile.address) as rt:
        queue = rt.queue("work/lost", lease="60s")
        queue.put(b"lost with its host")
        held = queue.get(timeout=10)
        before = queue.info
        found: list[st.Message | None] = []
        waiting = threading.Thread(target=lambda: found.append(in_the_end(queue.get)))
        waiting.start()
        while queue.stats().waiting_gets != 1:
            assert waiting.is_alive()
        owner(fragile, queue).kill()
        assert held is not None
        with pytest.raises(st.LeaseExpired):
            in_the_end(held.ack)
        other = in_the_end(lambda: rt.queue("work/lost"))
        in_the_end(lambda: other.put(b"new life", message_id="new life"))
        waiting.join()
        assert [message.payload for message in found if message] == [b"new life"]
        assert other.info.queue_id == before.queue_id
        assert (other.host, other.incarnation) != (before.host, before.incarnation)
        with pytest.raises(st.LeaseExpired):
            held.ack()


def test_supernodes_that_are_lost_disturb_no_bound_queue(fragile: LocalCluster) -> None:
    with st.connect(fragile.address, name="steady") as rt:
        queue = rt.queue("work/bound")
        queue.put(b"1")
        rt.send("steady", b"1")
        for supernode in fragile.supernodes:
            supernode.kill()
        queue.put(b"2")
        assert [payload for payload, _ in taken(queue, 2)] == [b"1", b"2"]
        message = rt.mailbox.get(timeout=10)
        assert message is not None
        message.ack()
        for supernode in fragile.supernodes:
            supernode.restart()
        assert "work/bound" in {info.name for info in rt.queues()}
