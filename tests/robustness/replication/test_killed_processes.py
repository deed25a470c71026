"""Members as processes, killed without warning."""

from __future__ import annotations

import asyncio
import signal
import sys
import tempfile
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from tests.robustness.replication.member_process import REFUSED, UNKNOWN_OUTCOME

IDS = ["m0", "m1", "m2"]


class MemberProcess:
    """One member: its folder stays, and its process is started and killed."""

    def __init__(self, member_id: str, folder: Path) -> None:
        self._arguments = ["-m", "tests.robustness.replication.member_process", member_id, str(folder), *IDS]
        self._socket = folder / f"{member_id}.sock"
        self._process: asyncio.subprocess.Process | None = None

    async def start(self) -> None:
        self._socket.unlink(missing_ok=True)
        pipe = asyncio.subprocess.PIPE
        self._process = await asyncio.create_subprocess_exec(sys.executable, *self._arguments, stdin=pipe, stdout=pipe)

    async def ask(self, line: str) -> str:
        assert self._process is not None
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(line.encode() + b"\n")
        return (await self._process.stdout.readline()).decode().strip()

    def send_signal(self, number: int) -> None:
        assert self._process is not None
        self._process.send_signal(number)

    async def ended(self) -> int:
        """Wait until the process has ended by itself. Returns its exit code."""
        assert self._process is not None
        await self._process.communicate()
        assert self._process.returncode is not None
        return self._process.returncode

    async def kill(self) -> None:
        """Kill the process with SIGKILL: it flushes nothing, and sends no last message."""
        if self._process is not None and self._process.returncode is None:
            self._process.kill()
            await self._process.communicate()


@pytest.fixture
async def cluster() -> AsyncIterator[list[MemberProcess]]:
    # Socket paths have a short limit, and pytest's own folders are long.
    with tempfile.TemporaryDirectory(prefix="srt-") as folder:
        members = [MemberProcess(member_id, Path(folder)) for member_id in IDS]
        for member in members:
            await member.start()
        yield members
        for member in members:
            await member.kill()


async def write(member: MemberProcess, names: list[str]) -> None:
    for name in names:
        assert (await member.ask(f"propose {name}")).isdigit()


async def write_at_last(member: MemberProcess, name: str) -> None:
    """Repeat the write until it is acknowledged. test_simulated_cluster.py checks the time, in simulated time."""
    while not (answer := await member.ask(f"propose {name}")).isdigit():
        assert answer in (UNKNOWN_OUTCOME, REFUSED)


async def test_acknowledged_commands_survive_the_killing_of_every_member(cluster: list[MemberProcess]) -> None:
    first, second, third = cluster
    await write(first, [f"a{n}" for n in range(40)])
    await write(second, [f"b{n}" for n in range(40)])
    for member in cluster:
        await member.kill()
    for member in cluster:
        await member.start()
    held = (await third.ask("entries")).split()
    assert held == [f"a{n}" for n in range(40)] + [f"b{n}" for n in range(40)]


async def test_the_other_members_serve_again_after_one_is_killed(cluster: list[MemberProcess]) -> None:
    await write(cluster[0], ["before"])
    for victim in range(3):
        survivor = cluster[(victim + 1) % 3]
        await cluster[victim].kill()
        await write_at_last(survivor, f"after{victim}")
        await cluster[victim].start()
        assert (await cluster[victim].ask("entries")).split()[0] == "before"


async def test_a_frozen_leader_is_replaced_and_gives_no_outdated_answer(cluster: list[MemberProcess]) -> None:
    await write(cluster[0], ["before"])
    leader = cluster[IDS.index(await cluster[0].ask("leader"))]
    survivor = next(member for member in cluster if member is not leader)
    leader.send_signal(signal.SIGSTOP)
    await write_at_last(survivor, "meanwhile")
    leader.send_signal(signal.SIGCONT)
    assert "meanwhile" in (await leader.ask("entries")).split()
