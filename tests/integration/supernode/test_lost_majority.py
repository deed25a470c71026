"""The errors of callers that need the directory when most supernodes are gone, and the log lines of the services."""

from __future__ import annotations

import re
import threading
import time
from typing import Any

import pytest

import stampede_rt as st
from stampede_rt._sync.directory_client import DirectoryClient
from stampede_rt.cli.main import main as stampede
from stampede_rt_local.cluster import LocalCluster
from tests.support.cluster import running_cluster

PATIENCE_SECONDS = 30.0
LOST, FOUND = "no supernode can serve this front-end", "the directory can serve"


def lines_of(cluster: LocalCluster, words: str) -> int:
    """The number of lines of front-ends and hosts with these words."""
    return sum(words in line for service in (*cluster.frontends, *cluster.hosts) for line in service.last_lines)


def wait_for(cluster: LocalCluster, words: str, *, more_than: int) -> None:
    """Wait until a front-end or host has logged the words once more."""
    deadline, pause = time.monotonic() + PATIENCE_SECONDS, threading.Event()
    while lines_of(cluster, words) <= more_than:
        assert time.monotonic() < deadline, words
        pause.wait(0.05)


@pytest.fixture
def short_calls(monkeypatch: pytest.MonkeyPatch) -> None:
    """A call that no supernode can answer gives up after four seconds instead of ten."""
    call = DirectoryClient.call

    def within(self: DirectoryClient, method: str, request: Any, timeout_s: float, **more: Any) -> Any:
        return call(self, method, request, min(timeout_s, 4.0), **more)

    monkeypatch.setattr(DirectoryClient, "call", within)


@pytest.mark.usefixtures("short_calls")
def test_without_a_majority_errors_name_the_reason_and_doctor_does_not_judge_clocks(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with running_cluster(hosts=1, supernodes=3) as cluster:
        with st.connect(cluster.address) as rt:
            rt.channel("cam", max_age="10s").put(b"before")
            before = {words: lines_of(cluster, words) for words in (LOST, FOUND)}
            for supernode in cluster.supernodes[1:]:
                supernode.kill()
            with pytest.raises(st.Unavailable) as raised:
                rt.channel("another", max_age="10s")
        assert re.match("the directory has no majority: [01] of 3 supernodes answer, 2 must", str(raised.value))
        assert "is the address right" not in str(raised.value)
        assert stampede(["ls", "--url", cluster.address]) == 1
        error_output = capsys.readouterr().err
        # On a busy machine, the front-end may not have got the last supernode's answer in time.
        assert "the directory has no majority" in error_output or "no supernode answers this front-end" in error_output
        member = cluster.supernodes[0].address
        assert stampede(["doctor", "--url", cluster.address, "--member", member]) == 1
        printed = capsys.readouterr().out
        assert "the directory has no majority and refuses all changes" in printed
        assert "synchronise" not in printed
        [clocks] = [line for line in printed.splitlines() if line.startswith("clocks ")]
        assert clocks.split()[2] in ("0", "unknown:") or clocks.split()[3] in ("us", "ms", "ns")
        for words in ("the lease could not be renewed", LOST):
            wait_for(cluster, words, more_than=before.get(words, 0))
        cluster.supernodes[1].restart()
        for words in ("the lease is renewed again", FOUND):
            wait_for(cluster, words, more_than=before.get(words, 0))
