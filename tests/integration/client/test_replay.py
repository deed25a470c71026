"""Replays and imports into live channels."""

from __future__ import annotations

import dataclasses
import json
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest
from rosbags.rosbag2 import StoragePlugin

import stampede_rt as st
from stampede_rt import aio
from stampede_rt.files.entries import POLICY_KEY, FileAdvance, FileEntry, Topic, item_entry
from stampede_rt_local.cluster import LocalCluster
from tests.support.files.foreign_files import bag_of_topics, foxglove_file, rosbag, xdf_file
from tests.support.files.recordings import INCARNATION, MS, START, entries, gap, item, topic, write
from tests.support.sharing.shared_cluster import shared_cluster_fixture
from tests.support.waiting import wait_until

cluster = shared_cluster_fixture(hosts=2)


@pytest.fixture
def rt(cluster: LocalCluster) -> Iterator[st.Connection]:
    with st.connect(cluster.address) as connection:
        yield connection


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    """A file with a late item, durations, attributes, a gap and an advance."""
    events = [item_entry(topic(), item(seq, b"%d" % seq, duration=seq, n=str(seq))) for seq in range(1, 11)]
    events += [item_entry(topic(), item(11, b"late", time=START + 4 * MS, content_type="text/plain"))]
    after = [*entries("cam", range(15, 21)), FileAdvance("cam", INCARNATION, START + 20 * MS, 20)]
    return write(tmp_path / "drive.mcap", [*events, gap("cam", 12, 14), *after, *entries("imu", range(1, 11))])


def test_a_replay_has_the_items_advances_and_gaps_of_the_file(rt: st.Connection, drive: Path) -> None:
    summary = rt.replay_file(drive, "one/", speed=0, shift="now").wait()
    assert summary is not None
    assert summary.items == {"one/cam": 17, "one/imu": 10}
    assert (summary.complete, summary.advances, summary.gaps) == (False, 1, (gap("cam", 12, 14),))
    channel = rt.channel("one/cam", create=False)
    found = sorted(channel.get(st.OLDEST, st.NOW), key=lambda one: one.seq)
    shift = found[0].time - (START + MS)
    expected = [seq for seq in range(1, 21) if seq not in (11, 12, 13, 14)]
    assert [one.time - shift for one in found if one.payload != b"late"] == [START + seq * MS for seq in expected]
    assert [(one.duration, one.attributes) for one in found[:10]] == [(seq, {"n": str(seq)}) for seq in range(1, 11)]
    assert (found[10].time - shift, found[10].payload, found[10].content_type) == (
        START + 4 * MS,
        b"late",
        "text/plain",
    )
    assert [one.attributes for one in found[10:13]] == [{}, {"stampede.gap": "3 items COLLECTED"}, {}]
    advance = channel.stats().advance
    assert advance is not None
    assert advance - shift == START + 20 * MS


def test_an_import_with_an_item_out_of_order_that_the_channel_would_refuse_puts_nothing(
    rt: st.Connection, tmp_path: Path
) -> None:
    now = time.time_ns()
    times = (now - 3 * 10**9, now - 2 * 10**9, now - 9 * 10**9)
    events = [item_entry(topic(), item(seq, time=one)) for seq, one in enumerate(times, 1)]
    channel = rt.channel("promised/cam", max_age="1h")
    channel.advance(now - 5 * 10**9)
    with pytest.raises(st.InvalidArgument, match="would refuse items of the file: its producers have promised"):
        rt.import_file(write(tmp_path / "a.mcap", events), "promised/")
    assert channel.stats().accepted == 0


def test_an_item_after_several_gaps_names_each_of_them(rt: st.Connection, tmp_path: Path) -> None:
    gaps = [gap("cam", 2, 4), dataclasses.replace(gap("cam", 5, 9), items=None)]
    path = write(tmp_path / "a.mcap", [*entries("cam", [1]), *gaps, *entries("cam", [10])])
    rt.import_file(path, "gaps/", shift="now").wait()
    found = rt.channel("gaps/cam", create=False).get(st.OLDEST, st.NOW)
    assert [one.attributes for one in found] == [{}, {"stampede.gap": "3 items COLLECTED, ? items COLLECTED"}]


async def test_the_asyncio_client_replays_like_the_blocking_client(cluster: LocalCluster, drive: Path) -> None:
    async with aio.connect(cluster.address) as rt, rt.replay_file(drive, "two/", speed=10.0, shift="now") as player:
        summary = await player.wait()
        assert summary is not None
        assert summary.items == {"two/cam": 17, "two/imu": 10}
        assert len(await (await rt.channel("two/cam", create=False)).get(st.OLDEST, st.NOW)) == 17


def matches_of(rt: st.Connection, left: st.Channel, right: st.Channel, name: str) -> list[object]:
    """Gathers the matches of a group in the background."""
    found: list[object] = []
    stream = rt.group(name, [left, right]).match(per=left, tolerance="10ms", partial=True)
    stream.__enter__()

    def gather() -> None:
        with suppress(st.Unavailable):  # the end of the test closes the connection
            for one in stream:
                found.append((one[left].payload, one[right].payload if right in one else None))

    threading.Thread(target=gather, daemon=True).start()
    return found


def test_a_group_matches_the_same_items_in_the_original_and_in_the_replay(rt: st.Connection, tmp_path: Path) -> None:
    left, right = (rt.channel(f"stereo/{side}", max_age="60s") for side in ("left", "right"))
    original = matches_of(rt, left, right, "stereo")
    base, path = st.now() - 3_000 * MS, tmp_path / "a.mcap"
    with rt.record("stereo/*", path, since="60s"):
        for number in range(60):
            left.put(b"%d" % number, time=base + number * 33 * MS)
            if number % 9:
                right.put(b"%d" % number, time=base + number * 33 * MS + number % 13 * MS)
        for channel in (left, right):
            channel.advance(base + 2_500 * MS)
    wait_until(lambda: len(original) == 60)
    copies = [rt.channel(f"replay/stereo/{side}", max_age="60s") for side in ("left", "right")]
    replayed = matches_of(rt, copies[0], copies[1], "replayed")
    summary = rt.replay_file(path, shift="now", speed=20.0).wait()
    assert summary is not None
    assert summary.complete
    wait_until(lambda: len(replayed) == 60)
    assert replayed == original


def test_a_channel_that_would_refuse_the_items_is_named_before_the_first_one(rt: st.Connection, drive: Path) -> None:
    rt.channel("short/cam", max_age="10s")
    with pytest.raises(st.InvalidArgument, match="'short/cam' would refuse items of the file: it keeps items for 10 s"):
        rt.replay_file(drive, "short/")
    rt.channel("ahead/imu", max_items=100).advance(st.now())
    with pytest.raises(st.InvalidArgument, match=r"'ahead/imu' would refuse .* have promised nothing before"):
        rt.import_file(drive, "ahead/")
    with pytest.raises(st.InvalidArgument, match=r"would refuse .* ahead of the host's clock"):
        rt.import_file(drive, "future/", shift="36500d")
    assert rt.channels("short/*") == rt.channels("short/cam"), "a refused replay creates no channels"
    rt.channel("default/cam").put(b"now")
    with pytest.raises(
        st.InvalidArgument, match="'default/cam' would refuse items of the file: it keeps items for 10 s"
    ):
        rt.import_file(drive, "default/")
    with pytest.raises(st.InvalidArgument, match="none of the chosen topics; it has 'cam', 'imu'"):
        rt.import_file(drive, "default/", channels="nobody")
    for name in ("short/cam", "short/imu", "ahead/cam", "ahead/imu", "future/cam"):
        assert rt.channel(name).stats().accepted == 0


def test_refused_items_are_counted_and_the_first_refusal_is_reported(rt: st.Connection, tmp_path: Path) -> None:
    advance = FileAdvance("cam", INCARNATION, START + 8 * MS, 5)
    path = write(tmp_path / "a.mcap", [*entries("cam", range(1, 6)), advance, *entries("cam", range(6, 11))])
    summary = rt.import_file(path, "refused/").wait()
    assert summary is not None
    assert (summary.items, summary.refused, summary.complete) == ({"refused/cam": 8}, 2, False)
    assert "advance" in summary.first_refusal


def with_policy(name: str, **policy: int) -> list[FileEntry]:
    """Ten items of a channel with this policy."""
    metadata = ((POLICY_KEY, json.dumps(policy)),)
    kind = Topic(name, "application/octet-stream", INCARNATION, metadata=metadata)
    return [item_entry(kind, item(seq)) for seq in range(1, 11)]


def test_an_import_keeps_all_items_of_a_channel_that_held_few(rt: st.Connection, tmp_path: Path) -> None:
    """No host of this cluster has an archive, so the channel that had one keeps its items in memory."""
    few, recorded = with_policy("few", max_items=3), with_policy("recorded", max_items=3, archive_nanos=10**9)
    path = write(tmp_path / "a.mcap", [*few, *recorded])
    summary = rt.import_file(path, "kept/").wait()
    assert summary is not None
    assert (summary.complete, summary.collected) == (True, {})
    assert [len(rt.channel(f"kept/{one}").get(st.OLDEST, st.NEWEST)) for one in ("few", "recorded")] == [10, 10]
    rt.channel("small/few", max_items=3)
    summary = rt.import_file(path, "small/").wait()
    assert summary is not None
    assert (summary.complete, summary.collected) == (False, {"small/few": 7})


def test_a_replay_of_one_topic_does_not_wait_for_the_times_of_others(rt: st.Connection, tmp_path: Path) -> None:
    hour = 3_600_000
    old = [item_entry(topic("old"), item(1)), item_entry(topic("old"), item(2, time=START + 3 * hour * MS))]
    path = write(tmp_path / "a.mcap", [*old, *(item_entry(topic(), item(hour + seq)) for seq in range(1, 11))])
    began = st.now()
    summary = rt.replay_file(path, "alone/", channels="cam", shift="now").wait(60)
    assert summary is not None
    assert summary.items == {"alone/cam": 10}
    assert rt.channel("alone/cam").oldest().time >= began - 1000 * MS


def test_a_part_of_a_file_is_played(rt: st.Connection, drive: Path) -> None:
    summary = rt.replay_file(
        drive, "part/", channels="im*", speed=0, start=START + 3 * MS, end=START + 6 * MS, shift="-1h"
    ).wait()
    assert summary is not None
    assert summary.items == {"part/imu": 3}
    found = rt.channel("part/imu", create=False).get(st.OLDEST, st.NEWEST)
    assert [one.time for one in found] == [START + n * MS - 3_600_000 * MS for n in (3, 4, 5)]
    with pytest.raises(st.InvalidArgument, match="none of the chosen topics"):
        rt.replay_file(drive, channels="other")


def test_a_looped_replay_plays_with_rising_times_until_it_is_stopped(rt: st.Connection, tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", entries("cam", range(1, 6)))
    with rt.replay_file(path, "loop/", loop=True, shift="now") as player:
        channel = rt.channel("loop/cam", create=False)
        wait_until(lambda: channel.stats().accepted >= 12)
    assert player.summary is not None
    assert player.summary.rounds >= 2
    assert player.summary.complete
    found = channel.get(st.OLDEST, st.NEWEST)
    assert [one.seq for one in found] == sorted(one.seq for one in found)
    with pytest.raises(st.InvalidArgument, match="a loop needs"):
        rt.replay_file(path, loop=True, shift="now", speed=2.0)


@pytest.mark.parametrize("ahead", [200, 60_000])
def test_a_loop_goes_on_after_an_advance_beyond_the_last_item(rt: st.Connection, tmp_path: Path, ahead: int) -> None:
    advance = FileAdvance("cam", INCARNATION, START + (5 + ahead) * MS, 5)
    path, name = write(tmp_path / "a.mcap", [*entries("cam", range(1, 6)), advance]), f"beyond-{ahead}/"
    with rt.replay_file(path, name, loop=True, shift="now") as player:
        channel = rt.channel(f"{name}cam", create=False)
        wait_until(lambda: not player.active or channel.stats().accepted >= 12)
    assert player.summary is not None
    assert player.summary.first_refusal == ""
    assert player.summary.rounds >= 2
    assert player.summary.advances >= 2


def test_an_import_that_ends_at_a_damage_says_how_many_items_it_has_put(rt: st.Connection, tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", entries("cam", range(1, 201), b"payload-"), compression="none")
    content = path.read_bytes()
    path.write_bytes(content.replace(b"payload-195", b"payload-915"))
    assert path.read_bytes() != content
    with pytest.raises(st.FileError, match="damaged") as ended:
        rt.import_file(path, "torn/").wait()
    found = len(rt.channel("torn/cam", create=False).get(st.OLDEST, st.NEWEST))
    assert 64 <= found < 195
    assert ended.value.message.endswith(f"; the channels had accepted {found} items before")


def test_two_topics_that_would_become_one_channel_are_refused(rt: st.Connection, tmp_path: Path) -> None:
    both = [item_entry(Topic(name, "json", INCARNATION), item(1)) for name in ("a b", "a\tb")]
    with pytest.raises(st.InvalidArgument, match="would both become channel 'same/a_b'"):
        rt.import_file(write(tmp_path / "a.mcap", both), "same/")


@pytest.mark.parametrize("kind", ["foxglove", "sqlite3", "mcap", "xdf"])
def test_files_of_other_programs_are_imported(rt: st.Connection, tmp_path: Path, kind: str) -> None:
    if kind == "foxglove":
        path, name, count = foxglove_file(tmp_path / "a.mcap"), "pose", 100
    elif kind == "xdf":
        path, name, count = xdf_file(tmp_path / "a.xdf", [(1.0, (1.5,)), (2.0, (2.5,))], []), "EEG", 2
    else:
        plugin = StoragePlugin.SQLITE3 if kind == "sqlite3" else StoragePlugin.MCAP
        path, name, count = rosbag(tmp_path / "bag", plugin), "chatter", 100
    summary = rt.import_file(path, f"{kind}/").wait()
    assert summary is not None
    assert (summary.items, summary.complete) == ({f"{kind}/{name}": count}, True)
    found = rt.channel(f"{kind}/{name}", create=False, codec="json").get(st.OLDEST, st.NEWEST)
    assert len(found) == count
    if kind in ("foxglove", "xdf"):
        assert found[1].value == ({"x": 1} if kind == "foxglove" else [2.5])


def test_the_chosen_topic_of_a_bag_comes_to_now_although_another_topic_lasts_longer(
    rt: st.Connection, tmp_path: Path
) -> None:
    """In an earlier version its last item was two hours old."""
    times = {"/short": range(5_000_000, 5_000_010), "/long": [0, 12_200_000]}
    path, began = bag_of_topics(tmp_path / "bag", StoragePlugin.SQLITE3, times), st.now()
    rt.import_file(path, "bag/", channels="/short", shift="now").wait()
    found = rt.channel("bag/short", create=False)
    assert began - 1000 * MS <= found.newest().time <= st.now() + 1000 * MS
    assert found.newest().time - found.oldest().time == 9 * MS


def test_imported_items_are_the_same_after_a_recording_and_another_import(
    rt: st.Connection, drive: Path, tmp_path: Path
) -> None:
    rt.import_file(drive, "again/").wait()
    channel, path = rt.channel("again/imu", create=False), tmp_path / "b.mcap"
    with rt.record("again/imu", path, since="oldest"):
        pass
    rt.import_file(path, "back/").wait()
    first, second = (
        [(one.time, one.duration, one.payload, one.attributes) for one in rt.channel(name).get(st.OLDEST, st.NEWEST)]
        for name in (channel.name, "back/again/imu")
    )
    assert first == second
    assert len(first) == 10


def test_a_channel_that_is_deleted_during_a_replay_ends_it_with_an_error(rt: st.Connection, tmp_path: Path) -> None:
    events = [item_entry(topic(), item(seq, time=START + seq * 20 * MS)) for seq in range(1, 200)]
    player = rt.replay_file(write(tmp_path / "a.mcap", events), "deleted/", shift="now")
    channel = rt.channel("deleted/cam", create=False)
    wait_until(lambda: channel.stats().accepted > 2)
    channel.delete()
    with pytest.raises(st.StampedeError, match="deleted/cam"):
        player.wait(30)
    assert player.summary is None


def test_a_refused_item_is_counted(rt: st.Connection, tmp_path: Path) -> None:
    attributes = {f"key{number}": "x" * 1000 for number in range(1000)}
    bad = item_entry(topic(), item(2))._replace(attributes=attributes)
    path = write(tmp_path / "a.mcap", [item_entry(topic(), item(1)), bad, item_entry(topic(), item(3))])
    summary = rt.import_file(path, "bad/").wait()
    assert summary is not None
    assert (summary.items, summary.refused, summary.complete) == ({"bad/cam": 2}, 1, False)
    assert "bytes" in summary.first_refusal
