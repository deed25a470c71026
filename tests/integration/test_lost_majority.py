"""What those hear who need the directory when most of its supernodes are gone, and what the services log of it."""

from __future__ import annotations

import threading
import time

import pytest

import stampede_rt as st
from stampede_rt.cli.main import main as stampede
from stampede_rt_local.cluster import LocalCluster
from tests.support.cluster import running_cluster

pytestmark = pytest.mark.timeout(120)


PATIENCE_SECONDS = 30.0


def wait_for_line(cluster: LocalCluster, words: str) -> None:
    """Until a front-end or host has logged it."""
    deadline, pause = time.monotonic() + PATIENCE_SECONDS, threading.Event()
    services = [*cluster.frontends, *cluster.hosts]
    while not any(words in line for service in services for line in service.last_lines):
        assert time.monotonic() < deadline, words
        pause.wait(0.05)


def test_without_a_majority_callers_hear_just_that_and_doctor_leaves_the_clocks_alone(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with running_cluster(hosts=1, supernodes=3) as cluster:
        with st.connect(cluster.address) as rt:
            rt.channel("cam", max_age="10s").put(b"before")
            for supernode in cluster.supernodes[1:]:
                supernode.kill()
            with pytest.raises(st.Unavailable) as raised:
                rt.channel("another", max_age="10s")
        assert str(raised.value).startswith("the directory has no majority: 1 of 3 supernodes answer, 2 must")
        assert "is the address right" not in str(raised.value)
        assert stampede(["ls", "--url", cluster.address]) == 1
        assert "the directory has no majority" in capsys.readouterr().err
        assert stampede(["doctor", "--url", cluster.address]) == 1
        told = capsys.readouterr().out
        assert "the directory has no majority and refuses all changes" in told
        assert "synchronise" not in told
        [clocks] = [line for line in told.splitlines() if line.startswith("clocks ")]
        assert clocks.split()[2] in ("0", "unknown:") or clocks.split()[3] in ("us", "ms", "ns")
        for words in ("lease not renewed", "no supernode can serve"):
            wait_for_line(cluster, words)
        cluster.supernodes[1].restart()
        for words in ("lease renewed again", "the directory can serve"):
            wait_for_line(cluster, words)
        logged = [line for service in (*cluster.frontends, *cluster.hosts) for line in service.last_lines]
        for words in ("no supernode can serve", "lease renewed again"):
            assert sum(words in line for line in logged) == 1, logged
