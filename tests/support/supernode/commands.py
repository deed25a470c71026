"""The commands of an operator: `stampede supernode ...` as processes."""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path

from stampede_rt.v1 import directory_service_pb2 as pb
from tests.support.supernode.processes import PATIENCE_SECONDS, Supernode, attempts, clean_environment


async def command(*words: str) -> tuple[int, str]:
    """Run `stampede supernode ...` to its end. Returns the exit status and the output."""
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "stampede_rt.cli", "supernode", *words),
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.STDOUT,
        env=clean_environment(),
    )
    try:
        async with asyncio.timeout(PATIENCE_SECONDS):
            printed, _ = await process.communicate()
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()
    return process.returncode or 0, printed.decode()


async def prepared(verb: str, name: str, port: int, folder: Path, *words: str) -> Supernode:
    address, data_dir = f"127.0.0.1:{port}", str(folder / name)
    code, printed = await command(verb, "--data-dir", data_dir, "--listen", address, "--id", name, *words)
    assert code == 0, printed
    return Supernode(name, address, ["--listen", address, "--data-dir", data_dir])


async def status_has(address: str, text: str) -> None:
    """Wait until the output of `status` has `text`."""
    async for _ in attempts():
        _, printed = await command("status", "--member", address)
        if text in printed:
            return


async def cluster_id(one: Supernode) -> str:
    return str((await one.stub.Ping(pb.DirectoryServicePingRequest(), timeout=5)).cluster_id)
