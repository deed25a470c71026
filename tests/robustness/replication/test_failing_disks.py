"""Members as processes, each on its own file system, which loses its power, fails, or hangs."""

from __future__ import annotations

import asyncio
import contextlib
import os
import shutil
import signal
import subprocess
import tempfile
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from stampede_rt_supernode.replication.threads.tick_thread import EXIT_DISK
from tests.robustness.replication.ext4 import Ext4
from tests.robustness.replication.member_process import REFUSED, UNKNOWN_OUTCOME
from tests.robustness.replication.test_killed_processes import IDS, MemberProcess, write
from tests.support.supernode.processes import attempts

pytestmark = pytest.mark.skipif(
    os.geteuid() != 0 or not all(map(shutil.which, ("mkfs.ext4", "fsfreeze", "losetup"))), reason="needs root and ext4"
)


class Machine(MemberProcess):
    """A process, and the disk of its folder."""

    def __init__(self, member_id: str, folder: Path) -> None:
        super().__init__(member_id, folder)
        self.disk = Ext4(folder / f"{member_id}.image", folder / member_id)

    def lose_power(self) -> None:
        self.disk.lose_power()
        self.send_signal(signal.SIGKILL)

    async def come_back(self) -> None:
        await self.kill()
        self.disk.unmount()
        self.disk.mount()
        await self.start()


@contextlib.asynccontextmanager
async def mounted_machines() -> AsyncIterator[list[Machine]]:
    """Yield three machines, not started. Removes all their mounts and devices afterwards, even after a failure."""
    # Socket paths have a short limit, and pytest's own folders are long.
    async with contextlib.AsyncExitStack() as undo:
        folder = Path(undo.enter_context(tempfile.TemporaryDirectory(prefix="srt-")))
        made: list[Machine] = []
        for member_id in IDS:
            machine = Machine(member_id, folder)
            undo.callback(machine.disk.close)
            # A process that waits for its disk ends only when the disk goes on.
            undo.push_async_callback(machine.kill)
            undo.callback(machine.disk.thaw)
            made.append(machine)
        yield made


@pytest.fixture
async def machines() -> AsyncIterator[list[Machine]]:
    async with contextlib.AsyncExitStack() as undo:
        try:
            made = await undo.enter_async_context(mounted_machines())
        except (subprocess.CalledProcessError, OSError) as error:
            pytest.skip(f"no loop device can be mounted here: {error}")
        for machine in made:
            await machine.start()
        yield made


def left_over(folder: Path) -> list[str]:
    """The mounts below a folder, and the loop devices of files in it."""
    devices = subprocess.run(["losetup", "--list", "--noheadings", "--output", "BACK-FILE"], capture_output=True)
    lines = [*Path("/proc/mounts").read_text().splitlines(), *devices.stdout.decode().splitlines()]
    return [line for line in lines if str(folder) in line]


async def test_disks_leave_nothing_behind_when_a_test_fails_and_two_runs_do_not_disturb_each_other() -> None:
    folders = []
    with contextlib.suppress(KeyError):
        async with mounted_machines() as first, mounted_machines() as second:
            folders = [machines[0].disk.path.parent for machines in (first, second)]
            assert all(len(left_over(folder)) == 2 * len(IDS) for folder in folders)
            for machine in (*first, *second):
                await machine.start()
            first[0].disk.freeze()
            first[1].disk.lose_power()
            await write(second[0], ["undisturbed"])
            raise KeyError("a test fails, with a disk that hangs and one without power")
    assert len(folders) == 2
    for folder in folders:
        assert not folder.exists()
        async for _ in attempts():  # the kernel frees a loop device a moment later
            if not left_over(folder):
                break


async def test_acknowledged_commands_survive_a_loss_of_power_everywhere(machines: list[Machine]) -> None:
    names = [f"a{n}" for n in range(40)]
    await write(machines[0], names)
    under_way = asyncio.create_task(machines[1].ask("propose under-way"))
    for machine in machines:
        machine.lose_power()
    await under_way
    for machine in machines:
        await machine.come_back()
    held = (await machines[2].ask("entries")).split()
    assert [name for name in held if name != "under-way"] == names


async def test_a_member_whose_disk_fails_ends_with_the_exit_code_for_it_and_the_others_go_on(
    machines: list[Machine],
) -> None:
    await write(machines[0], ["before"])
    leader = machines[IDS.index(await machines[0].ask("leader"))]
    leader.disk.lose_power()  # without a restart: every write gives EIO from now on
    survivor = next(machine for machine in machines if machine is not leader)
    while not (await survivor.ask("propose after")).isdigit():
        pass
    assert await leader.ended() == EXIT_DISK
    assert "after" in (await survivor.ask("entries")).split()
    await leader.come_back()
    assert (await leader.ask("entries")).split()[0] == "before"


async def test_a_leader_whose_disk_hangs_is_replaced_and_follows_when_the_disk_goes_on(
    machines: list[Machine],
) -> None:
    await write(machines[0], ["before"])
    leader = machines[IDS.index(await machines[0].ask("leader"))]
    survivor = next(machine for machine in machines if machine is not leader)
    leader.disk.freeze()
    stuck = asyncio.create_task(leader.ask("propose stuck"))
    while not (await survivor.ask("propose meanwhile")).isdigit():
        pass
    assert await stuck in (UNKNOWN_OUTCOME, REFUSED)
    # The member must not go on to call itself the leader.
    assert await leader.ask("leader") == "None"
    assert await leader.ask("disk") == "silent"
    leader.disk.thaw()
    assert "meanwhile" in (await leader.ask("entries")).split()
    assert await leader.ask("disk") == "answers"
