"""Both clients record live channels."""

from __future__ import annotations

import errno
import json
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import stampede_rt as st
from stampede_rt import aio
from stampede_rt._sync import channel_recording
from stampede_rt.files import writing
from stampede_rt.files.editing import cut, verify
from stampede_rt.files.entries import FileAdvance, FileEntry
from stampede_rt.files.reading import CLOCKS_NAME, FileReader
from stampede_rt_local.cluster import LocalCluster
from tests.support.cluster import cluster_fixture
from tests.support.files.recordings import read
from tests.support.sharing.shared_cluster import shared_cluster_fixture
from tests.support.waiting import wait_until

cluster = shared_cluster_fixture(hosts=2)
mortal = cluster_fixture(hosts=2, supernodes=1, scope="function")
MS = 1_000_000


@pytest.fixture
def rt(cluster: LocalCluster) -> Iterator[st.Connection]:
    with st.connect(cluster.address) as connection:
        yield connection


def items_of(path: Path, channel: str) -> list[st.Item]:
    events, damages = read(path)
    assert not damages
    return [event.to_item() for event in events if isinstance(event, FileEntry) and event.topic.name == channel]


def test_held_items_and_new_items_of_a_channel_are_recorded(rt: st.Connection, tmp_path: Path) -> None:
    channel, path = rt.channel("both", max_age="1h"), tmp_path / "a.mcap"
    base = st.now() - 300_000 * MS
    channel.put(b"too old", time=base - 600_000 * MS)
    for number in range(20):
        channel.put(b"%d" % number, time=base + number * MS, duration="1ms", attributes={"n": str(number)})
    with rt.record(channel, path, since="10m") as recorder:
        channel.put(b"late", time=base + 3 * MS)
        channel.put(b"new", content_type="text/plain")
    check_both(path, [*channel.get(st.OLDEST, st.NOW)], recorder.summary)


async def test_the_asyncio_client_records_like_the_blocking_client(cluster: LocalCluster, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    async with aio.connect(cluster.address) as rt:
        channel = await rt.channel("aio/both", max_age="1h")
        base = st.now() - 300_000 * MS
        await channel.put(b"too old", time=base - 600_000 * MS)
        for number in range(20):
            await channel.put(b"%d" % number, time=base + number * MS, duration="1ms", attributes={"n": str(number)})
        async with rt.record("aio/*", path, since="10m") as recorder:
            await channel.put(b"late", time=base + 3 * MS)
            await channel.put(b"new", content_type="text/plain")
        summary = await recorder.wait()
        held = [*await channel.get(st.OLDEST, st.NOW)]
    check_both(path, held, summary)


def check_both(path: Path, held: list[st.Item], summary: st.RecordingSummary | None) -> None:
    expected = {item.seq: item._replace(end=None) for item in held if item.payload != b"too old"}
    found = items_of(path, _only_name(summary))
    assert [item._replace(end=None) for item in found] == [expected[seq] for seq in sorted(expected)]
    assert summary is not None
    (counts,) = summary.channels
    assert (counts.accepted, counts.recorded, counts.missing) == (22, 22, 0)
    assert summary.complete
    assert verify(path).intact


def _only_name(summary: st.RecordingSummary | None) -> str:
    assert summary is not None
    return summary.channels[0].channel


def test_a_glob_follows_channels_that_appear_later_from_their_first_item(rt: st.Connection, tmp_path: Path) -> None:
    rt.channel("rig/one").put(b"held")
    path = tmp_path / "a.mcap"
    with rt.record(["rig/*", "other"], path) as recorder:
        late = rt.channel("rig/two")
        for number in range(5):
            late.put(b"%d" % number)
        rt.channel("aside").put(b"not recorded")
        wait_until(lambda: "rig/two" in recorder.channels)
    assert recorder.summary is not None
    assert [(one.channel, one.recorded) for one in recorder.summary.channels] == [("rig/one", 0), ("rig/two", 5)]
    assert recorder.summary.absent == ("no channel matches 'other'",)
    assert not recorder.summary.complete
    assert [item.payload for item in items_of(path, "rig/two")] == [b"0", b"1", b"2", b"3", b"4"]


def test_advances_are_recorded_after_the_items_that_they_follow(rt: st.Connection, tmp_path: Path) -> None:
    channel, path = rt.channel("advancing", max_age="1h"), tmp_path / "a.mcap"
    base = st.now() - 10_000 * MS
    with rt.record(channel, path):
        first = channel.put(b"1", time=base)
        channel.advance(base + 5 * MS)
        second = channel.put(b"2", time=base + 6 * MS)
        channel.advance(base + 7 * MS)
    events, _ = read(path)
    advances = [event for event in events if isinstance(event, FileAdvance)]
    assert advances[-1] == FileAdvance("advancing", second.incarnation, base + 7 * MS, second.seq)
    assert all(one.time < base + 7 * MS or one.after_seq >= first.seq for one in advances)


def test_a_slow_recording_names_exactly_the_items_that_it_lost(
    rt: st.Connection, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    channel, path = rt.channel("fast", max_items=50), tmp_path / "a.mcap"
    gate, held = threading.Event(), writing.FileWriter.add

    def slow(writer: writing.FileWriter, entries: object) -> None:
        gate.wait(20)
        held(writer, entries)  # type: ignore[arg-type]

    gate.set()
    monkeypatch.setattr(writing.FileWriter, "add", slow)
    with rt.record(channel, path) as recorder:
        gate.clear()
        for _ in range(40):
            with channel.producer() as producer:
                for _ in range(50):
                    producer.put(bytes(10_000))
        gate.set()
    assert channel.stats().accepted == 2000
    assert recorder.summary is not None
    (counts,) = recorder.summary.channels
    assert counts.accepted == 2000 == counts.recorded + counts.missing
    assert counts.missing > 0
    assert {gap.reason for gap in counts.gaps} == {"COLLECTED"}
    seqs = {item.seq for item in items_of(path, "fast")}
    named = {seq for gap in counts.gaps for seq in range(gap.first_seq or 0, (gap.last_seq or 0) + 1)}
    assert seqs | named == set(range(1, 2001))
    assert not seqs & named
    assert verify(path).summary.channels[0].gaps == counts.gaps


def test_a_start_before_the_oldest_item_is_recorded_as_a_gap(rt: st.Connection, tmp_path: Path) -> None:
    channel = rt.channel("short", max_items=3)
    for number in range(10):
        channel.put(b"%d" % number)
    with rt.record(channel, tmp_path / "a.mcap", since="30s", for_="0s") as recorder:
        summary = recorder.wait()
    assert summary is not None
    (counts,) = summary.channels
    assert counts.recorded == 3
    assert [gap.reason for gap in counts.gaps] == ["COLLECTED"]
    assert "give it a longer max_age" in counts.gaps[0].detail
    assert not summary.complete


def test_a_deleted_channel_ends_with_a_gap_and_other_channels_are_still_recorded(
    rt: st.Connection, tmp_path: Path
) -> None:
    gone, stays = rt.channel("gone"), rt.channel("stays")
    with rt.record([gone, stays], tmp_path / "a.mcap") as recorder:
        gone.put(b"1")
        wait_until(lambda: recorder.recorded == 1)
        gone.delete()
        stays.put(b"2")
        wait_until(lambda: recorder.recorded == 2)
    assert recorder.summary is not None
    by_name = {one.channel: one for one in recorder.summary.channels}
    assert [gap.reason for gap in by_name["gone"].gaps] == ["DELETED"]
    assert by_name["stays"].complete


def test_a_full_disk_ends_the_recording_with_an_error_and_keeps_the_written_items(
    rt: st.Connection, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    channel, path = rt.channel("disk"), tmp_path / "a.mcap"
    recorder = rt.record(channel, path)
    channel.put(b"kept")
    wait_until(lambda: recorder.recorded == 1)
    recorder._sink.do(recorder._sink.writer.flush)

    def full(entries: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(recorder._sink.writer, "_add", full)
    channel.put(b"lost")
    with pytest.raises(st.FileError, match="No space left on device; free space"):
        recorder.wait(20)
    assert [item.payload for item in _readable(path)] == [b"kept"]


def _readable(path: Path) -> list[st.Item]:
    events, _ = read(path)
    return [event.to_item() for event in events if isinstance(event, FileEntry)]


def test_a_file_that_exists_is_not_overwritten_by_accident(rt: st.Connection, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_text("precious")
    with pytest.raises(st.FileError, match="exists"):
        rt.record("any", path)
    assert path.read_text() == "precious"


@pytest.mark.parametrize("wrong", [{"since": 30}, {"compression": "gzip"}, {"for_": "-1s"}, {"overwrite": "yes"}])
def test_wrong_arguments_make_no_file(rt: st.Connection, tmp_path: Path, wrong: dict[str, object]) -> None:
    with pytest.raises(st.InvalidArgument):
        rt.record("any", tmp_path / "a.mcap", **wrong)  # type: ignore[arg-type]
    assert not list(tmp_path.iterdir())


def test_items_that_cannot_be_read_in_time_are_named_as_not_read(
    rt: st.Connection, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    channel, gate = rt.channel("stuck", max_bytes=50_000_000), threading.Event()
    held = channel_recording.ChannelRecording._write

    def stuck(one: object, *arguments: object) -> None:
        gate.wait(20)
        held(one, *arguments)  # type: ignore[arg-type]

    recorder = rt.record(channel, tmp_path / "a.mcap")
    monkeypatch.setattr(channel_recording.ChannelRecording, "_write", stuck)
    threading.Timer(1.0, gate.set).start()
    with recorder:
        for _ in range(30):
            channel.put(bytes(200_000))
        recorder.hurry(0.05)
    assert recorder.summary is not None
    (counts,) = recorder.summary.channels
    assert counts.accepted == 30 == counts.recorded + counts.missing
    assert counts.gaps[-1].reason == "NOT_READ"


def host_away(_: channel_recording.Channel, timeout_s: float) -> st.ChannelStats:
    raise st.Unavailable("its host is unreachable")


def begun_anew(
    channel: channel_recording.Channel, timeout_s: float, stats: Any = channel_recording.Channel._stats_within
) -> st.ChannelStats:
    found: st.ChannelStats = stats(channel, timeout_s)
    return replace(found, incarnation=found.incarnation + 1)


@pytest.mark.parametrize(("stats", "reason"), [(host_away, "UNAVAILABLE"), (begun_anew, "LOST")])
def test_a_recording_that_cannot_know_the_last_item_of_a_channel_at_its_end_says_that_items_may_be_missing(
    rt: st.Connection,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    stats: Callable[[channel_recording.Channel], st.ChannelStats],
    reason: str,
) -> None:
    channel = rt.channel(f"cam/{reason.lower()}", max_age="60s")
    with rt.record(channel, tmp_path / "a.mcap") as recorder:
        channel.put(b"x")
        wait_until(lambda: recorder.recorded == 1)
        monkeypatch.setattr(channel_recording.Channel, "_stats_within", stats)
    assert recorder.summary is not None
    (counts,) = recorder.summary.channels
    assert (counts.recorded, [(one.reason, one.first_seq, one.items) for one in counts.gaps]) == (
        1,
        [(reason, 2, None)],
    )
    assert not recorder.summary.complete
    assert not verify(tmp_path / "a.mcap").summary.complete


def test_the_recording_of_a_lost_channel_has_a_gap_and_continues_with_its_next_incarnation(
    mortal: LocalCluster, tmp_path: Path
) -> None:
    path = tmp_path / "a.mcap"
    with st.connect(mortal.address) as rt:
        channel = rt.channel("cam/lost", max_age="60s")
        with rt.record("cam/*", path) as recorder:
            channel.put(b"before")
            wait_until(lambda: recorder.recorded == 1)
            next(host for host in mortal.hosts if channel.host in host.name or host.name in channel.host).kill()
            channel.put(b"after 1")
            channel.put(b"after 2")
            wait_until(lambda: recorder.recorded == 3)
    assert recorder.summary is not None
    lost, anew = sorted(recorder.summary.channels, key=lambda one: one.start or 0)
    assert (lost.recorded, [(gap.reason, gap.first_seq, gap.items) for gap in lost.gaps]) == (1, [("LOST", 2, None)])
    assert (anew.recorded, anew.accepted, anew.complete) == (2, 2, True)
    assert lost.incarnation != anew.incarnation
    assert [item.payload for item in items_of(path, "cam/lost")] == [b"before", b"after 1", b"after 2"]
    assert not verify(path).summary.complete
    [gap] = lost.gaps
    assert gap.end is not None
    assert lost.end is not None
    assert lost.end < gap.end < st.now() + 10**10
    assert cut(path, tmp_path / "later.mcap", start=gap.end + 1, end=gap.end + 2).complete
    assert not cut(path, tmp_path / "early.mcap", start=gap.end, end=gap.end + 1).complete


def test_the_offsets_of_the_clocks_of_named_peers_are_in_the_file(cluster: LocalCluster, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with st.connect(cluster.address, name="camera-pi") as rt:
        rt.channel("clocks")
        with rt.record("clocks", path):
            pass
    with FileReader(path) as reader:
        clocks = reader.metadata(CLOCKS_NAME)
    assert clocks is not None
    peer = json.loads(clocks["peers"])["camera-pi"]
    assert peer["uncertainty_nanos"] >= 0
    assert isinstance(peer["offset_nanos"], int)
    assert json.loads(clocks["recorder_clock"])["uncertainty_nanos"] >= 0


async def test_a_recording_of_many_small_items_leaves_the_event_loop_free(
    cluster: LocalCluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    threads: set[int] = set()
    held = writing.FileWriter.add

    def noting(writer: writing.FileWriter, entries: object) -> None:
        threads.add(threading.get_ident())
        held(writer, entries)  # type: ignore[arg-type]

    monkeypatch.setattr(writing.FileWriter, "add", noting)
    async with aio.connect(cluster.address) as rt:
        channel = await rt.channel("aio/small", max_items=20_000)
        async with rt.record("aio/small", tmp_path / "a.mcap") as recorder, channel.producer() as producer:
            for _ in range(5_000):
                await producer.put(b"x")
        summary = await recorder.wait()
    assert summary is not None
    assert (summary.recorded, summary.complete) == (5_000, True)
    assert threads
    assert threading.get_ident() not in threads


def test_a_hurried_end_asks_an_unreachable_host_for_no_longer_than_the_end_may_take(
    rt: st.Connection, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    timeouts: list[float] = []

    def away(_: channel_recording.Channel, timeout_s: float) -> st.ChannelStats:
        timeouts.append(timeout_s)
        raise st.Unavailable("its host is unreachable")

    channels = [rt.channel(f"hurried/{number}", max_age="60s") for number in range(3)]
    with rt.record("hurried/*", tmp_path / "a.mcap") as recorder:
        for channel in channels:
            channel.put(b"x")
        monkeypatch.setattr(channel_recording.Channel, "_stats_within", away)
        recorder.hurry(0.5)
    assert len(timeouts) == 3
    assert max(timeouts) <= 0.5
    assert recorder.summary is not None
    assert [one.gaps[-1].reason for one in recorder.summary.channels] == ["UNAVAILABLE"] * 3
