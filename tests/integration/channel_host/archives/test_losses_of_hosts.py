"""A host with an archive that was killed: subscriptions over this time report the loss, as gets do."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import pytest

import stampede_rt as st
from stampede_rt_local.cluster import LocalCluster
from tests.support.waiting import wait_until

MS = 10**6


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LocalCluster]:
    """One host with an archive."""
    with LocalCluster(hosts=1, supernodes=1, archive=tmp_path_factory.mktemp("archive")) as running:
        yield running


@pytest.fixture
def rt(cluster: LocalCluster) -> Iterator[st.Connection]:
    with st.connect(cluster.address, secret=cluster.secret.text) as connection:
        yield connection


def crash(cluster: LocalCluster, channel: st.Channel) -> None:
    """Put an item that is in the archive, and kill the host. Then put two items at the next incarnation."""
    channel.put(b"kept", ack="disk")
    cluster.hosts[0].kill()
    cluster.hosts[0].restart()
    channel.put(b"after", ack="disk", timeout=20)
    channel.put(b"last", ack="disk")


@pytest.mark.parametrize("max_items", [1, 100])
def test_a_subscription_over_a_crash_counts_the_loss(
    cluster: LocalCluster, rt: st.Connection, caplog: pytest.LogCaptureFixture, max_items: int
) -> None:
    channel = rt.channel(f"lost/{max_items}", max_items=max_items, archive="7d")
    began = st.now() - 1000 * MS
    crash(cluster, channel)
    after = channel.get(began, st.NOW)[1]
    assert channel.get(began, st.NOW).reason == "LOST"
    with caplog.at_level(logging.WARNING, "stampede_rt"), channel.subscribe(start=began) as items:
        assert [one.payload for one in islice(items, 3)] == [b"kept", b"after", b"last"]
        assert (items.losses, items.dropped) == (1, 0)
    assert "the archive may lack the last items" in caplog.text
    with channel.subscribe(start=after.time) as items:
        assert [one.payload for one in islice(items, 2)] == [b"after", b"last"]
        assert items.losses == 0


def test_a_recording_of_the_past_names_a_crash_after_items_that_the_limits_removed(
    cluster: LocalCluster, rt: st.Connection, tmp_path: Path
) -> None:
    channel = rt.channel("lost/recorded", max_items=1, archive_bytes=2**20)
    for _ in range(10):
        channel.put(bytes(2**18), ack="disk")
    wait_until(lambda: channel.get(st.now() - 3600 * 1000 * MS, st.NOW, limit=1).reason == "COLLECTED")
    crash(cluster, channel)
    with rt.record([channel], tmp_path / "past.mcap", since="1h", for_="0s") as recording:
        summary = recording.wait()
    assert summary is not None
    gaps = [gap for one in summary.channels for gap in one.gaps]
    assert {str(gap.reason) for gap in gaps} >= {"LOST"}
    assert not summary.complete
