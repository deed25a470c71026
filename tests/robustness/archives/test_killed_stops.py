"""kill -9 of a real host at each step of its clean stop, and of the next owner at each step of its take-over.

The archive is at a real S3 server.

`make test` tries some steps. `make kill-uploads` tries all.
"""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

import stampede_rt as st
from stampede_rt_local.cluster import LocalCluster
from tests.robustness.archives.stepped_mover import STOPPING, TAKING
from tests.robustness.archives.test_killed_movers import (
    EVERY_STEP,
    ITEMS,
    READY_S,
    Mover,
    Put,
    cluster,
    mover,
    rt,
    server,
    settled,
)
from tests.support.channel_host.s3_server import S3Server
from tests.support.waiting import wait_until

__all__ = ["cluster", "mover", "rt", "server"]
WHOLE = [*STOPPING].index("has made the object of the stop")
"""After a kill at this step or a later one the next owner has all items, and knows that it has them."""


@pytest.fixture
def other(cluster: LocalCluster, server: S3Server, mover: Mover, tmp_path: Path) -> Iterator[Mover]:
    """A second host with the same store. It is killed at the end."""
    made = Mover(cluster, tmp_path / "other", f"other-{time.monotonic_ns()}")
    yield made
    print("--- host other", *made.process.last_lines, sep="\n")
    made.process.kill()
    mover.kill_and_start()
    mover.process.wait_ready(READY_S)


def stop_and_die(one: Mover, step: str) -> None:
    """Stop a host, which is killed at this step."""
    one.dies_at(step)
    one.process.ask_to_stop()
    wait_until(lambda: one.process.ended, f"the host is at the step {step!r}")
    assert one.process.exit_code == -signal.SIGKILL, "the stop has not reached the step"


def taken_over(connection: st.Connection, name: str, other: Mover) -> st.Channel:
    """Wait until the channel is at the other host, and return it."""
    wait_until(lambda: connection.channel(name).info.host == other.name, "another host has the channel")
    return connection.channel(name)


def all_seqs_differ(put: Put) -> bool:
    seqs = [item.seq for item in put.channel.get(put.began, st.NEWEST)]
    return len(seqs) == len(set(seqs))


@pytest.mark.timeout(120)
@pytest.mark.parametrize("step", STOPPING if EVERY_STEP else ["makes the object of the stop"])
def test_a_kill_during_a_stop_loses_and_doubles_nothing_at_the_same_host(
    mover: Mover, rt: st.Connection, step: str
) -> None:
    put = Put(rt.channel(f"stopping/{[*STOPPING].index(step)}", max_items=8, archive="7d"))
    put.some(ITEMS)
    stop_and_die(mover, step)
    mover.kill_and_start()
    mover.process.wait_ready(READY_S)
    put.check()
    put.some(ITEMS)
    put.check()
    assert all_seqs_differ(put)
    settled(mover, put)
    put.check()


@pytest.mark.timeout(120)
@pytest.mark.parametrize("step", STOPPING if EVERY_STEP else ["has made the object of the stop"])
def test_after_a_kill_during_a_stop_the_next_owner_has_all_items_or_says_lost(
    mover: Mover, other: Mover, rt: st.Connection, step: str
) -> None:
    name = f"left/{[*STOPPING].index(step)}"
    put = Put(rt.channel(name, host=mover.name, max_items=8, archive="7d"))
    put.some(ITEMS)
    stop_and_die(mover, step)
    put.channel = taken_over(rt, name, other)
    found = put.channel.get(put.began, put.began + 10**9)
    if [*STOPPING].index(step) >= WHOLE:
        assert (len(put.check()), found.reason) == (ITEMS, None)
    else:
        assert found.reason == "LOST"
    put.some(ITEMS)
    assert all_seqs_differ(put)


@pytest.mark.timeout(120)
@pytest.mark.parametrize("step", TAKING if EVERY_STEP else ["has taken the stop"])
def test_a_kill_of_the_next_owner_while_it_takes_over_after_a_clean_stop_loses_nothing(
    mover: Mover, other: Mover, rt: st.Connection, step: str
) -> None:
    name = f"taking/{[*TAKING].index(step)}"
    put = Put(rt.channel(name, host=mover.name, max_items=8, archive="7d"))
    put.some(ITEMS)
    other.dies_at(step)
    mover.process.stop()

    def is_dead() -> bool:
        put.one()
        return other.process.ended

    wait_until(is_dead, f"the next owner is at the step {step!r}")
    other.kill_and_start()
    other.process.wait_ready(READY_S)
    put.channel = taken_over(rt, name, other)
    put.some(ITEMS)
    put.check()
    assert all_seqs_differ(put)


@pytest.mark.timeout(120)
def test_the_object_of_an_earlier_stop_does_not_count_after_a_crash(
    mover: Mover, other: Mover, server: S3Server, rt: st.Connection
) -> None:
    """The host is killed before it deletes the object of its own former stop.

    Each start of a host gives the channel a new epoch.
    """
    put = Put(rt.channel("earlier", host=mover.name, max_items=8, archive="7d"))
    put.some(ITEMS)
    other.process.pause()  # so that the channel stays at the first host
    mover.process.stop()
    mover.kill_and_start()
    mover.process.wait_ready(READY_S)
    mover.dies_at("deletes objects")
    put.channel = rt.channel("earlier")

    def is_dead() -> bool:
        put.one()
        return mover.process.ended

    wait_until(is_dead, "the host deletes the object of its stop")
    stops = [*(server.folder / "rig" / "channels" / put.channel.info.channel_id.hex()).glob("*.stopped")]
    assert stops
    other.process.resume()  # not earlier, because the next owner of the channel also deletes this object
    put.channel = taken_over(rt, "earlier", other)
    assert put.channel.get(put.began, st.NOW).reason == "LOST"
    assert set(range(ITEMS)) <= {
        int((item.payload or b"").split(b" ")[0]) for item in put.channel.get(put.began, st.NOW)
    }


@pytest.mark.timeout(120)
def test_files_that_a_stop_has_left_reach_the_store_although_another_host_has_the_channel(
    mover: Mover, other: Mover, server: S3Server, rt: st.Connection
) -> None:
    put = Put(rt.channel("behind", host=mover.name, max_items=8, archive="7d"))
    put.some(ITEMS)
    server.freeze(frozen=True)
    try:
        mover.process.stop()
    finally:
        server.freeze(frozen=False)
    assert mover.files(put.channel)
    put.channel = taken_over(rt, "behind", other)
    assert put.channel.get(put.began, st.NOW).reason == "LOST"
    mover.kill_and_start()
    mover.process.wait_ready(READY_S)
    settled(mover, put)
