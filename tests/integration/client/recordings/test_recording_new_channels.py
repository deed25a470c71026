"""Channels that appear while a recording runs, and that are made again."""

from __future__ import annotations

from pathlib import Path

import pytest

import stampede_rt as st
from stampede_rt_local.cluster import LocalCluster
from tests.support.cluster import cluster_fixture
from tests.support.files.recordings import read, seqs_of
from tests.support.waiting import wait_until

cluster = cluster_fixture(hosts=1, supernodes=1, scope="function")
two_hosts = cluster_fixture(hosts=2, supernodes=1, scope="function")


def test_a_channel_that_appears_just_before_the_end_is_recorded_from_its_first_item(
    cluster: LocalCluster, tmp_path: Path
) -> None:
    """The channel collects its first items, perhaps before the recording reads them."""
    with st.connect(cluster.address) as rt:
        for number in range(5):
            with rt.record("late/*", tmp_path / f"{number}.mcap") as recorder:
                late = rt.channel(f"late/{number}", max_items=3)
                for _ in range(12):
                    late.put(b"item")
            assert recorder.summary is not None
            counts = next(one for one in recorder.summary.channels if one.channel == late.name)
            assert (counts.accepted, counts.recorded + counts.missing) == (12, 12)
            late.delete()


def test_a_channel_that_is_made_again_is_recorded_once(cluster: LocalCluster, tmp_path: Path) -> None:
    """The recording of the former channel finds the new one by its name, for instance after a move."""
    path = tmp_path / "a.mcap"
    with st.connect(cluster.address) as rt:
        former = rt.channel("again/data")
        former.put(b"before")
        [info] = rt.channels("again/*")
        former.delete()
        anew = rt.channel("again/data")
        for _ in range(3):
            anew.put(b"after")
        with rt.record("again/*", path, since="oldest") as recorder:
            recorder._record("again/*", info, later=False)
            wait_until(lambda: recorder.recorded >= 3)
    assert recorder.summary is not None
    assert seqs_of(read(path)[0], "again/data") == [1, 2, 3]
    assert recorder.summary.absent == ("channel again/data was deleted, and made again",)


@pytest.mark.parametrize("is_known", [True, False])
def test_a_new_channel_whose_host_was_lost_before_the_recording_reads_it_has_a_gap(
    cluster: LocalCluster, tmp_path: Path, is_known: bool
) -> None:
    """The recording may know the channel from before the loss (`is_known`), or only from later on."""
    with st.connect(cluster.address) as rt:
        channel = rt.channel("young/data")
        channel.put(b"lost")
        [info] = rt.channels("young/*")
        cluster.hosts[0].kill()
        cluster.hosts[0].restart()
        channel.put(b"kept", timeout=20)
        if not is_known:
            [info] = rt.channels("young/*")
        with rt.record("none", tmp_path / "a.mcap") as recorder:
            recorder._record("young/*", info, later=True)
            wait_until(lambda: recorder.recorded == 1)
    assert recorder.summary is not None
    gaps = [gap for one in recorder.summary.channels for gap in one.gaps]
    assert [(gap.reason, gap.first_seq) for gap in gaps] == [("LOST", 1 if is_known else None)]


def test_a_new_channel_that_has_moved_before_the_recording_reads_it_has_lost_nothing(
    two_hosts: LocalCluster, tmp_path: Path
) -> None:
    """In an earlier version, the file had a LOST gap for it, and no gap for the collected items."""
    with st.connect(two_hosts.address) as rt:
        channel = rt.channel("young/data", host="h1", max_items=5)
        for _ in range(12):
            channel.put(b"item")
        rt.move(channel, "h2")
        [info] = rt.channels("young/*")
        with rt.record("none", tmp_path / "a.mcap") as recorder:
            recorder._record("young/*", info, later=True)
            wait_until(lambda: recorder.recorded == 5)
    assert recorder.summary is not None
    gaps = [gap for one in recorder.summary.channels for gap in one.gaps]
    assert [(gap.reason, gap.first_seq, gap.last_seq) for gap in gaps] == [("COLLECTED", 1, 7)]
