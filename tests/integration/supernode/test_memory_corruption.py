"""A bit flips in the memory of one supernode, perhaps the leader.

A supernode that differs from most reports it, and stops serving.
"""

from __future__ import annotations

import signal
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from stampede_rt.errors import Unavailable
from stampede_rt.v1 import channel_pb2
from stampede_rt.v1 import directory_service_pb2 as pb
from tests.support.memory_corruption import CORRUPTED_PREFIX, FLIP_FILE
from tests.support.supernode.commands import command, prepared, status_has
from tests.support.supernode.processes import Cluster, Supernode, attempts, called, free_ports, open_channel, register

MODULE = "tests.support.memory_corruption"
NAME = f"{CORRUPTED_PREFIX}cam"


@asynccontextmanager
async def three(folder: Path) -> AsyncIterator[Cluster]:
    cluster = Cluster(folder, "--lease-ttl", "60s")
    for one in cluster.supernodes:
        one.module = MODULE
    await cluster.start()
    try:
        yield cluster
    finally:
        await cluster.close()


async def flip(one: Supernode, folder: Path, ask: Supernode) -> None:
    """Flip a bit at `one`. A later command shows the effect."""
    (folder / one.name / FLIP_FILE).touch()
    await register(ask, 1)
    channel = (await open_channel(ask, NAME)).channel
    spec = channel_pb2.ChannelSpec(retention=channel_pb2.RetentionPolicy(max_items=7))
    request = pb.UpdateChannelRequest(
        request_id=b"u" * 16, channel_id=channel.channel_id, epoch=channel.epoch, spec=spec
    )
    await called(ask.stub.UpdateChannel(request, timeout=20), ask)


async def wait_until_it_reports(one: Supernode, text: str) -> None:
    async for _ in attempts():
        pong = await one.stub.Ping(pb.DirectoryServicePingRequest(), timeout=5)
        if text in pong.refused_supernodes.get(one.name, ""):
            assert not pong.ready
            return


async def served_by(one: Supernode) -> None:
    """Check that updates and confirmed reads are served there."""
    async for _ in attempts():
        try:
            await open_channel(one, "cam/later")
        except Unavailable:
            continue
        return


@pytest.mark.parametrize("leads", [True, False])
async def test_two_supernodes_continue_to_serve_if_the_third_has_a_different_state(tmp_path: Path, leads: bool) -> None:
    async with three(tmp_path) as cluster:
        leader = await cluster.leader()
        odd = leader if leads else cluster.others(leader)[0]
        await flip(odd, tmp_path, ask=leader)
        await wait_until_it_reports(odd, "differs from that of most members")
        for other in cluster.others(odd):
            await served_by(other)
            assert (await other.stub.Ping(pb.DirectoryServicePingRequest(), timeout=5)).ready
        with pytest.raises(Unavailable, match="use another one"):
            await open_channel(odd, "cam/refused")
        assert (await cluster.leader()) is not odd
        code, printed = await command("status", "--member", cluster.others(odd)[0].address)
        assert (code, "diverged" in printed) == (0, True), printed
        assert printed.count("diverged") == 1


async def test_two_supernodes_whose_states_differ_are_both_reported_until_a_restart(tmp_path: Path) -> None:
    ports = free_ports(2)
    founder = await prepared("init", "a", ports[0], tmp_path)
    founder.module = MODULE
    founder._arguments += ["--lease-ttl", "60s"]
    running = [founder]
    try:
        await founder.start()
        newcomer = await prepared("join", "b", ports[1], tmp_path, "--member", founder.address)
        running.append(newcomer)
        await newcomer.start()
        await status_has(founder.address, "2 of 2 serve")
        await flip(founder, tmp_path, ask=founder)
        await status_has(founder.address, "is in doubt")
        code, printed = await command("status", "--member", founder.address)
        assert (code, "2 of 2 serve" in printed) == (0, True), printed
        assert "it is unknown which of them is right" in printed
        assert "start this supernode and the leader again" in printed
        await served_by(founder)
        await served_by(newcomer)
        (tmp_path / founder.name / FLIP_FILE).unlink()
        await founder.end(signal.SIGTERM)
        await founder.start()
        async for _ in attempts():
            _, printed = await command("status", "--member", founder.address)
            if "2 of 2 serve" in printed and "doubt" not in printed:
                break
    finally:
        for one in running:
            await one.close()
