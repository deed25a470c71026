"""kill -9 of a real host at each step in which it moves a segment to a real S3 server.

`make test` tries some steps. `make kill-uploads` tries all.
"""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

import stampede_rt as st
from stampede_rt_local.cluster import LocalCluster
from stampede_rt_local.process import ServiceProcess
from tests.robustness.archives.stepped_mover import DROPPING, MOVING, STARTING
from tests.support.channel_host.s3_server import BUCKET, S3Server, s3_server
from tests.support.cluster import cluster_fixture
from tests.support.waiting import wait_until

cluster = cluster_fixture(hosts=0, supernodes=1)
EVERY_STEP = bool(os.environ.get("STAMPEDE_EVERY_STEP"))
READY_S = 40.0
MS, ITEMS = 10**6, 20
ARCHIVE_BYTES, PAYLOAD_BYTES = 2**20, 100_000


class Mover:
    """A host with an archive in a store, which closes files after a second. `plan`: the file with its next kill."""

    def __init__(self, cluster: LocalCluster, folder: Path, name: str = "mover") -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.name = name
        self.plan, self.archive = folder / "plan", folder / "archive"
        words = ["--plan", str(self.plan), "--listen", "localhost:0", "--name", name, "--drain-seconds", "0"]
        words += ["--frontend", cluster.address, "--secret-file", str(cluster.secret_file)]
        words += ["--archive", f"s3://{BUCKET}/rig", "--archive-folder", str(self.archive)]
        self.process = ServiceProcess(
            f"host {name}", "tests.robustness.archives.stepped_mover", [*words, "--archive-move-seconds", "1"]
        )
        self.process.start()
        self.process.wait_ready(READY_S)

    def dies_at(self, step: str) -> None:
        self.plan.write_text(f"{step}|{self.process.pid}|{int(signal.SIGKILL)}")

    def kill_and_start(self) -> None:
        self.process.kill()  # waits for the end of the former run
        self.process.start()

    def files(self, channel: Any) -> list[Path]:
        return [*(self.archive / "channels" / channel.info.channel_id.hex()).glob("*.segment")]


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[S3Server]:
    with s3_server(tmp_path_factory.mktemp("s3")) as running, pytest.MonkeyPatch.context() as patch:
        for name, value in running.environment.items():
            patch.setenv(name, value)
        yield running


@pytest.fixture(scope="module")
def mover(cluster: LocalCluster, server: S3Server, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Mover]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", str(Path(__file__).parents[3]))  # where the host's program is
        made = Mover(cluster, tmp_path_factory.mktemp("mover"))
        yield made
    print("--- host mover", *made.process.last_lines, sep="\n")
    made.process.kill()


@pytest.fixture
def rt(cluster: LocalCluster, mover: Mover) -> Iterator[st.Connection]:
    with st.connect(cluster.address) as connection:
        yield connection


class Put:
    """Puts numbers, each once, and notes the numbers that the host acknowledged as on the disk."""

    def __init__(self, channel: st.Channel, payload_bytes: int = 100) -> None:
        self.channel, self.acked = channel, list[int]()
        self.began = time.time_ns() - 10**9
        self._next, self._payload_bytes = 0, payload_bytes

    def one(self) -> None:
        """Put the next number. If the put fails, the test does not know whether the host has the item."""
        number, self._next = self._next, self._next + 1
        payload = (b"%d " % number).ljust(self._payload_bytes, b".")
        with suppress(st.StampedeError):
            self.channel.put(payload, time=self.began + number * MS, ack="disk", timeout=1)
            self.acked.append(number)

    def some(self, count: int) -> None:
        """Put until this number of further numbers is acknowledged."""
        wanted = len(self.acked) + count
        while len(self.acked) < wanted:
            self.one()

    def check(self, *, is_limited: bool = False) -> list[int]:
        """Check that each acknowledged item is there once. `is_limited`: old items may be gone. Returns the numbers."""
        items = self.channel.get(self.began, st.NEWEST)
        found = [int((item.payload or b"").split(b" ")[0]) for item in items]
        assert found == sorted(set(found))
        assert {one for one in self.acked if not is_limited or one >= found[0]} <= set(found), items.reason
        return found


def killed_at(mover: Mover, put: Put, step: str) -> None:
    """Put until the host has died at the step, and start it again."""
    mover.dies_at(step)

    def is_dead() -> bool:
        put.one()
        return not mover.plan.exists()

    wait_until(is_dead, f"the host is at the step {step!r}")
    mover.kill_and_start()


def settled(mover: Mover, put: Put) -> None:
    """Wait until all files have moved."""
    wait_until(lambda: not mover.files(put.channel), "the files have moved")


@pytest.mark.timeout(120)
@pytest.mark.parametrize("step", MOVING if EVERY_STEP else ["has made the object"])
def test_a_kill_during_a_move_to_the_store_loses_and_duplicates_nothing(
    mover: Mover, rt: st.Connection, step: str
) -> None:
    put = Put(rt.channel(f"moving/{[*MOVING].index(step)}", max_items=8, archive="7d"))
    put.some(ITEMS)
    killed_at(mover, put, step)
    mover.process.wait_ready(READY_S)
    put.check()
    settled(mover, put)
    put.check()


@pytest.mark.timeout(120)
@pytest.mark.parametrize("step", DROPPING if EVERY_STEP else ["deletes objects"])
def test_a_kill_while_old_objects_are_dropped_costs_no_later_item(mover: Mover, rt: st.Connection, step: str) -> None:
    name = f"dropping/{[*DROPPING].index(step)}"
    put = Put(rt.channel(name, max_items=4, archive_bytes=ARCHIVE_BYTES), PAYLOAD_BYTES)
    put.some(ARCHIVE_BYTES // PAYLOAD_BYTES)
    settled(mover, put)
    killed_at(mover, put, step)
    mover.process.wait_ready(READY_S)
    assert len(put.check(is_limited=True)) >= ARCHIVE_BYTES // PAYLOAD_BYTES - 4
    settled(mover, put)
    put.check(is_limited=True)


@pytest.mark.timeout(120)
@pytest.mark.parametrize("step", STARTING if EVERY_STEP else ["takes the objects over"])
def test_a_kill_while_a_host_opens_an_archive_loses_and_duplicates_nothing(
    mover: Mover, rt: st.Connection, step: str
) -> None:
    put = Put(rt.channel(f"starting/{[*STARTING].index(step)}", max_items=8, archive="7d"))
    put.some(ITEMS)
    settled(mover, put)
    put.some(ITEMS)
    mover.kill_and_start()
    mover.process.wait_ready(READY_S)
    killed_at(mover, put, step)
    mover.process.wait_ready(READY_S)
    put.check()
    settled(mover, put)
    put.check()
