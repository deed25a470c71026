"""Recordings and exports of recorded channels whose archive lacks items, at a real host."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

import stampede_rt as st
from stampede_rt._sync import channel_recording
from stampede_rt.cli.main import main as stampede
from stampede_rt.files.editing import verify
from stampede_rt_local.cluster import LocalCluster
from tests.support.waiting import wait_until


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("archive")


@pytest.fixture(scope="module")
def cluster(folder: Path) -> Iterator[LocalCluster]:
    """One host with an archive."""
    with LocalCluster(hosts=1, supernodes=1, archive=folder) as running:
        yield running


@pytest.fixture
def rt(cluster: LocalCluster) -> Iterator[st.Connection]:
    with st.connect(cluster.address, secret=cluster.secret.text) as connection:
        yield connection


def test_a_recording_names_the_items_that_the_archive_lacks_and_its_file_is_intact(
    rt: st.Connection, tmp_path: Path
) -> None:
    channel = rt.channel("lacks/some", max_bytes=400, archive="7d")

    def archive() -> st.ArchiveStats:
        found = channel.stats().archive
        assert found is not None
        return found

    def lacks_some() -> bool:
        for _ in range(100):
            channel.put(b"x" * 90)
        return archive().unarchived > 0

    wait_until(lacks_some)
    channel.put(b"last", ack="disk")
    wait_until(lambda: not archive().waiting)
    with rt.record("lacks/some", tmp_path / "some.mcap", since="oldest", for_="0s") as recorder:
        summary = recorder.wait()
    assert summary is not None
    (counts,) = summary.channels
    assert (counts.missing, counts.accepted) == (archive().unarchived, channel.stats().accepted)
    assert counts.recorded == counts.accepted - counts.missing
    assert {gap.reason for gap in counts.gaps} == {"LOST"}
    report = verify(tmp_path / "some.mcap")
    assert report.intact
    assert (report.summary.recorded, report.summary.missing) == (summary.recorded, summary.missing)


def test_a_failed_archive_is_not_reported_as_a_host_that_cannot_be_reached(rt: st.Connection, folder: Path) -> None:
    channels = folder / "h1" / "channels"
    channels.rename(channels.with_name("away"))
    channels.write_bytes(b"not a folder")
    try:
        with pytest.raises(
            st.Unavailable, match=r"cannot serve the channel: the archive of channel lacks/all"
        ) as caught:
            rt.channel("lacks/all", archive="7d").put(b"x", timeout=0.5)
    finally:
        channels.unlink()
        channels.with_name("away").rename(channels)
    assert "cannot be reached" not in str(caught.value)


def test_an_export_of_a_channel_that_cannot_be_read_says_why(
    rt: st.Connection,
    cluster: LocalCluster,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    rt.channel("lacks/reads", archive="7d").put(b"1")

    def away(*_: object, **__: object) -> st.Items:
        raise st.Unavailable("the object store says: SignatureDoesNotMatch")

    monkeypatch.setenv("STAMPEDE_SECRET_FILE", str(cluster.secret_file))
    monkeypatch.setattr(channel_recording.Channel, "get", away)
    assert stampede(["export", "lacks/reads", "-o", str(tmp_path / "a.csv"), "--url", cluster.address]) == 1
    (error_line,) = capsys.readouterr().err.splitlines()
    assert "no items of lacks/reads could be read" in error_line
    assert error_line.endswith("the object store says: SignatureDoesNotMatch")
