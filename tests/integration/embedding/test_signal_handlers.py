"""Signal handlers that read and put while the program puts into the host of its own process."""

from __future__ import annotations

import subprocess
import sys

import pytest

from stampede_rt_local.cluster import LocalCluster
from tests.support.sharing.shared_cluster import shared_cluster_fixture

pytestmark = pytest.mark.without_rules("a client token cannot host channels")
cluster = shared_cluster_fixture(hosts=1)
LIMIT_S = 60

PROGRAM = """
import signal, sys, stampede_rt as st
SIGNALS = 600
with st.host(sys.argv[1], name="signalled", drain="0s") as rt:
    channel, other = (rt.channel(f"signalled/{name}", max_items=100) for name in ("items", "other"))
    other.put(b"first")
    with channel.producer() as producer:
        producer.put(b"first")
        producer.flush()
        refused = handled = count = 0

        def handle(number, frame):
            global handled, refused
            handled += 1
            assert other.newest().payload and channel.newest().payload
            if handled % 20 == 0:
                other.put(b"later")
            try:
                producer.put(b"from the handler")
            except st.DeadlineExceeded as error:
                assert "interrupts another call" in str(error), error
                refused += 1
            if handled < SIGNALS:
                signal.setitimer(signal.ITIMER_REAL, 0.0003)

        signal.signal(signal.SIGALRM, handle)
        signal.setitimer(signal.ITIMER_REAL, 0.0003)
        while handled < SIGNALS:
            producer.put(b"%d" % count if count % 3 else bytes(100_000))
            count += 1
        producer.flush()
    assert producer.accepted == channel.stats().accepted == 1 + count + handled - refused
    print("all are there", flush=True)
"""


def test_a_signal_handler_reads_and_puts_while_its_thread_is_in_a_put(cluster: LocalCluster) -> None:
    """In an earlier version, the program hung.

    The interrupted put held the producer's lock, the host waited for this lock, and the handler waited for the host.
    """
    run = subprocess.run(
        [sys.executable, "-c", PROGRAM, cluster.address], stdout=subprocess.PIPE, timeout=LIMIT_S, check=True
    )
    assert run.stdout == b"all are there\n"
