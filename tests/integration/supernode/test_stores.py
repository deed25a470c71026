"""Supernodes whose folders are lost, left out or put back from an old copy, and members that come back after others."""

from __future__ import annotations

import asyncio
import json
import shutil
import signal
import sys
from pathlib import Path

from stampede_rt_supernode.replication.storage.known_stores import FILE_NAME
from stampede_rt_supernode.replication.storage.sqlite_store import DATABASE_NAME, WATERMARK_NAME
from tests.support.command_line.documented_fields import require_fields
from tests.support.supernode.commands import command, prepared, status_has
from tests.support.supernode.processes import (
    Cluster,
    Supernode,
    attempts,
    clean_environment,
    free_ports,
    open_channel,
    register,
    resolve,
    running_cluster,
)

WRITES = 20


async def have_met(cluster: Cluster, folder: Path) -> None:
    """Wait until each member has noted the stores of both others."""
    async for _ in attempts():
        notes = [folder / one.name / FILE_NAME for one in cluster.supernodes]
        if all(len(json.loads(note.read_text()[9:])["known"]) == 2 for note in notes):
            return


async def write(supernode: Supernode) -> list[str]:
    """Open channels, and return their names."""
    names = [f"cam/{number}" for number in range(WRITES)]
    for name in names:
        await open_channel(supernode, name)
    return names


async def loses_nothing(supernode: Supernode, names: list[str]) -> None:
    for name in names:
        assert (await resolve(supernode, name)).channel.name == name


async def test_a_member_that_is_started_without_its_folder_is_refused_and_no_command_is_lost(tmp_path: Path) -> None:
    async with running_cluster(tmp_path, "--lease-ttl", "1h") as cluster:
        leader = await cluster.leader()
        forgetful, away = cluster.others(leader)
        await have_met(cluster, tmp_path)
        await away.end(signal.SIGKILL)
        await register(leader, 1)
        names = await write(leader)
        for one in (leader, forgetful):
            await one.end(signal.SIGKILL)
        place = forgetful._arguments.index("--data-dir")
        words = forgetful._arguments[:place] + forgetful._arguments[place + 2 :]
        without = Supernode(forgetful.name, forgetful.address, words)
        try:
            await away.start()
            await without.start()
            await status_has(away.address, f"{forgetful.name} is refused")
            await leader.start()
            assert await without.ended() == 1
        finally:
            await without.close()
        code, printed = await command(*words)
        assert (code, "start it with --data-dir" in printed) == (1, True), printed
        await loses_nothing(leader, names)


async def test_a_member_with_an_older_copy_of_its_folder_is_refused_for_good_and_status_and_doctor_say_so(
    tmp_path: Path,
) -> None:
    async with running_cluster(tmp_path, "--lease-ttl", "1h") as cluster:
        leader = await cluster.leader()
        restored, _ = cluster.others(leader)
        await register(leader, 1)
        await restored.end(signal.SIGKILL)
        folder, copy = tmp_path / restored.name, tmp_path / "copy"
        shutil.copytree(folder, copy)
        await restored.start()
        names = await write(leader)
        await resolve(restored, names[-1])
        await restored.end(signal.SIGTERM)
        shutil.rmtree(folder)
        shutil.copytree(copy, folder)
        code, printed = await command(*restored._arguments)
        assert (code, "The folder is older" in printed, "join under a new id" in printed) == (1, True, True), printed
        code, printed = await command(*restored._arguments)
        assert (code, "cannot be used any more" in printed) == (1, True), printed
        await status_has(leader.address, f"{restored.name} is refused: '{restored.name}' comes with an older copy")
        code, printed = await doctor(leader.address)
        assert (code, "store refused" in printed, "let it join under a new id" in printed) == (1, True, True), printed
        await loses_nothing(leader, names)


async def doctor(address: str) -> tuple[int, str]:
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "stampede_rt.cli", "doctor", "--member", address),
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.STDOUT,
        env=clean_environment(),
    )
    printed, _ = await process.communicate()
    return process.returncode or 0, printed.decode()


async def test_an_older_copy_is_refused_also_by_a_leader_that_was_restarted_meanwhile(tmp_path: Path) -> None:
    async with running_cluster(tmp_path, "--lease-ttl", "1h") as cluster:
        leader = await cluster.leader()
        restored, away = cluster.others(leader)
        await register(leader, 1)
        await restored.end(signal.SIGKILL)
        folder, copy = tmp_path / restored.name, tmp_path / "copy"
        shutil.copytree(folder, copy)
        await restored.start()
        await away.end(signal.SIGKILL)
        names = await write(leader)
        for one in (restored, leader):
            await one.end(signal.SIGKILL)
        shutil.rmtree(folder)
        shutil.copytree(copy, folder)
        await leader.start()
        await restored.start()
        # The report of one member marks no folder. Yet the copy does not vote for the member that lacks the writes.
        await status_has(leader.address, f"{restored.name} is refused: '{restored.name}' comes with an older copy")
        assert not json.loads((folder / FILE_NAME).read_text()[9:])["refused"]
        await away.start()
        assert await restored.ended() == 1
        code, printed = await command(*restored._arguments)
        assert (code, "cannot be used any more" in printed, f"says {leader.name}" in printed) == (1, True, True), (
            printed
        )
        await loses_nothing(leader, names)


async def test_a_store_that_was_emptied_with_its_watermark_is_not_a_new_one(tmp_path: Path) -> None:
    [port] = free_ports(1)
    founder = await prepared("init", "a", port, tmp_path)
    try:
        await founder.start()
        await register(founder, 1)
        await founder.end(signal.SIGKILL)
    finally:
        await founder.close()
    folder = tmp_path / "a"
    for name in (DATABASE_NAME, f"{DATABASE_NAME}-wal"):
        (folder / name).write_bytes(b"")
    (folder / WATERMARK_NAME).unlink()
    code, printed = await command(*founder._arguments)
    assert (code, "under a new id" in printed) == (1, True), printed


async def test_others_join_a_cluster_that_was_restored(tmp_path: Path) -> None:
    ports, backup = free_ports(3), tmp_path / "backup"
    former = await prepared("init", "a", ports[0], tmp_path)
    running = [former]
    try:
        await former.start()
        await register(former, 1)
        names = await write(former)
        code, printed = await command("snapshot", "--member", former.address, "--out", str(backup))
        assert code == 0, printed
        await former.end(signal.SIGKILL)
        restored = await prepared("init", "r", ports[1], tmp_path, "--restore", str(backup))
        running.append(restored)
        await restored.start()
        newcomer = await prepared("join", "b", ports[2], tmp_path, "--member", restored.address)
        running.append(newcomer)
        await newcomer.start()
        await status_has(newcomer.address, "2 of 2 serve")
        await newcomer.end(signal.SIGKILL)
        await newcomer.start()
        await loses_nothing(newcomer, names)
    finally:
        for one in running:
            await one.close()


async def test_a_member_that_was_down_while_the_others_were_replaced_comes_back(tmp_path: Path) -> None:
    ports = free_ports(5)
    everybody = {"a": await prepared("init", "a", ports[0], tmp_path)}
    try:
        await everybody["a"].start()
        for name, port in zip("bc", ports[1:], strict=False):
            await enter(everybody, name, port, tmp_path, through="a")
        await register(everybody["a"], 1)
        names = await write(everybody["a"])
        await everybody["c"].end(signal.SIGKILL)
        await enter(everybody, "d", ports[3], tmp_path, through="a")
        await leave(everybody, "a", through="d")
        await enter(everybody, "e", ports[4], tmp_path, through="d")
        await leave(everybody, "b", through="d")
        await everybody["c"].start()
        await status_has(everybody["d"].address, "3 of 3 serve")
        # The two that remain are a majority of c, d and e, so that c counts.
        await everybody["d"].end(signal.SIGKILL)
        await loses_nothing(everybody["c"], names)
    finally:
        for one in everybody.values():
            await one.close()


async def enter(everybody: dict[str, Supernode], name: str, port: int, folder: Path, *, through: str) -> None:
    everybody[name] = await prepared("join", name, port, folder, "--member", everybody[through].address)
    await everybody[name].start()
    async for _ in attempts():
        _, printed = await command("status", "--member", everybody[name].address, "-o", "json")
        states = {row["supernode"]: row["state"] for row in json.loads(printed)} if printed.startswith("[") else {}
        if states.get(name) in ("leader", "follower"):
            return


async def leave(everybody: dict[str, Supernode], name: str, *, through: str) -> None:
    code, printed = await command("remove", name, "--member", everybody[through].address, "-o", "json")
    assert code == 0, printed
    require_fields("supernode remove", printed)
    await everybody[name].ended()
