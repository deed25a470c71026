"""`stampede host --processes N`: several hosts of one machine under one supervisor."""

from __future__ import annotations

import asyncio
import os
import signal
import sys
from asyncio.subprocess import PIPE, Process
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from tests.support.channel_host.fake_directory import FakeDirectory

SECONDS = 40


pytestmark = pytest.mark.usefixtures("no_settings_of_the_user")


class Hosts:
    """The supervisor, and the lines and process ids that it has printed."""

    def __init__(self, supervisor: Process) -> None:
        self.supervisor = supervisor
        self.pids: dict[int, int] = {}  # by the number of the process: its last process id

    async def ready(self, count: int) -> dict[str, str]:
        """The addresses in the next `count` lines that say ready, by the name of the host."""
        assert self.supervisor.stdout is not None
        found: dict[str, str] = {}
        for _ in range(count):
            line = (await asyncio.wait_for(self.supervisor.stdout.readline(), SECONDS)).decode().split()
            assert line[:2] == ["stampede", "host"], line
            found[line[2]] = line[-1]
        return found

    async def next_line(self, text: str) -> str:
        """The next line on standard error with this text. Notes the process ids on the way."""
        assert self.supervisor.stderr is not None
        async with asyncio.timeout(SECONDS):
            while line := (await self.supervisor.stderr.readline()).decode():
                fields = dict(word.split("=", 1) for word in line.split() if "=" in word)
                if "pid" in fields:
                    self.pids[int(fields["number"])] = int(fields["pid"])
                if text in line:
                    return line
        raise AssertionError(f"the supervisor ended without the line {text!r}")

    async def started(self, count: int) -> None:
        for _ in range(count):
            await self.next_line("started a host process")

    async def ended(self) -> int:
        """The exit status."""
        await asyncio.wait_for(self.supervisor.communicate(), SECONDS)
        assert self.supervisor.returncode is not None
        return self.supervisor.returncode

    async def stopped(self) -> int:
        self.supervisor.send_signal(signal.SIGTERM)
        return await self.ended()


@asynccontextmanager
async def hosts(directory: FakeDirectory, *words: str) -> AsyncIterator[Hosts]:
    own = ["--name", "h", "--frontend", directory.target, "--listen", "localhost:0", *words]
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-m", "stampede_rt_channel_host", *own, stdout=PIPE, stderr=PIPE
    )
    try:
        yield Hosts(process)
    finally:
        if process.returncode is None:
            process.kill()
            await process.communicate()


async def test_the_hosts_keep_their_identities_over_restarts_and_leave_on_sigterm(
    directory: FakeDirectory, tmp_path: Path
) -> None:
    seen: list[dict[str, bytes]] = []
    for _ in range(2):
        async with hosts(directory, "--processes", "2", "--data-dir", str(tmp_path)) as running:
            addresses = await running.ready(2)
            records = [one for one in directory.hosts.values() if one.alive]
            assert {one.name: one.gatekeepers[0].target for one in records} == addresses
            assert set(addresses) == {"h-0", "h-1"}
            assert await running.stopped() == 0
            assert not [one for one in directory.hosts.values() if one.alive]
            seen.append({one.name: one.host_id for one in records})
    assert seen[0] == seen[1]


async def test_a_killed_process_is_started_again_and_a_frozen_process_does_not_prevent_the_stop(
    directory: FakeDirectory, tmp_path: Path
) -> None:
    async with hosts(directory, "--processes", "2", "--data-dir", str(tmp_path)) as running:
        await running.started(2)
        await running.ready(2)
        before = {one.name: one for one in directory.hosts.values()}
        os.kill(running.pids[1], signal.SIGKILL)
        line = await running.next_line("a host process has ended; it is started again after a pause")
        assert "number=1" in line
        assert "exit_status=-9" in line
        assert set(await running.ready(1)) == {"h-1"}
        after = {one.name: one for one in directory.hosts.values()}
        assert after["h-1"].host_id == before["h-1"].host_id
        assert after["h-1"].boot_incarnation != before["h-1"].boot_incarnation
        assert after["h-0"] == before["h-0"]
        os.kill(running.pids[0], signal.SIGSTOP)
        assert await running.stopped() == 0
        assert not [one for one in directory.hosts.values() if one.alive]


async def test_no_host_process_outlives_a_supervisor_that_was_killed(directory: FakeDirectory) -> None:
    async with hosts(directory, "--processes", "2") as running:
        await running.started(2)
        await running.ready(2)
        handles = [os.pidfd_open(pid) for pid in running.pids.values()]
        running.supervisor.kill()
        await running.supervisor.wait()
        loop = asyncio.get_running_loop()
        for handle in handles:  # a pidfd is readable when its process has ended
            ended = asyncio.Event()
            loop.add_reader(handle, ended.set)
            await asyncio.wait_for(ended.wait(), SECONDS)
            loop.remove_reader(handle)
            os.close(handle)
        assert not [one for one in directory.hosts.values() if one.alive], "each host has left the directory"


async def test_a_process_that_cannot_start_ends_all_processes_with_its_own_exit_status(
    directory: FakeDirectory, tmp_path: Path
) -> None:
    (tmp_path / "process-1").mkdir()
    (tmp_path / "process-1" / "host-id").write_text("no id")
    async with hosts(directory, "--processes", "2", "--data-dir", str(tmp_path)) as running:
        assert await running.ended() == 1
        assert not [one for one in directory.hosts.values() if one.alive]
