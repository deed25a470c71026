"""Recorded channels of a host inside a program: by reference, on the disk, and over restarts, kills and forks."""

from __future__ import annotations

import asyncio
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

import stampede_rt as st
from stampede_rt import aio
from stampede_rt_channel_host.archive import host_archive
from stampede_rt_channel_host.archive.segment_files import SegmentFiles
from stampede_rt_local.cluster import LocalCluster
from tests.support.channel_host.small_disk import NoSmallDisk, small_disk
from tests.support.cluster import cluster_fixture
from tests.support.waiting import pause, wait_until

pytestmark = pytest.mark.without_rules("a client token cannot host channels")
cluster = cluster_fixture(hosts=1, supernodes=1)
LIMIT_S = 90


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "archive"


def seqs_of(items: st.Items) -> list[int]:
    return [one.seq for one in items]


def test_a_recorded_channel_is_at_the_host_with_the_archive_and_reads_go_over_archive_and_memory(
    cluster: LocalCluster, folder: Path
) -> None:
    with st.host(cluster.address, archive=folder, drain="0s") as rt, st.connect(cluster.address) as other:
        channel = rt.channel("emb-rec/reads", max_items=10, archive="7d")
        assert other.channel("emb-rec/of-another-program", archive="1h").host == channel.host
        assert channel.host in {one.name for one in rt.hosts() if one.alive}
        payloads = [b"%d" % number for number in range(100)]
        for number, payload in enumerate(payloads):
            channel.put(payload, time=1000 + number)
        wait_until(lambda: channel.stats().held == 10)
        newest, late = channel.newest(), channel.at(1095)[0]
        assert newest is not None
        assert (newest.payload is payloads[-1], late.payload is payloads[95]) == (True, True)
        recent = channel.get(1090, 1099)
        assert [one.payload is put for one, put in zip(recent, payloads[90:], strict=True)] == [True] * 10
        assert [one.payload for one in channel.get(st.OLDEST, st.NEWEST)] == payloads
        assert [one.payload for one in channel.get(st.OLDEST, st.NEWEST, within="memory")] == payloads[90:]
        oldest, before = channel.oldest(), channel.before(1050)
        assert oldest is not None
        assert before is not None
        assert (oldest.payload, before.payload, channel.at(1005)[0].payload) == (b"0", b"49", b"5")
        assert [one.payload for one in other.channel("emb-rec/reads").get(1085, 1094)] == payloads[85:95]
        known = channel.stats().host_time
        channel.put(b"late", time=1097)
        assert [one.payload for one in channel.get(1097, 1097)] == [b"97", b"late"]
        assert [one.payload for one in channel.get(1097, 1097, as_of=known)] == [b"97"]
        with channel.subscribe(start=1000) as items:
            assert [next(items).payload for _ in range(3)] == [b"0", b"1", b"2"]


def test_puts_and_runs_by_reference_wait_for_the_disk(
    cluster: LocalCluster, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(host_archive, "WRITE_AFTER_SECONDS", 1e6)  # only a put that waits makes the archive write
    with st.host(cluster.address, archive=folder, drain="0s") as rt:
        channel = rt.channel("emb-rec/disk", max_items=2000, archive="7d")
        frame = os.urandom(300_000)
        assert channel.put(frame, ack="disk").seq == 1
        assert frame in written(folder)
        channel.put(b"in memory")
        with channel.producer(ack="disk") as producer:
            for number in range(1500):
                producer.put(b"run %d" % number)
            producer.put(frame)
        assert (producer.accepted, producer.rejections) == (1501, 0)
        assert written(folder).count(frame) == 2
        newest = channel.newest()
        assert newest is not None
        assert newest.payload is frame
        waiting = rt.channel("emb-rec/disk-by-policy", max_items=10, archive="7d", ack="disk")
        with waiting.producer() as by_policy:
            by_policy.put(b"the policy waits, too")
        assert b"the policy waits, too" in written(folder)
        waiting.put(b"and a put")
        assert b"and a put" in written(folder)
        with pytest.raises(st.InvalidArgument, match="is not recorded"):
            rt.channel("emb-rec/plain", max_items=10).put(b"no", ack="disk")
        with pytest.raises(st.InvalidArgument, match="has no replicas"):
            channel.put(b"no", ack="replica")


def written(folder: Path) -> bytes:
    """The bytes of all files of an archive."""
    return b"".join(path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file())


def test_a_restart_with_the_same_folder_goes_on_with_the_channel(cluster: LocalCluster, folder: Path) -> None:
    with st.host(cluster.address, archive=folder, drain="0s") as rt:
        channel = rt.channel("emb-rec/restart", max_items=5, archive="7d")
        with channel.producer() as producer:
            for number in range(20):
                producer.put(b"%d" % number, time=1000 + number)
        incarnation = channel.incarnation
    with st.host(cluster.address, archive=str(folder), drain="0s") as rt:
        channel = rt.channel("emb-rec/restart", create=False)
        assert (channel.incarnation, channel.put(b"20", time=1020).seq) == (incarnation, 21)
        found = channel.get(st.OLDEST, st.NEWEST)
        assert ([one.payload for one in found], found.reason) == ([b"%d" % number for number in range(21)], None)


def test_the_example_of_the_page_runs(cluster: LocalCluster, folder: Path) -> None:
    page = (Path(__file__).resolve().parents[3] / "docs" / "embedding.md").read_text()
    (block,) = [
        one for one in re.findall(r"^```python\n(.*?)^```", page, re.MULTILINE | re.DOTALL) if "/data/rig" in one
    ]
    code = block.replace("localhost:7580", cluster.address).replace("/data/rig", str(folder))
    exec(compile(code, "embedding.md", "exec"), {"st": st, "frame": os.urandom(300_000)})


def test_a_folder_belongs_to_one_host_of_a_process(cluster: LocalCluster, folder: Path) -> None:
    with st.host(cluster.address, archive=folder, drain="0s"):
        with pytest.raises(st.InvalidArgument, match=r"archive: another host uses the folder .* its own folder"):
            st.host(cluster.address, archive=folder, drain="0s")
        with st.host(cluster.address, archive=folder.with_name("second"), drain="0s") as second:
            assert second.channel("emb-rec/second", archive="1h").put(b"x", ack="disk").seq == 1
    with st.host(cluster.address, archive=folder, drain="0s"):
        pass  # the first one has left the folder


@pytest.mark.parametrize(
    ("place", "message"),
    [
        ("", "archive is ''; give a folder"),
        (b"bytes", "archive is b'bytes'; give a folder"),
        ("ftp://host/folder", r"archive: 'ftp://host/folder' cannot be used; allowed: .* object store: s3://"),
        ("s3://me:secret@host/folder", r"archive: 's3://\.\.\.@host/folder' cannot be used; allowed: a URL without"),
        ("/dev/null/archive", r"archive: /dev/null/archive cannot be used: Not a directory"),
    ],
)
def test_a_place_that_cannot_be_an_archive_is_named(cluster: LocalCluster, place: str, message: str) -> None:
    with pytest.raises(st.InvalidArgument, match=message):
        st.host(cluster.address, archive=place)


def test_the_folder_of_another_host_is_refused_with_the_names_of_this_interface(
    cluster: LocalCluster, folder: Path
) -> None:
    folder.mkdir()
    (folder / "owner").write_text("0f" * 16)
    with pytest.raises(st.InvalidArgument, match=r"archive: the folder .* is the archive of host 0f0f") as refused:
        st.host(cluster.address, archive=folder)
    assert "`stampede host` with the --data-dir whose file host-id" in refused.value.message
    assert "data_dir" not in refused.value.message


def test_an_embedded_host_does_not_read_the_archive_of_the_environment(
    cluster: LocalCluster, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("STAMPEDE_ARCHIVE", str(folder))
    with st.host(cluster.address, drain="0s") as rt, pytest.raises(st.InvalidArgument, match="archive"):
        rt.channel("emb-rec/environment", archive="1h")
    assert not folder.exists()


def test_an_archive_in_an_object_store_has_a_folder_beside_it(cluster: LocalCluster, folder: Path) -> None:
    store = f"file://{folder}/store"
    (folder / "store").mkdir(parents=True)
    with st.host(cluster.address, archive=store, archive_folder=folder / "local", drain="0s") as rt:
        assert rt.channel("emb-rec/objects", max_items=5, archive="7d").put(b"moved", ack="disk").seq == 1
    assert b"moved" in written(folder / "store")
    with pytest.raises(st.InvalidArgument, match="archive_folder is the folder of an archive in an object store"):
        st.host(cluster.address, archive=folder, archive_folder=folder)


def test_max_archive_refuses_puts_beyond_it(cluster: LocalCluster, folder: Path) -> None:
    with st.host(cluster.address, archive=folder, max_archive="4MiB", drain="0s") as rt:
        channel = rt.channel("emb-rec/full", max_items=5, archive="7d")
        with pytest.raises(st.Overloaded, match="archive"):
            [channel.put(bytes(500_000), timeout=0) for _ in range(20)]


async def test_asyncio_puts_by_reference_wait_for_the_disk_and_a_cancelled_one_ends(
    cluster: LocalCluster, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with aio.host(cluster.address, archive=folder, drain="0s") as rt:
        channel = await rt.channel("emb-rec/aio", max_items=10, archive="1h", ack="disk")
        assert [(await channel.put(b"x")).seq for _ in range(3)] == [1, 2, 3]
        begin, may_continue = asyncio.Event(), asyncio.Event()
        loop, write = asyncio.get_running_loop(), SegmentFiles.write

        def slow(*arguments: object) -> object:
            loop.call_soon_threadsafe(begin.set)
            asyncio.run_coroutine_threadsafe(may_continue.wait(), loop).result(LIMIT_S)
            return write(*arguments)  # type: ignore[arg-type]

        monkeypatch.setattr(SegmentFiles, "write", slow)
        putting = asyncio.create_task(channel.put(b"cancelled"))
        await asyncio.wait_for(begin.wait(), LIMIT_S)
        putting.cancel()
        with suppress(asyncio.CancelledError):
            await putting
        with pytest.raises(st.NotArchived, match="the disk is too slow"):
            await channel.put(b"late", timeout=0.01)
        may_continue.set()
        assert (await channel.put(b"next")).seq == 6
        found = await channel.get(st.OLDEST, st.NEWEST)
        assert [one.payload for one in found] == [b"x", b"x", b"x", b"cancelled", b"late", b"next"]


def test_a_full_disk_refuses_only_puts_that_wait_for_it(cluster: LocalCluster, tmp_path: Path) -> None:
    try:
        with small_disk(tmp_path, 4 * 2**20) as disk, st.host(cluster.address, archive=disk, drain="0s") as rt:
            channel = rt.channel("emb-rec/full-disk", max_items=50, archive="forever", ack="disk")
            channel.put(b"before")
            with (disk / "ballast").open("wb", buffering=0) as ballast, suppress(OSError):
                while ballast.write(b"\0" * 4096):
                    pass
            refusals = []
            while len(refusals) < 2:  # the last block of the segment may have room for a few
                try:
                    channel.put(b"x" * 2000, timeout=30)
                except st.NotArchived as error:
                    refusals.append(error)
            assert "No space left" in str(refusals[0])
            channel.put(b"live", ack="host")
            newest = channel.newest()
            assert newest is not None
            assert newest.payload == b"live"
            with channel.producer() as producer:
                producer.put(b"refused")
                with pytest.raises(st.NotArchived):
                    producer.flush()
            (disk / "ballast").unlink()
            while True:
                try:
                    last = channel.put(b"after", timeout=30)
                    break
                except st.NotArchived:
                    continue
            assert seqs_of(channel.get(st.OLDEST, st.NEWEST)) == [*range(1, last.seq + 1)]
    except NoSmallDisk as error:
        pytest.skip(str(error))


@contextmanager
def program(cluster: LocalCluster, folder: Path, source: str) -> Iterator[subprocess.Popen[str]]:
    """A program that is a host with an archive. The block gets its process."""
    started = subprocess.Popen(
        [sys.executable, "-c", f"import os, signal, sys\nimport stampede_rt as st\n{source}", str(folder)],
        env={**os.environ, "STAMPEDE_URL": cluster.address}, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        yield started
    finally:
        started.kill()
        started.communicate(timeout=LIMIT_S)


def line_of(started: subprocess.Popen[str]) -> str:
    assert started.stdout is not None
    return started.stdout.readline().strip()


def test_a_killed_program_loses_no_put_that_the_disk_has_acknowledged(cluster: LocalCluster, folder: Path) -> None:
    source = """
rt = st.host(archive=sys.argv[1])
channel = rt.channel("emb-rec/killed", max_items=20, archive="7d")
number = 0
while True:
    if number % 3:
        seq = channel.put(b"%d" % number, ack="disk").seq
    else:
        with channel.producer(ack="disk") as producer:
            producer.put(b"%d" % number)
        seq = channel.newest().seq
    print(seq, number, flush=True)
    number += 1
"""
    acknowledged = []
    with program(cluster, folder, source) as started:
        while len(acknowledged) < 50:
            acknowledged.append(line_of(started))
        started.kill()
        assert started.stdout is not None
        acknowledged += [line for line in started.stdout.read().splitlines() if line.count(" ") == 1]
    with st.host(cluster.address, archive=folder, drain="0s") as rt:
        found = rt.channel("emb-rec/killed", create=False).get(st.OLDEST, st.NEWEST)
        have = {one.seq: one.payload for one in found}
        for line in acknowledged:
            seq, number = map(int, line.split())
            assert have[seq] == b"%d" % number


def test_a_program_that_forgets_to_close_archives_everything(cluster: LocalCluster, folder: Path) -> None:
    source = """
rt = st.host(archive=sys.argv[1])
channel = rt.channel("emb-rec/forgotten", max_items=5, archive="7d")
for number in range(20):
    channel.put(b"%d" % number)
print(channel.incarnation)
"""
    with program(cluster, folder, source) as started:
        incarnation = int(line_of(started))
        assert started.wait(LIMIT_S) == 0
    with st.host(cluster.address, archive=folder, drain="0s") as rt:
        channel = rt.channel("emb-rec/forgotten", create=False)
        found = channel.get(st.OLDEST, st.NEWEST)
        assert (channel.incarnation, seqs_of(found), found.reason) == (incarnation, [*range(1, 21)], None)


def test_a_forked_child_neither_writes_the_archive_nor_keeps_its_folder(cluster: LocalCluster, folder: Path) -> None:
    source = """
rt = st.host(archive=sys.argv[1])
channel = rt.channel("emb-rec/forked", max_items=5, archive="7d")
channel.put(b"before", ack="disk")
child = os.fork()
if child == 0:
    try:
        channel.put(b"of the child", ack="disk")
    except st.ForkedProcess:
        rt.close()
        print(os.getpid(), flush=True)
    sys.stdin.readline()
    os._exit(0)
signal.pause()
"""
    with program(cluster, folder, source) as started:
        child = int(line_of(started))
        try:
            with pytest.raises(st.InvalidArgument, match="another host uses the folder"):
                st.host(cluster.address, archive=folder, drain="0s")
            started.kill()
            started.wait(LIMIT_S)
            with st.host(cluster.address, archive=folder, drain="0s") as rt:
                found = rt.channel("emb-rec/forked", create=False).get(st.OLDEST, st.NEWEST)
                assert [one.payload for one in found] == [b"before"]
                os.kill(child, 0)  # the child still runs
        finally:
            os.kill(child, signal.SIGKILL)


async def test_a_host_that_closes_while_its_puts_run_keeps_all_that_it_acknowledged(
    cluster: LocalCluster, folder: Path
) -> None:
    acknowledged: list[int] = []

    async def put_on(channel: aio.Channel) -> None:
        with suppress(st.StampedeError):
            while True:
                acknowledged.append((await channel.put(b"x", ack="disk")).seq)

    rt = await aio.host(cluster.address, archive=folder, drain="0s")
    channel = await rt.channel("emb-rec/closes", max_items=5, archive="7d")
    putters = [asyncio.create_task(put_on(channel)) for _ in range(4)]
    while len(acknowledged) < 20:
        await pause()
    await rt.aclose()
    await asyncio.wait(putters, timeout=LIMIT_S)
    async with aio.host(cluster.address, archive=folder, drain="0s") as restarted:
        found = await (await restarted.channel("emb-rec/closes", create=False)).get(st.OLDEST, st.NEWEST)
        assert set(acknowledged) <= set(seqs_of(found))
        assert found.reason is None
