"""Peers with wrong clocks, as real processes: the commands that report these clocks, also after the loss of the
leader.
"""

from __future__ import annotations

import asyncio
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO

import pytest

import stampede_rt as st
from stampede_rt import aio
from stampede_rt.cli.main import main as stampede
from stampede_rt_local.cluster import LocalCluster
from tests.support.cluster import cluster_fixture
from tests.support.waiting import wait_until

cluster = cluster_fixture(hosts=1, supernodes=3, durable=False)

SECOND = 10**9
PATIENCE_SECONDS = 30.0
# A file sets the offset of the process's wall clock, see service_process. Its other clocks are right.
STAY = """
import sys
from pathlib import Path
from tests.support.service_process import shift_wall_clock
shift_wall_clock(Path(sys.argv[3]))
import stampede_rt as st
with st.connect(sys.argv[1], name=sys.argv[2]) as rt:
    print("in", flush=True)
    sys.stdin.read()
"""


class ClockedPeer:
    """A peer with a wall clock of its own."""

    def __init__(self, cluster: LocalCluster, name: str, file: Path, off_nanos: int) -> None:
        self.name, self._file = name, file
        self.step(off_nanos)
        self._process = subprocess.Popen(
            [sys.executable, "-c", STAY, cluster.address, name, str(file)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        output: IO[str] | None = self._process.stdout
        assert output is not None
        if output.readline() != "in\n":
            self.kill()
            raise AssertionError(f"{name} did not connect")

    def step(self, off_nanos: int) -> None:
        """Set the offset of its wall clock."""
        self._file.write_text(f"{off_nanos:+021}")

    def kill(self) -> None:
        """Kill the process."""
        self._process.kill()
        self._process.communicate()


@pytest.fixture
def start_robot(cluster: LocalCluster, tmp_path: Path) -> Iterator[Callable[[str, int], ClockedPeer]]:
    made: list[ClockedPeer] = []

    def make(name: str, off_nanos: int) -> ClockedPeer:
        made.append(ClockedPeer(cluster, name, tmp_path / str(len(made)), off_nanos))
        return made[-1]

    yield make
    for one in made:
        one.kill()


def is_off(clock: st.ClockOffset | None, nanos: int) -> bool:
    """Whether a clock is known, and its measured offset is `nanos` within the uncertainty."""
    return clock is not None and abs(clock.offset_nanos - nanos) <= clock.uncertainty_nanos


def test_every_leader_reports_the_clock_offset_of_a_peer(
    cluster: LocalCluster, start_robot: Callable[[str, int], ClockedPeer], capsys: pytest.CaptureFixture[str]
) -> None:
    late = start_robot("robot/late", -7200 * SECOND)
    start_robot("robot/gone", 0).kill()
    with st.connect(cluster.address, name="robot/well") as rt:

        def shows_offset(nanos: int) -> bool:
            return is_off(rt.peer(late.name).clock, nanos)

        wait_until(lambda: shows_offset(-7200 * SECOND) and is_off(rt.peer("robot/well").clock, 0))
        assert stampede(["peers", "robot/*", "--url", cluster.address]) == 0
        printed = capsys.readouterr().out
        assert "robot/late: its clock is 2 h behind that of supernode s" in printed, printed
        assert printed.count("synchronise it") == 1, printed
        assert stampede(["doctor", "--url", cluster.address]) == 1
        printed = capsys.readouterr().out
        assert (
            "clocks: the clock of peer robot/late is 2 h behind the others'; synchronise it (chrony, ntpd)" in printed
        ), printed

        late.step(3600 * SECOND)
        wait_until(lambda: shows_offset(3600 * SECOND))
        [leader] = [one for one in rt.supernodes() if one.is_leader]
        [process] = [one for one in cluster.supernodes if one.address == leader.endpoint]
        process.kill()
        wait_until(lambda: shows_offset(3600 * SECOND))
        wait_until(lambda: any(not peer.alive for peer in rt.peers("robot/*", include_dead=True)))
        states = {peer.name: (peer.alive, peer.clock is None) for peer in rt.peers("robot/*", include_dead=True)}
        assert states["robot/gone"] == (False, True)


async def test_the_asyncio_client_reports_the_clock_offset_of_a_peer(
    cluster: LocalCluster, start_robot: Callable[[str, int], ClockedPeer]
) -> None:
    early = start_robot("robot/early", 90 * SECOND)
    async with aio.connect(cluster.address) as rt, asyncio.timeout(PATIENCE_SECONDS):
        while not (known := [peer.clock for peer in await rt.peers(early.name) if peer.clock is not None]):
            await asyncio.to_thread(threading.Event().wait, 0.05)
    assert is_off(known[0], 90 * SECOND)
