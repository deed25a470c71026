"""`stampede record --on` after the loss of the host of the events, and after the end of the events."""

from __future__ import annotations

import signal
import subprocess
from pathlib import Path

import stampede_rt as st
from stampede_rt_local.cluster import LocalCluster
from tests.integration.command_line.test_recording_commands import recording
from tests.support.cluster import cluster_fixture
from tests.support.files.recordings import read, seqs_of
from tests.support.processes import started
from tests.support.waiting import wait_until

cluster = cluster_fixture(hosts=1, supernodes=1)


def test_events_go_on_after_the_loss_of_their_host_and_no_file_of_an_event_is_overwritten(
    cluster: LocalCluster, tmp_path: Path
) -> None:
    with st.connect(cluster.address) as rt:
        data, events = rt.channel("data", max_age="60s"), rt.channel("crash")
        words = ["data", "--on", "crash", "--since", "30s", "--for", "0s", "--overwrite", "-o", tmp_path / "crash.mcap"]
        with started(recording(cluster, *words), stderr=subprocess.PIPE) as process:
            assert process.stderr is not None
            process.stderr.readline()
            data.put(b"before")
            events.put(b"crash")
            assert process.stdout is not None
            assert process.stdout.readline(), "the summary of the first file"
            cluster.hosts[0].kill()
            cluster.hosts[0].restart()
            data.put(b"one", timeout=20)
            data.put(b"two", timeout=20)
            wait_until(lambda: events.stats().subscriptions == 1)
            events.put(b"crash", timeout=20)
            wait_until(lambda: (tmp_path / "crash-000001-2.mcap").exists())
            process.send_signal(signal.SIGTERM)
            _, error_output = process.communicate(timeout=30)
    assert process.returncode == 3
    assert "events may be missing: channel 'crash'" in error_output
    assert seqs_of(read(tmp_path / "crash-000001.mcap")[0], "data") == [1]
    assert seqs_of(read(tmp_path / "crash-000001-2.mcap")[0], "data") == [1, 2]


def test_the_end_of_the_events_finishes_the_files_that_are_under_way(cluster: LocalCluster, tmp_path: Path) -> None:
    with st.connect(cluster.address) as rt:
        rt.channel("ends/data").put(b"before")
        events = rt.channel("ends/crash")
        words = ["ends/data", "--on", "ends/crash", "--since", "30s", "--for", "3s", "-o", tmp_path / "crash.mcap"]
        with started(recording(cluster, *words), stderr=subprocess.PIPE) as process:
            assert process.stderr is not None
            process.stderr.readline()
            events.put(b"crash")
            wait_until(lambda: any(tmp_path.iterdir()))
            events.delete()
            _, error_output = process.communicate(timeout=30)
    assert process.returncode == 1
    assert "channel ends/crash was deleted" in error_output
    assert (tmp_path / "crash-000001.mcap").read_bytes().endswith(b"MCAP0\r\n")


def test_the_past_of_a_file_counts_back_from_the_time_of_its_event(cluster: LocalCluster, tmp_path: Path) -> None:
    with st.connect(cluster.address) as rt:
        data, events = rt.channel("past/data", max_age="1h"), rt.channel("past/crash", max_age="1h")
        at = st.now() - 60_000_000_000
        for offset in (-1_000_000_001, -1_000_000_000, 1):
            data.put(b"before", time=at + offset)
        words = ["past/data", "--on", "past/crash", "--since", "1s", "--for", "0s", "-o", tmp_path / "crash.mcap"]
        with started(recording(cluster, *words), stderr=subprocess.PIPE) as process:
            assert process.stderr is not None
            process.stderr.readline()
            events.put(b"crash", time=at)
            assert process.stdout is not None
            assert process.stdout.readline(), "the summary of the file"
            process.send_signal(signal.SIGTERM)
            process.communicate(timeout=30)
    assert process.returncode == 0
    assert seqs_of(read(tmp_path / "crash-000001.mcap")[0], "past/data") == [2, 3]
