"""A taker that hangs (SIGSTOP) with its stream open: other takers get its messages until it goes on."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest

import stampede_rt as st
from stampede_rt_local.cluster import LocalCluster
from tests.support.sharing.shared_cluster import shared_cluster_fixture

cluster = shared_cluster_fixture(hosts=1)
TAKER = {
    "sync": """
import sys, stampede_rt as st
with st.connect(sys.argv[1]) as rt:
    for message in rt.queue(sys.argv[2], prefetch=10):
        try:
            message.ack()
        except st.LeaseExpired:
            continue
        print(message.payload.decode(), flush=True)
""",
    "aio": """
import asyncio, sys
from stampede_rt import LeaseExpired, aio
async def main():
    async with await aio.connect(sys.argv[1]) as rt:
        async for message in await rt.queue(sys.argv[2], prefetch=10):
            try:
                await message.ack()
            except LeaseExpired:
                continue
            print(message.payload.decode(), flush=True)
asyncio.run(main())
""",
}


@contextmanager
def taker(client: str, address: str, queue: str) -> Iterator[subprocess.Popen[str]]:
    """A process that takes and acknowledges messages. It prints the messages whose lease it still had."""
    command = [sys.executable, "-c", TAKER[client], address, queue]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        yield process
    finally:
        process.send_signal(signal.SIGCONT)
        process.kill()
        process.communicate(timeout=45)


def until(queue: st.Queue, condition: Callable[[st.QueueStats], bool]) -> None:
    """Ask for the counters until `condition` holds; the test's time limits it."""
    while not condition(queue.stats()):
        pass


@pytest.mark.parametrize("client", ["sync", "aio"])
def test_a_hung_taker_holds_one_message_for_one_lease_and_is_served_again_when_it_continues(
    cluster: LocalCluster, client: str
) -> None:
    name = f"frozen/{client}"
    with st.connect(cluster.address) as rt:
        queue = rt.queue(name, lease="500ms")
        with taker(client, cluster.address, name) as hung:
            until(queue, lambda stats: stats.waiting_gets == 1)
            hung.send_signal(signal.SIGSTOP)
            queue.put(b"first")
            queue.configure(lease="60s")  # this lease is for later deliveries
            until(queue, lambda stats: stats.policy.lease_nanos == 60 * 10**9)
            redelivered = queue.get(timeout=20)
            assert redelivered
            assert (redelivered.payload, redelivered.deliveries) == (b"first", 2)
            assert queue.stats().waiting_gets == 0
            for number in range(5):
                queue.put(b"%d" % number)
                message = queue.get(timeout=20)
                assert message
                assert message.payload == b"%d" % number
                message.ack()
            hung.send_signal(signal.SIGCONT)
            until(queue, lambda stats: stats.waiting_gets == 1)
            queue.put(b"last")
            assert hung.stdout
            assert hung.stdout.readline() == "last\n"
