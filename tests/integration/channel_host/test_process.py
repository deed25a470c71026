"""`stampede host` as a process: its ready line, its end, and its errors when it cannot start."""

from __future__ import annotations

import asyncio
import signal
import sys
from asyncio.subprocess import PIPE, Process
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import grpc
import pytest

from stampede_rt.errors import PermissionDenied
from stampede_rt.v1 import gatekeeper_service_pb2 as gate_pb
from stampede_rt.v1.gatekeeper_service_pb2_grpc import GatekeeperServiceStub
from stampede_rt_runtime.auth import make_secret_file
from stampede_rt_runtime.dial import dial
from tests.support.channel_host.fake_directory import FakeDirectory

pytestmark = pytest.mark.usefixtures("no_settings_of_the_user")


@asynccontextmanager
async def host(*arguments: str) -> AsyncIterator[Process]:
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-m", "stampede_rt_channel_host", *arguments, stdout=PIPE, stderr=PIPE
    )
    try:
        yield process
    finally:
        if process.returncode is None:
            process.kill()
        await process.communicate()


async def ready(process: Process) -> str:
    """The address in the ready line."""
    assert process.stdout is not None
    line = (await asyncio.wait_for(process.stdout.readline(), 20)).decode()
    assert line.startswith("stampede host h1 ready on localhost:"), line
    return line.split()[-1]


async def stopped(process: Process) -> int:
    process.send_signal(signal.SIGTERM)
    return await asyncio.wait_for(process.wait(), 45)


async def test_a_host_prints_that_it_is_ready_and_leaves_on_sigterm(directory: FakeDirectory) -> None:
    async with host("--name", "h1", "--frontend", directory.target) as process:
        address = await ready(process)
        (record,) = directory.hosts.values()
        assert [(record.name, record.alive)] == [("h1", True)]
        assert [one.target for one in record.gatekeepers] == [address]
        async with grpc.aio.insecure_channel(address) as channel:
            answer = await GatekeeperServiceStub(channel).Ping(gate_pb.GatekeeperServicePingRequest())
        assert answer.lease_held
        assert await stopped(process) == 0
        assert not directory.hosts[record.host_id].alive


async def test_a_host_refuses_a_caller_without_the_secret(directory: FakeDirectory, tmp_path: Path) -> None:
    secret = make_secret_file(tmp_path / "secret")
    async with host("--name", "h1", "--frontend", directory.target, "--secret-file", str(secret.path)) as process:
        address = await ready(process)
        request = gate_pb.GatekeeperServicePingRequest()
        async with grpc.aio.insecure_channel(address) as channel:
            with pytest.raises(grpc.aio.AioRpcError, match="the call brought no secret"):
                await GatekeeperServiceStub(channel).Ping(request)
        async with dial(address, secret=secret) as channel:
            assert (await GatekeeperServiceStub(channel).Ping(request)).name == "h1"


async def test_a_host_with_its_old_folder_keeps_its_id_and_has_a_new_boot_id(
    directory: FakeDirectory, tmp_path: Path
) -> None:
    boots = []
    for _ in range(2):
        async with host("--name", "h1", "--frontend", directory.target, "--data-dir", str(tmp_path)) as process:
            await ready(process)
            (record,) = directory.hosts.values()
            boots.append(record.boot_incarnation)
            assert await stopped(process) == 0
    assert boots[0] != boots[1]


async def test_a_host_registers_the_address_that_it_advertises(directory: FakeDirectory) -> None:
    arguments = ("--name", "h1", "--frontend", directory.target, "--advertise", "rig:4711", "--zone", "lab")
    async with host(*arguments) as process:
        await ready(process)
        (record,) = directory.hosts.values()
        assert [(one.target, one.zone) for one in record.gatekeepers] == [("rig:4711", "lab")]


async def test_a_host_that_is_refused_exits_with_one_line_that_has_the_reason(directory: FakeDirectory) -> None:
    directory.refuse["RegisterHost"] = PermissionDenied("this host may not enter")
    async with host("--name", "h1", "--frontend", directory.target, "--log-level", "error") as process:
        out, err = await asyncio.wait_for(process.communicate(), 20)
        assert (process.returncode, out, err.decode()) == (1, b"", "stampede host: this host may not enter\n")


async def test_a_host_without_a_directory_stops_on_a_signal() -> None:
    async with host("--name", "h1", "--frontend", "localhost:1") as process:
        assert process.stderr is not None
        first = await asyncio.wait_for(process.stderr.readline(), 20)
        assert b"cannot register yet" in first
        assert await stopped(process) == 0


@pytest.mark.parametrize("arguments", [("--name", "No Name"), ("--frontend", ""), ("--memory-bytes-max", "1KiB")])
async def test_a_host_exits_immediately_if_its_settings_are_wrong(arguments: tuple[str, str]) -> None:
    async with host(*arguments) as process:
        out, err = await asyncio.wait_for(process.communicate(), 20)
        assert (process.returncode, out) == (2, b"")
        assert arguments[0].encode() in err
