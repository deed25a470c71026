"""Puts with ack="disk" at a real host, and puts that the host refuses because its disk is full. For kills see
tests/robustness/archives.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import redirect_stdout, suppress
from io import StringIO
from pathlib import Path
from typing import Any

import pytest

import stampede_rt as st
import stampede_rt.aio
from stampede_rt.cli.main import main as stampede
from stampede_rt_local.cluster import LocalCluster
from tests.support.channel_host.small_disk import NoSmallDisk, small_disk
from tests.support.cluster import running_cluster

DISK_BYTES = 4 * 2**20


@pytest.fixture(scope="module")
def disk(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A disk of 4 MiB."""
    try:
        with small_disk(tmp_path_factory.mktemp("disk"), DISK_BYTES) as mounted:
            yield mounted
    except NoSmallDisk as error:
        pytest.skip(str(error))


@pytest.fixture(scope="module")
def cluster(disk: Path) -> Iterator[LocalCluster]:
    with running_cluster(hosts=1, supernodes=1, archive=disk) as running:
        yield running


@pytest.fixture
def rt(cluster: LocalCluster) -> Iterator[st.Connection]:
    with st.connect(cluster.address) as connection:
        yield connection


def test_a_put_may_state_another_ack_than_its_channel_if_the_channel_can_give_it(rt: st.Connection) -> None:
    recorded = rt.channel("ack/recorded", max_items=50, archive="forever")
    assert recorded.put(b"on disk", ack="disk").seq == 1
    with recorded.producer(ack="disk") as producer:
        for number in range(600):
            producer.put(b"%d" % number)
    assert (producer.accepted, producer.rejections) == (600, 0)
    waiting = rt.channel("ack/disk", max_items=50, archive="forever", ack="disk")
    assert waiting.put(b"in memory", ack="host").seq == 1
    with pytest.raises(st.InvalidArgument, match="has no replicas"):
        waiting.put(b"no", ack="replica")
    with pytest.raises(st.InvalidArgument, match="is not recorded"):
        rt.channel("ack/plain", max_items=50).put(b"no", ack="disk")
    wrong: Any = "disc"
    with pytest.raises(st.InvalidArgument, match="'host', 'disk', 'replica'"):
        waiting.put(b"no", ack=wrong)
    with pytest.raises(st.InvalidArgument, match="state archive or archive_bytes with it"):
        rt.channel("ack/no-archive", max_items=50, ack="disk")
    assert (rt.channel("ack/plain").newest(), waiting.stats().accepted) == (None, 1)


async def test_a_put_on_asyncio_waits_for_the_disk(cluster: LocalCluster) -> None:
    async with stampede_rt.aio.connect(cluster.address) as rt:
        channel = await rt.channel("ack/aio", max_items=10, archive="1h", ack="disk")
        assert [(await channel.put(b"x")).seq for _ in range(3)] == [1, 2, 3]
        plain = await rt.channel("ack/aio-plain", max_items=10, archive="1h")
        assert (await plain.put(b"x", ack="disk")).seq == 1


@pytest.mark.without_rules("doctor tells an operator more")
def test_a_full_disk_refuses_only_puts_that_wait_for_it_and_doctor_reports_it(
    cluster: LocalCluster, rt: st.Connection, disk: Path
) -> None:
    channel = rt.channel("ack/full", max_items=50, archive="forever", ack="disk")
    channel.put(b"before")
    with (disk / "ballast").open("wb", buffering=0) as ballast:
        with suppress(OSError):
            while ballast.write(b"\0" * 4096):
                pass
        refusals = []
        while len(refusals) < 3:  # the last block of the segment may have space for a few items
            try:
                channel.put(b"x" * 2000, timeout=30)
            except st.NotArchived as error:
                refusals.append(error)
        assert "No space left" in str(refusals[0])
        assert ("seq" in refusals[0].metadata, "seq" in refusals[-1].metadata) == (True, False)
        doctor = StringIO()
        with redirect_stdout(doctor):
            stampede(["doctor", "--url", cluster.address])
        assert "its archive takes no items of 1 channel: No space left on device. Free its disk" in doctor.getvalue()
        seq = channel.put(b"live", ack="host").seq
        assert channel.newest().payload == b"live"
        with channel.producer() as producer:
            producer.put(b"refused")
            with pytest.raises(st.NotArchived):
                producer.flush()
        (disk / "ballast").unlink()
    while True:
        try:
            after = channel.put(b"after", timeout=30)
            break
        except st.NotArchived:
            continue
    assert after.seq == seq + 1
    found = channel.get(st.OLDEST, st.NEWEST)
    assert [item.seq for item in found] == [*range(1, after.seq + 1)]
