"""A cluster that is founded, grows, loses its disk and shrinks, by the commands of the runbook."""

from __future__ import annotations

import json
import os
import re
import signal
from pathlib import Path

from stampede_rt_supernode.replication.storage.known_stores import FILE_NAME
from tests.support.supernode.commands import cluster_id, command, prepared, status_has
from tests.support.supernode.processes import (
    Supernode,
    attempts,
    free_ports,
    open_channel,
    register,
    resolve,
    running_cluster,
)


async def test_a_cluster_is_founded_joined_and_left_and_no_id_is_used_again(tmp_path: Path) -> None:
    ports = free_ports(2)
    founder = await prepared("init", "a", ports[0], tmp_path)
    newcomer = None
    try:
        await founder.start()
        newcomer = await prepared("join", "b", ports[1], tmp_path, "--member", founder.address)
        await newcomer.start()
        await status_has(newcomer.address, "2 of 2 serve")
        code, printed = await command("remove", "a", "--member", newcomer.address)
        assert (code, "the members are b" in printed) == (0, True), printed
        await status_has(newcomer.address, "1 of 1 serve")
        assert await founder.ended() == 1
        code, printed = await command(*founder._arguments)
        assert (code, "cannot be used any more: 'a' was removed" in printed) == (1, True), printed
        await newcomer.end(signal.SIGKILL)
        await newcomer.start()
        await status_has(newcomer.address, "1 of 1 serve")
    finally:
        await founder.close()
        if newcomer is not None:
            await newcomer.close()


async def test_a_cluster_founded_from_a_backup_has_all_acknowledged_commands(
    tmp_path: Path,
) -> None:
    ports, backup = free_ports(2), tmp_path / "backup"
    founder = await prepared("init", "a", ports[0], tmp_path)
    restored = None
    try:
        await founder.start()
        await register(founder, 1)
        opened = await open_channel(founder, "cam/kept")
        former_id = await cluster_id(founder)
        code, printed = await command("snapshot", "--member", founder.address, "--out", str(backup), "-o", "json")
        facts = json.loads(printed)
        assert (code, facts["supernode"], facts["size_bytes"]) == (0, "a", backup.stat().st_size)
        assert backup.stat().st_mode & 0o077 == 0
        code, printed = await command("snapshot", "a", "--member", founder.address)
        # On a slow machine the host's lease may have ended meanwhile, which is one more entry.
        [index] = re.findall(r"^index +(\d+)$", printed, re.MULTILINE)
        assert (code, int(index) >= facts["index"]) == (0, True), printed
        await founder.end(signal.SIGKILL)
        restored = await prepared("init", "r", ports[1], tmp_path, "--restore", str(backup))
        await restored.start()
        assert (await resolve(restored, "cam/kept")).channel.channel_id == opened.channel.channel_id
        # The restored cluster has another id, so that no process takes a returning former member for a part of it.
        async for _ in attempts():
            if await cluster_id(restored) != former_id:
                break
        assert sorted(os.listdir(tmp_path)) == ["a", "backup", "r"]
    finally:
        await founder.close()
        if restored is not None:
            await restored.close()


async def test_the_verb_snapshot_fails_for_a_supernode_that_is_no_member_and_for_an_unwritable_file() -> None:
    address = f"127.0.0.1:{free_ports(1)[0]}"
    one = Supernode("s1", address, ["--id", "s1", "--listen", address])
    try:
        await one.start()
        await status_has(address, "1 of 1 serve")
        code, printed = await command("snapshot", "s9", "--member", address)
        assert (code, printed) == (1, "stampede supernode: no supernode has the id s9; the members are s1\n")
        code, printed = await command("snapshot", "--member", address, "--out", "/nowhere/backup")
        assert (code, "cannot be written: No such file" in printed) == (1, True), printed
    finally:
        await one.close()


async def test_a_folder_in_use_is_not_prepared_again_and_a_lost_disk_is_noticed(tmp_path: Path) -> None:
    [port] = free_ports(1)
    founder = await prepared("init", "a", port, tmp_path)
    second_init = ("init", "--data-dir", str(tmp_path / "a"), "--listen", f"127.0.0.1:{port}")
    code, printed = await command(*second_init)
    assert (code, "belongs to a supernode already" in printed) == (1, True)
    try:
        await founder.start()
    finally:
        await founder.close()
    for file in (tmp_path / "a").glob("replicated_log*"):
        file.unlink()
    code, printed = await command("--listen", f"127.0.0.1:{port}", "--data-dir", str(tmp_path / "a"))
    assert (code, "under a new id" in printed) == (1, True), printed


async def test_a_folder_is_not_started_under_the_id_of_another_supernode(tmp_path: Path) -> None:
    founder = await prepared("init", "a", free_ports(1)[0], tmp_path)
    code, printed = await command(*founder._arguments, "--id", "b")
    assert (code, "is supernode a's, not b's" in printed) == (1, True), printed
    own = Supernode("a", founder.address, [*founder._arguments, "--id", "a"])
    try:
        await own.start()
    finally:
        await founder.close()
        await own.close()


async def test_a_failed_command_prints_its_reason_in_one_line(tmp_path: Path) -> None:
    nobody, folder = f"127.0.0.1:{free_ports(1)[0]}", str(tmp_path / "b")
    join = ("join", "--member", nobody, "--data-dir", folder)
    for words, expected, text in (
        ((*join, "--listen", "127.0.0.1:7590"), 1, f"{nobody} cannot be reached"),
        ((*join, "--listen", "127.0.0.1:7590", "--id", "A b"), 1, "the supernode name 'A b' is not allowed"),
        ((*join, "--listen", "nowhere:0"), 2, "--listen must be HOST:PORT"),
        ((*join, "--listen", "0.0.0.0:7590"), 2, "say with --advertise HOST:PORT where others reach"),
        ((*join, "--listen", "nowhere", "--advertise", "here:1"), 2, "--listen must be HOST:PORT"),
        (("init", "--data-dir", folder, "--listen", "h:1", "--advertise", "here"), 2, "--advertise must be HOST:PORT"),
        (("remove", "a", "--member", nobody), 1, f"{nobody} cannot be reached"),
        (("stauts",), 2, "there is no verb 'stauts'; the verbs are init, join, status, add, remove, snapshot"),
    ):
        code, printed = await command(*words)
        assert (code, text in printed, printed.count("\n")) == (expected, True, 1), printed
    assert os.listdir(tmp_path) == []


async def test_no_member_is_removed_without_a_majority_and_status_names_unreachable_members(
    tmp_path: Path,
) -> None:
    async with running_cluster(tmp_path) as cluster:
        await register(await cluster.leader(), 1)
        one, gone, down = cluster.supernodes
        await gone.end(signal.SIGKILL)
        await down.end(signal.SIGKILL)
        other = Supernode("d", gone.address, ["--id", "d", "--listen", gone.address])
        try:
            await other.start()
            await status_has(one.address, "no leader")
            code, printed = await command("status", "--member", one.address, "-o", "json")
            states = {row["supernode"]: row["state"] for row in json.loads(printed)}
            assert (code, states) == (1, {"s1": "no leader", "s2": "d is there", "s3": "down"})
            code, printed = await command("remove", "s3", "--member", one.address)
            assert (code, "start supernodes until 2 of s1, s2, s3 serve" in printed) == (1, True), printed
            assert "init --restore" in printed
        finally:
            await other.close()


async def test_a_founder_that_lost_its_disk_is_refused_and_acknowledged_commands_are_kept(tmp_path: Path) -> None:
    async with running_cluster(tmp_path) as cluster:
        leader = await cluster.leader()
        wiped, away = cluster.others(leader)
        async for _ in attempts():
            met = [json.loads((tmp_path / one.name / FILE_NAME).read_text()[9:])["known"] for one in cluster.supernodes]
            if all(len(known) == 2 for known in met):
                break
        await away.end(signal.SIGKILL)
        await register(leader, 1)
        opened = await open_channel(leader, "cam/kept")
        for one in (leader, wiped):
            await one.end(signal.SIGKILL)
        for file in (tmp_path / wiped.name).iterdir():
            file.unlink()
        # The two supernodes without the channel are a majority. If the others accepted the wiped one under its old id,
        # a supernode without the channel could lead.
        await away.start()
        await wiped.start()
        # A refusal by one member only delays the join. Refusals by most other members end the process.
        await status_has(away.address, f"{wiped.name} is refused: '{wiped.name}' has come with another store before")
        await leader.start()
        assert await wiped.ended() == 1
        assert (await resolve(leader, "cam/kept")).channel.channel_id == opened.channel.channel_id


async def test_the_error_for_an_empty_folder_names_a_remedy(tmp_path: Path) -> None:
    code, printed = await command("--listen", "127.0.0.1:0", "--data-dir", str(tmp_path / "empty"))
    assert (code, "stampede supernode init" in printed) == (1, True), printed
