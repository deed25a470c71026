"""Recorded channels of real hosts whose archive is in an object store, on a real S3 server."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from itertools import takewhile
from pathlib import Path

import pytest

import stampede_rt as st
from stampede_rt.cli.main import main as stampede
from stampede_rt_local.cluster import LocalCluster
from tests.support.channel_host.recording_guide import check_guide
from tests.support.channel_host.s3_server import BUCKET, S3Server, s3_server
from tests.support.cluster import running_cluster
from tests.support.waiting import wait_until

MS = 10**6
ITEMS, HELD = 100, 8


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[S3Server]:
    """A store; the processes that a test starts have its credentials in their environment."""
    with s3_server(tmp_path_factory.mktemp("s3")) as running, pytest.MonkeyPatch.context() as patch:
        for name, value in running.environment.items():
            patch.setenv(name, value)
        yield running


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("archive")


@pytest.fixture(scope="module")
def cluster(server: S3Server, folder: Path) -> Iterator[LocalCluster]:
    """Two hosts with one object store, which close their files after a second."""
    planned = LocalCluster(hosts=2, supernodes=1, archive=f"s3://{BUCKET}/rig", archive_folder=folder)
    for host in planned.hosts:
        host.arguments += ["--archive-move-seconds", "1"]
    with running_cluster(planned) as running:
        yield running


@pytest.fixture
def rt(cluster: LocalCluster) -> Iterator[st.Connection]:
    with st.connect(cluster.address) as connection:
        yield connection


def filled(rt: st.Connection, name: str, host: str, **policy: object) -> tuple[st.Channel, int]:
    channel = rt.channel(name, host=host, max_items=HELD, archive="7d", **policy)  # type: ignore[arg-type]
    began = time.time_ns() - 10**9
    put(channel, began, 0, ITEMS)
    return channel, began


def put(channel: st.Channel, began: int, first: int, end: int) -> None:
    for number in range(first, end):
        channel.put(b"%d" % number, time=began + number * MS)


def numbers(items: st.Items) -> list[int]:
    return [int(item.payload) for item in items]


def objects(server: S3Server, channel: st.Channel) -> list[Path]:
    return [*(server.folder / "rig" / "channels" / channel.info.channel_id.hex()).glob("*.segment")]


def moved(server: S3Server, folder: Path, channel: st.Channel, host: str) -> None:
    """Wait until all files of a channel have moved from a host."""
    local = folder / host / "channels" / channel.info.channel_id.hex()
    wait_until(lambda: objects(server, channel) and not [*local.glob("*.segment")], "the files have moved")


def test_an_archive_in_an_object_store_equals_one_in_a_folder_and_follows_a_move(
    server: S3Server, folder: Path, cluster: LocalCluster, rt: st.Connection
) -> None:
    channel, began = filled(rt, "rig/moves", "h1")
    moved(server, folder, channel, "h1")
    assert numbers(channel.get(began, st.NOW)) == list(range(ITEMS))
    assert channel.oldest().payload == b"0"
    assert numbers(channel.at(began + 7 * MS + 5)) == [7]
    put(channel, began, ITEMS, ITEMS + 20)  # the file with these items is still open when the channel moves
    assert stampede(["move", "rig/moves", "h2", "--url", cluster.address]) == 0
    put(channel, began, ITEMS + 20, ITEMS + 30)
    whole = list(range(ITEMS + 30))
    with suppress(AssertionError):  # the assertion below names the missing items
        wait_until(lambda: numbers(channel.get(began, st.NOW)) == whole, within_seconds=20)
    missing = sorted({*whole} - {*numbers(channel.get(began, st.NOW))})
    assert not missing, (
        f"the former owner has not moved its last file; objects: {sorted(map(str, objects(server, channel)))}"
    )
    found = channel.get(began, began + (ITEMS + 29) * MS)
    assert (found.truncated, found.reason) == (False, None)
    with channel.subscribe(start=began) as items:
        put(channel, began, ITEMS + 30, ITEMS + 31)  # ends the wait, also if an item is missing
        got = [int(item.payload) for item in takewhile(lambda item: item.payload != b"%d" % (ITEMS + 30), items)]
    assert got == whole


def test_the_next_owner_of_a_channel_serves_the_items_that_its_lost_host_had_moved(
    server: S3Server, folder: Path, cluster: LocalCluster, rt: st.Connection, tmp_path: Path
) -> None:
    channel, began = filled(rt, "rig/lost", "h1")
    moved(server, folder, channel, "h1")
    cluster.hosts[0].kill()
    try:
        wait_until(lambda: rt.channel("rig/lost").info.host == "h2", "the directory has found another host")
        channel = rt.channel("rig/lost")
        assert numbers(channel.get(began, began + (ITEMS - 1) * MS)) == list(range(ITEMS))
        assert channel.get(began + ITEMS * MS, st.NOW).reason == "LOST"
        for number in range(3):  # the next seq is far above the last item
            with rt.record(["rig/lost"], tmp_path / f"{number}.mcap", since="1h", for_="0s") as recording:
                (counts,) = recording.wait().channels
            assert (counts.recorded, counts.missing, [one.reason for one in counts.gaps]) == (ITEMS, 0, ["LOST"])
        put(channel, began, ITEMS, ITEMS + 5)
        assert numbers(channel.get(began, st.NOW)) == list(range(ITEMS + 5))
    finally:
        cluster.hosts[0].restart()


def test_after_a_clean_stop_the_next_owner_of_a_channel_says_that_nothing_is_lost(
    cluster: LocalCluster, rt: st.Connection
) -> None:
    channel, began = filled(rt, "rig/stopped", "h1")
    cluster.hosts[0].stop()
    try:
        wait_until(lambda: rt.channel("rig/stopped").info.host == "h2", "the directory has found another host")
        channel = rt.channel("rig/stopped")
        put(channel, began, ITEMS, ITEMS + 5)
        found = channel.get(began, began + (ITEMS + 4) * MS)
        assert (numbers(found), found.reason, found.truncated) == (list(range(ITEMS + 5)), None, False)
    finally:
        cluster.hosts[0].restart()


def test_deleting_a_channel_deletes_its_objects(server: S3Server, folder: Path, rt: st.Connection) -> None:
    channel, _ = filled(rt, "rig/deleted", "h2")
    moved(server, folder, channel, "h2")
    path = objects(server, channel)[0].parent
    channel.delete()
    wait_until(lambda: not [*path.glob("*.segment")] if path.exists() else True)


def test_live_readers_are_served_while_the_store_is_unreachable_and_doctor_names_the_reason(
    server: S3Server, folder: Path, cluster: LocalCluster, rt: st.Connection, capsys: pytest.CaptureFixture[str]
) -> None:
    channel, began = filled(rt, "rig/away", "h2", ack="disk")
    moved(server, folder, channel, "h2")
    server.stop()
    put(channel, began, ITEMS, ITEMS + 20)
    wait_until(lambda: channel.stats().held == HELD)
    assert numbers(channel.get(began + (ITEMS + 15) * MS, st.NOW)) == list(range(ITEMS + 15, ITEMS + 20))
    assert channel.newest().payload == b"%d" % (ITEMS + 19)

    def doctor_output() -> str:
        stampede(["doctor", "--url", cluster.address])
        return capsys.readouterr().out

    wait_until(lambda: "store fails" in doctor_output(), "doctor names the store")
    assert "s3://archives/rig" in doctor_output()
    server.start()
    moved(server, folder, channel, "h2")
    assert numbers(channel.get(began, st.NOW)) == list(range(ITEMS + 20))


@pytest.mark.parametrize("end", ["kill", "stop"])
def test_a_host_that_starts_while_the_store_is_unreachable_serves_its_own_items_and_catches_up(
    server: S3Server, folder: Path, cluster: LocalCluster, rt: st.Connection, end: str
) -> None:
    name = f"rig/started-{end}"
    channel, began = filled(rt, name, "h2", ack="disk")
    moved(server, folder, channel, "h2")
    server.stop()
    try:
        put(channel, began, ITEMS, ITEMS + 20)
        getattr(cluster.hosts[1], end)()
        cluster.hosts[1].restart()
        channel = rt.channel(name)
        assert channel.newest().payload == b"%d" % (ITEMS + 19)
        with channel.subscribe() as live:
            put(channel, began, ITEMS + 20, ITEMS + 30)
            assert next(live).payload == b"%d" % (ITEMS + 20)
        found = channel.get(began + (ITEMS + 20) * MS, st.NEWEST)
        assert numbers(found) == list(range(ITEMS + 20, ITEMS + 30))
        assert (found.reason == "LOST") == (end == "kill")  # some items may have come shortly before the kill
        wait_until(lambda: "the object store s3://archives/rig says" in refusal(channel, began), "the reason is told")
        new = rt.channel(f"rig/new-{end}", host="h2", archive="7d")
        new.put(b"recorded", ack="disk")
    finally:
        server.start()
    wait_until(lambda: answers(channel, began) == list(range(ITEMS + 30)), "the host has caught up")
    assert channel.get(began, began + 5 * MS).reason is None
    moved(server, folder, channel, "h2")
    assert numbers(channel.get(began, began + (ITEMS + 29) * MS)) == list(range(ITEMS + 30))


def test_a_host_that_takes_a_channel_over_while_the_store_is_unreachable_serves_it_immediately_and_catches_up(
    server: S3Server, folder: Path, cluster: LocalCluster, rt: st.Connection
) -> None:
    channel, began = filled(rt, "rig/taken", "h1")
    moved(server, folder, channel, "h1")
    server.stop()
    cluster.hosts[0].kill()
    try:
        wait_until(lambda: rt.channel("rig/taken").info.host == "h2", "the directory has found another host")
        channel = rt.channel("rig/taken")
        with channel.subscribe() as live:
            channel.put(b"100")
            assert next(live).payload == b"100"
            later = time.time_ns() + 10**9  # max_future: items of the former owner may have such times
            wait_until(lambda: time.time_ns() > later, "max_future has passed")
            taken = time.time_ns()
            put(channel, taken, 1, 5)
            assert [int(next(live).payload) for _ in range(4)] == [1, 2, 3, 4]
        assert channel.newest().payload == b"4"
        assert numbers(channel.get(taken, st.NOW)) == [100, 1, 2, 3, 4]
        assert numbers(channel.get(began, st.NOW, within="memory")) == [100, 1, 2, 3, 4]
        assert "while the object store of its archive was unreachable" in refusal(channel, began)
    finally:
        server.start()
        cluster.hosts[0].restart()
    wait_until(lambda: answers(channel, began) == [*range(ITEMS), 100, 1, 2, 3, 4], "the host has caught up")
    assert channel.get(began, began + (ITEMS - 2) * MS).reason is None
    moved(server, folder, channel, "h2")
    assert answers(channel, began) == [*range(ITEMS), 100, 1, 2, 3, 4]


def refusal(channel: st.Channel, began: int) -> str:
    """Why the host cannot read moved items. On a busy machine the last try of the client may end at the directory."""
    with pytest.raises(st.Unavailable) as caught:
        channel.get(began, began + 5 * MS)
    return str(caught.value)


def answers(channel: st.Channel, began: int) -> list[int]:
    """All numbers, as soon as the host can read them."""
    try:
        return numbers(channel.get(began, st.NEWEST))
    except st.Unavailable:
        return []


def test_every_example_of_the_guide_holds_with_an_archive_in_an_object_store(
    cluster: LocalCluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    check_guide(cluster, monkeypatch)


def test_a_host_that_is_killed_during_an_upload_neither_loses_nor_repeats_items(
    server: S3Server, folder: Path, cluster: LocalCluster, rt: st.Connection
) -> None:
    channel, began = filled(rt, "rig/killed", "h2", ack="disk")
    local = folder / "h2" / "channels" / channel.info.channel_id.hex()
    server.freeze(frozen=True)
    count = ITEMS

    def put_one() -> bool:
        nonlocal count
        put(channel, began, count, count + 1)
        count += 1
        return len([*local.glob("*.segment")]) > 1

    wait_until(put_one, "the first file is closed, so its upload has begun")
    cluster.hosts[1].kill()
    server.freeze(frozen=False)
    cluster.hosts[1].restart()
    channel = rt.channel("rig/killed")
    assert numbers(channel.get(began, began + (count - 1) * MS)) == list(range(count))
    moved(server, folder, channel, "h2")
    assert numbers(channel.get(began, began + (count - 1) * MS)) == list(range(count))


def test_a_host_with_wrong_credentials_exits_with_the_reason(
    server: S3Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "wrong-secret")
    secret = tmp_path / "secret"
    secret.write_text("0" * 64)
    secret.chmod(0o600)
    words = [
        "host",
        "--archive",
        f"s3://{BUCKET}/rig",
        "--archive-folder",
        str(tmp_path / "a"),
        "--secret-file",
        str(secret),
    ]
    done = subprocess.run(
        [sys.executable, "-m", "stampede_rt_channel_host", *words[1:]],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 2
    assert "--archive: the object store s3://archives/rig says" in done.stderr
    assert "wrong-secret" not in done.stderr + done.stdout
