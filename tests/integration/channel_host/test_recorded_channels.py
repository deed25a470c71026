"""Recorded channels at a real host: reads over archive and memory, and the same host after a stop or a crash."""

from __future__ import annotations

import random
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

import stampede_rt as st
from stampede_rt.cli.main import main as stampede
from stampede_rt.files.editing import cut
from stampede_rt.files.entries import FileEntry
from stampede_rt_local.cluster import LocalCluster
from tests.support.channel_host.recording_guide import check_guide
from tests.support.files.recordings import read as events_of
from tests.support.waiting import wait_until

ITEMS = 400
MS = 10**6


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


def fill(channel: st.Channel, began: int, first: int = 0, count: int = ITEMS) -> None:
    """Put items whose times are one millisecond apart."""
    for number in range(first, first + count):
        channel.put(b"%d" % number, time=began + number * MS)


def numbers(items: st.Items) -> list[int]:
    return [int(item.payload) for item in items]


def wait_until_collected(channel: st.Channel, held: int) -> None:
    """Wait until memory holds only `held` items, because the archive has the others."""
    wait_until(lambda: channel.stats().held <= held)


def check_reads(channel: st.Channel, began: int) -> None:
    """Check that reads over the border of memory and archive give the answers that all items in memory would give."""
    whole = channel.get(began, began + ITEMS * MS)
    assert numbers(whole) == list(range(ITEMS))
    assert whole.truncated is False
    assert [item.end for item in whole][:-1] == [began + number * MS for number in range(1, ITEMS)]
    assert numbers(channel.at(began + 7 * MS + 5)) == [7]
    assert channel.oldest().payload == b"0"
    assert channel.newest().payload == b"%d" % (ITEMS - 1)
    assert channel.before(began + 5 * MS).payload == b"4"
    page = channel.get(st.OLDEST, st.NEWEST, limit=3)
    assert numbers(page) == [0, 1, 2]
    assert page.more
    assert numbers(channel.get(st.OLDEST, st.NEWEST, after=page[-1], limit=2)) == [3, 4]
    backwards = channel.get(st.OLDEST, st.NEWEST, newest_first=True, limit=20)
    assert numbers(backwards) == list(range(ITEMS - 1, ITEMS - 21, -1))
    gone = channel.get(began, began + 10 * MS, within="memory")
    assert (len(gone), gone.reason) == (0, "COLLECTED")
    assert channel.get(began - 5 * MS, began - MS).reason == "NEVER"
    assert numbers(channel.get(began, began + 10 * MS, timeout=30, complete=True)) == list(range(11))


def test_a_read_crosses_from_the_archive_into_memory(rt: st.Connection) -> None:
    channel, began = rt.channel("rig/border", max_items=8, archive="7d"), time.time_ns() - 10**9
    fill(channel, began)
    wait_until_collected(channel, 8)
    check_reads(channel, began)


def test_the_state_of_an_archive_is_shown(
    rt: st.Connection, cluster: LocalCluster, folder: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.setenv("STAMPEDE_SECRET_FILE", str(cluster.secret.path))
    channel, began = rt.channel("rig/shown", max_items=8, archive="7d"), time.time_ns() - 10**9
    fill(channel, began)
    wait_until_collected(channel, 8)
    wait_until(lambda: channel.stats().archive.waiting == 0)
    archive, place = channel.stats().archive, str(folder / "h1")
    assert (archive.items, archive.unarchived, archive.failure) == (ITEMS, 0, "")
    assert (archive.oldest, archive.newest) == (began, began + (ITEMS - 1) * MS)
    assert archive.bytes == archive.disk_bytes > ITEMS
    assert archive.place == place
    assert rt.hosted_channels("h1", "rig/shown")["rig/shown"].archive == archive
    assert rt.channel("rig/unrecorded", max_items=8).stats().archive is None
    assert [host.archive_place for host in rt.hosts()] == [place]
    for verb in (["info", "rig/shown"], ["hosts"]):
        assert stampede([*verb, "--url", cluster.address]) == 0
        assert place in capsys.readouterr().out


def test_a_long_answer_from_the_archive_is_read_page_by_page(rt: st.Connection) -> None:
    channel, began = rt.channel("rig/long", max_items=2, archive="forever"), time.time_ns() - 10**9
    for number in range(60):
        channel.put(bytes([number]) * 200_000, time=began + number * MS)
    wait_until_collected(channel, 2)
    items = channel.get(st.OLDEST, st.NEWEST)
    assert [item.payload[0] for item in items] == list(range(60))
    assert not items.more
    assert [item.payload[0] for item in channel.get(st.OLDEST, st.NEWEST, newest_first=True)] == list(range(59, -1, -1))


def test_a_host_that_restarts_after_a_clean_stop_has_lost_nothing(cluster: LocalCluster, rt: st.Connection) -> None:
    channel, began = rt.channel("rig/stopped", max_items=8, archive="7d"), time.time_ns() - 10**9
    fill(channel, began, count=ITEMS - 1)
    channel.advance(began + (ITEMS - 2) * MS)
    empty = rt.channel("rig/empty", archive="7d")
    assert empty.newest() is None
    unserved = rt.channel("rig/unserved", archive="7d")
    with channel.subscribe(start=began) as items:
        seen = [next(items) for _ in range(5)]
        for times in (1, 2):  # the second process does not even open the channel
            cluster.hosts[0].stop()
            cluster.hosts[0].restart()
            assert rt.channel("rig/stopped").info.epoch == times + 1
        channel.put(b"%d" % (ITEMS - 1), time=began + (ITEMS - 1) * MS)
        seen += [next(items) for _ in range(ITEMS - 5)]
    assert [int(item.payload) for item in seen] == list(range(ITEMS))
    assert [item.seq for item in seen] == list(range(1, ITEMS + 1))
    assert {item.incarnation for item in seen} == {channel.info.incarnation}
    with channel.subscribe(after=seen[2]) as resumed:
        assert next(resumed).payload == b"3"
    with pytest.raises(st.TooOld, match="an advance has promised"):
        channel.put(b"late", time=began)
    check_reads(channel, began)
    assert rt.channel("rig/empty").info.incarnation == empty.info.incarnation
    assert empty.get(st.OLDEST, began).reason != "LOST"
    assert empty.get(began - MS, began).reason != "LOST"
    assert rt.channel("rig/unserved").info.incarnation == unserved.info.incarnation
    assert unserved.get(began - MS, began).reason != "LOST"


def test_a_host_that_restarts_after_a_crash_has_lost_only_the_newest_items(
    cluster: LocalCluster, rt: st.Connection
) -> None:
    channel, began = rt.channel("rig/killed", max_items=8, archive="7d"), time.time_ns() - 10**9
    fill(channel, began)
    wait_until_collected(channel, 8)
    cluster.hosts[0].kill()
    cluster.hosts[0].restart()
    channel = rt.channel("rig/killed")
    kept = channel.get(began, began + 100 * MS)
    assert numbers(kept) == list(range(101))
    assert (kept.truncated, kept.reason) == (False, None)
    newest = channel.newest()
    assert int(newest.payload) >= ITEMS - 8
    assert channel.get(newest.time + MS, st.NOW).reason == "LOST"


def test_a_recording_of_the_past_names_a_crash_of_the_host(
    cluster: LocalCluster, rt: st.Connection, tmp_path: Path
) -> None:
    """In an earlier version an export was complete, and a recording said that retention had collected the items."""
    channel, began = rt.channel("rig/crashed", max_items=8, archive="7d"), time.time_ns() - 10**9
    fill(channel, began, count=20)
    wait_until_collected(channel, 8)
    cluster.hosts[0].kill()
    cluster.hosts[0].restart()
    crashed = rt.channel("rig/crashed")
    restarted = max(time.time_ns(), crashed.get(began, st.NOW).reason.before)
    fill(crashed, restarted, first=20, count=5)
    paths = [tmp_path / name for name in ("since.mcap", "whole.mcap")]
    with rt.record(["rig/crashed"], paths[0], since="1h", for_="0s") as since:
        summaries = [since.wait()]
    with rt.record(["rig/crashed"], paths[1], since="oldest", for_="0s") as whole:
        summaries.append(whole.wait())
    for summary in summaries:
        (counts,) = summary.channels
        assert counts.recorded >= 20
        assert [one.reason for one in counts.gaps] == ["LOST"]
        assert "the channel's host was lost with the items before" in counts.gaps[0].detail
        assert began + 19 * MS < counts.gaps[0].end < restarted
    parts = [
        cut(paths[1], tmp_path / f"{number}.mcap", start=start, end=end)
        for number, (start, end) in enumerate([(began, began + 5 * MS), (restarted, restarted + 1000 * MS)])
    ]
    # a get of one item does not tell of earlier losses, so the gap begins with the recording
    assert [(one.recorded, one.gap_count) for part in parts for one in part.channels] == [(5, 1), (5, 0)]


def test_a_recording_has_all_items_although_its_host_has_restarted_with_few_of_them_in_memory(
    cluster: LocalCluster, rt: st.Connection, tmp_path: Path
) -> None:
    """In an earlier version the host's count of accepted items counted as its last seq, so a recording ended early."""
    channel, began = rt.channel("rig/large", max_items=8, archive="7d"), time.time_ns() - 10**9
    for number in range(300):
        channel.put(b"%d" % number + bytes(50_000), time=began + number * MS)
    wait_until_collected(channel, 8)
    cluster.hosts[0].stop()
    cluster.hosts[0].restart()
    stats = rt.channel("rig/large").stats()
    assert (stats.next_seq, stats.accepted < 300) == (301, True)
    for number in range(3):  # a recording that ended early had most items nevertheless
        with rt.record(["rig/large"], tmp_path / f"{number}.mcap", since="1h", for_="0s") as recording:
            summary = recording.wait()
        assert [(one.recorded, one.missing) for one in summary.channels] == [(300, 0)]


def test_an_import_of_a_recorded_channel_has_all_items(rt: st.Connection, tmp_path: Path) -> None:
    channel, began = rt.channel("imported", max_items=12, archive="7d"), st.now() - 10_000 * MS
    fill(channel, began)
    with rt.record(channel.name, tmp_path / "a.mcap", since="oldest"):
        pass
    summary = rt.import_file(tmp_path / "a.mcap", "import/").wait()
    assert summary is not None
    assert summary.complete
    found = rt.channel("import/imported", create=False)
    assert found.stats().policy.is_recorded
    wait_until_collected(found, 12)
    assert numbers(found.get(st.OLDEST, st.NEWEST)) == list(range(ITEMS))


@pytest.mark.parametrize("since", [None, "1h"])
def test_a_recording_that_lives_through_a_crash_has_each_item_once(
    cluster: LocalCluster, rt: st.Connection, tmp_path: Path, since: str | None
) -> None:
    """In an earlier version it recorded the whole archive again."""
    channel = rt.channel(f"rig/live-{since}", max_items=8, archive="7d")
    channel.put(b"before", ack="disk")
    with rt.record([channel], tmp_path / "live.mcap", since=since) as recording:
        for number in range(5):
            channel.put(b"%d" % number, ack="disk")
        wait_until(lambda: recording.recorded == 5 + bool(since))
        cluster.hosts[0].kill()
        cluster.hosts[0].restart()
        for number in range(5, 10):
            rt.channel(channel.name).put(b"%d" % number, ack="disk")
        wait_until(lambda: recording.recorded == 10 + bool(since))
    events, _ = events_of(tmp_path / "live.mcap")
    payloads = [one.data for one in events if isinstance(one, FileEntry)]
    assert payloads == [b"before"] * bool(since) + [b"%d" % number for number in range(10)]
    assert [gap.reason for one in recording.summary.channels for gap in one.gaps] == ["LOST"]


def segment_with(folder: Path, payload: bytes) -> Path:
    """The file of the archive that has this payload."""
    return next(path for path in folder.rglob("*.segment") if payload in path.read_bytes())


def test_a_get_and_a_subscription_say_that_the_items_of_a_damaged_block_are_lost(
    rt: st.Connection, folder: Path, caplog: pytest.LogCaptureFixture
) -> None:
    channel, began = rt.channel("rig/flipped", max_items=2, archive="7d"), time.time_ns() - 10**9
    for number in range(6):
        channel.put(b"flipped-%d" % number + b"." * 2**18, time=began + number * MS)  # each in a block of its own
    wait_until_collected(channel, 2)
    path = segment_with(folder, b"flipped-2")
    at = path.read_bytes().index(b"flipped-2")
    with path.open("r+b") as file:
        file.seek(at)
        file.write(b"F")
    for newest_first in (False, True):
        items = channel.get(began, began + 5 * MS, newest_first=newest_first)
        assert sorted(item.payload[8:9] for item in items) == [b"0", b"1", b"3", b"4", b"5"]
        assert items.reason == "LOST"
        assert "the archive lacks 1 items" in items.reason.detail
    assert channel.get(began + 2 * MS, began + 2 * MS).reason == "LOST"
    assert channel.get(began + 3 * MS, began + 5 * MS).reason is None
    assert channel.get(st.OLDEST, st.NEWEST, limit=2).reason is None
    with channel.subscribe(start=began) as events:
        assert [next(events).payload[8:9] for _ in range(5)] == [b"0", b"1", b"3", b"4", b"5"]
        assert (events.dropped, events.losses) == (1, 1)
        assert "their block or file is damaged" in caplog.text


def test_every_example_of_the_guide_prints_the_stated_output(
    cluster: LocalCluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    check_guide(cluster, monkeypatch)


def test_a_subscription_begins_in_the_archive_and_continues_with_live_items(rt: st.Connection) -> None:
    channel, began = rt.channel("rig/followed", max_items=8, archive="7d"), time.time_ns() - 10**9
    fill(channel, began)
    wait_until_collected(channel, 8)
    with channel.subscribe(start=began + 5 * MS) as items:
        fill(channel, began, ITEMS, 5)
        taken = [next(items) for _ in range(ITEMS)]
    assert [int(item.payload) for item in taken] == list(range(5, ITEMS + 5))
    assert [item.end for item in taken[:300]] == [item.time + MS for item in taken[:300]]
    with channel.subscribe(after=taken[2]) as items:
        assert next(items).payload == b"8"


def test_a_caller_that_fills_its_disk_quota_gets_an_error_with_the_name_of_the_quota(
    rt: st.Connection, cluster: LocalCluster, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("STAMPEDE_URL", cluster.address)
    monkeypatch.setenv("STAMPEDE_SECRET_FILE", str(cluster.secret.path))
    channel = rt.channel("rig/filling", max_items=2, archive="forever")
    assert stampede(["quota", "set", "@cluster", "bytes-archived=600KiB"]) == 0
    with pytest.raises(st.Overloaded, match=r"@cluster has \d+ bytes on the disk .* quota bytes-archived is 614400"):  # noqa: PT012
        for _ in range(20):  # the host counts the bytes before they are on the disk
            channel.put(bytes(2**16))
    with pytest.raises(st.Overloaded, match="bytes-archived"):  # noqa: PT012
        for _ in range(100):
            channel.put(bytes(2**10))
    with pytest.raises(st.Overloaded, match="bytes-archived"):  # noqa: PT012
        for _ in range(400):  # each advance takes 16 bytes of the archive
            channel.advance(time.time_ns())
    with pytest.raises(st.Overloaded, match="bytes-archived"):
        rt.channel("rig/another", archive="forever").put(b"new")
    rt.channel("rig/another").delete()
    plain = rt.channel("rig/plain", max_items=2)
    with pytest.raises(st.Overloaded, match="bytes-archived"):
        plain.configure(archive="forever")
    plain.put(b"goes on")
    assert stampede(["quota", "rm", "@cluster"]) == 0
    channel.put(b"more")
    plain.configure(archive="forever")
    capsys.readouterr()


def test_items_of_any_kind_that_came_one_by_one_are_the_same_from_memory_and_from_the_archive(
    rt: st.Connection,
) -> None:
    draw, began = random.Random(7), rt.channel("record/kinds/memory").stats().host_time - 10**9
    channels = [
        rt.channel("record/kinds/memory", max_items=10_000),
        rt.channel("record/kinds/archive", max_items=10, archive="forever"),
    ]
    fields = [
        {
            "time": began + (number - draw.choice([0, 0, 0, 5])) // 2 * MS,
            "duration": draw.choice([None, None, 0, 3 * MS]),
            "attributes": draw.choice([None] * 9 + [{"kind": "odd"}]),
        }
        for number in range(700)
    ]
    for channel in channels:
        for number, chosen in enumerate(fields):
            channel.put(b"%d" % number * (5000 if number == 300 else 1), **chosen)
    wait_until_collected(channels[1], 20)
    reads = {
        "whole": lambda one: one.get(st.OLDEST, st.NEWEST),
        "part": lambda one: one.get(began + 20 * MS, began + 200 * MS, limit=300),
        "backwards": lambda one: one.get(st.OLDEST, st.NEWEST, newest_first=True),
        "without payloads": lambda one: one.get(st.OLDEST, st.NEWEST, payloads=False),
        "followed": lambda one: followed(one, began, len(fields)),
    }
    for name, read in reads.items():
        in_memory, archived = ([one._replace(incarnation=0) for one in read(channel)] for channel in channels)
        assert len(in_memory) > 100
        assert archived == in_memory, name


def followed(channel: st.Channel, began: int, count: int) -> list[st.Item]:
    with channel.subscribe(start=began - 10 * MS) as items:
        return [next(items) for _ in range(count)]
