"""A rolling upgrade with real processes of two releases that really differ (tests/support/newer_release.py)."""

from __future__ import annotations

import asyncio
import secrets
import signal
import sys
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from stampede_rt.cli.supernode import administer
from stampede_rt.errors import VersionMismatch
from stampede_rt.v1 import directory_service_pb2 as pb
from stampede_rt.v1.channel_pb2 import ChannelSpec, RetentionPolicy
from tests.support.newer_release import NEW_KIND, NEW_LEVEL
from tests.support.supernode.processes import (
    Cluster,
    Supernode,
    attempts,
    called,
    clean_environment,
    open_channel,
    register,
    resolve,
    running_cluster,
)

OLD_LEVEL = NEW_LEVEL - 1
NEWER = "tests.support.newer_release"


@pytest.fixture
async def cluster(tmp_path: Path) -> AsyncIterator[Cluster]:
    async with running_cluster(tmp_path, "--lease-ttl", "1h") as cluster:
        yield cluster


async def cap(one: Supernode) -> pb.UpdateChannelResponse:
    """Let the channel hold one item: the newer release has a command of its own for it."""
    channel = (await resolve(one, "cam")).channel
    request = pb.UpdateChannelRequest(
        request_id=secrets.token_bytes(16),
        channel_id=channel.channel_id,
        epoch=channel.epoch,
        spec=ChannelSpec(retention=RetentionPolicy(max_items=1)),
    )
    answer: pb.UpdateChannelResponse = await called(one.stub.UpdateChannel(request, timeout=20), one)
    return answer


async def levels(one: Supernode) -> tuple[int, int]:
    pong = await called(one.stub.Ping(pb.DirectoryServicePingRequest(), timeout=5), one)
    return pong.feature_level, pong.highest_feature_level


async def upgraded(one: Supernode, number: int) -> None:
    await one.end(signal.SIGTERM)
    one.module = NEWER
    await one.start()
    await open_channel(one, f"after-{number}")


async def risen(cluster: Cluster) -> None:
    async for _ in attempts():
        if all([await levels(one) == (NEW_LEVEL, NEW_LEVEL) for one in cluster.supernodes]):
            return


async def test_members_are_upgraded_one_by_one_and_the_new_command_works_when_all_know_it(
    cluster: Cluster, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first, second, third = cluster.supernodes
    await register(first, 1)
    await open_channel(first, "cam")
    for number, one in enumerate((first, second)):
        await upgraded(one, number)
        assert await levels(one) == (OLD_LEVEL, NEW_LEVEL)
        with pytest.raises(VersionMismatch, match=f"{NEW_KIND} needs feature level {NEW_LEVEL}") as caught:
            await cap(one)
        assert third.name in caught.value.metadata["supernodes_behind"].split(",")
    assert await asyncio.to_thread(administer, ["status", "--member", first.address]) == 0
    printed = capsys.readouterr().out
    advice = f"upgrade {third.name}; the level then rises by itself"
    assert f"Feature level {OLD_LEVEL}, and not all supernodes know {NEW_LEVEL}; {advice}" in printed

    await upgraded(third, 2)
    await risen(cluster)
    for one in cluster.supernodes:
        assert (await cap(one)).channel.spec.retention.max_items == 1
        assert (await resolve(one, "after-1")).channel.name == "after-1"
    assert await asyncio.to_thread(administer, ["status", "--member", first.address]) == 0
    assert f"Feature level {NEW_LEVEL}." in capsys.readouterr().out

    await third.end(signal.SIGKILL)
    third.module = "stampede_rt_supernode"
    code, why = await third.refused()
    assert code == 1
    assert f"feature level {OLD_LEVEL}, and the cluster is at level {NEW_LEVEL}" in why
    assert "the release of the others and the same data folder" in why
    assert "Traceback" not in why
    third.module = NEWER
    await third.start()
    assert (await resolve(third, "cam")).channel.spec.retention.max_items == 1
    await only_newer_ones_restore(first, tmp_path)


async def only_newer_ones_restore(one: Supernode, folder: Path) -> None:
    backup, new = folder / "backup", folder / "restored"
    arguments = ["snapshot", one.name, "--member", one.address, "--out", str(backup)]
    assert await asyncio.to_thread(administer, arguments) == 0
    restore = ["init", "--data-dir", str(new), "--listen", "127.0.0.1:7999", "--restore", str(backup)]
    code, output = await ran("stampede_rt_supernode", *restore)
    assert code == 1
    assert f"holds a directory at feature level {NEW_LEVEL}, and this release knows level {OLD_LEVEL}" in output
    assert not new.exists()
    code, output = await ran(NEWER, *restore)
    assert (code, output) == (0, "")


async def ran(module: str, *arguments: str) -> tuple[int | None, str]:
    """Exit code and stderr."""
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", module, *arguments),
        stdout=asyncio.subprocess.DEVNULL,
        stderr=asyncio.subprocess.PIPE,
        env=clean_environment(),
    )
    _, output = await process.communicate()
    return process.returncode, output.decode()
