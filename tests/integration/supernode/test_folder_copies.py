"""A copy of a supernode's data folder is started before the supernode, or while the supernode runs."""

from __future__ import annotations

import shutil
import signal
from pathlib import Path

from tests.support.supernode.commands import command, prepared
from tests.support.supernode.processes import Supernode, free_ports, register


def copied(original: Supernode, folder: Path, port: int) -> Supernode:
    """Copy the folder as it is now, and return a process at another port that uses the copy."""
    shutil.copytree(folder / original.name, folder / "copy")
    address = f"127.0.0.1:{port}"
    return Supernode(original.name, address, ["--listen", address, "--data-dir", str(folder / "copy")])


async def test_a_copy_of_a_running_supernode_exits_with_the_reason(tmp_path: Path) -> None:
    ports = free_ports(2)
    original = await prepared("init", "a", ports[0], tmp_path)
    running = [original]
    try:
        await original.start()
        running.append(copied(original, tmp_path, ports[1]))
        code, output = await running[1].refused()
        assert (code, f"supernode a runs at {original.address} already" in output) == (1, True), output
        await register(original, 1)
    finally:
        for one in running:
            await one.close()


async def test_a_copy_that_was_started_first_exits_when_the_supernode_starts(tmp_path: Path) -> None:
    ports = free_ports(2)
    original = await prepared("init", "a", ports[0], tmp_path)
    running = [original]
    try:
        await original.start()
        await original.end(signal.SIGTERM)
        copy = copied(original, tmp_path, ports[1])
        running.append(copy)
        await copy.start()
        await original.start()
        assert await copy.ended() == 1
        await register(original, 1)
    finally:
        for one in running:
            await one.close()


async def test_status_says_that_a_supernode_without_its_folder_is_a_cluster_of_its_own() -> None:
    (port,) = free_ports(1)
    address = f"127.0.0.1:{port}"
    alone = Supernode("supernode-1", address, ["--listen", address])
    try:
        await alone.start()
        await register(alone, 1)
        code, printed = await command("status", "--member", address)
        assert (code, "1 of 1 serve" in printed) == (0, True), printed
        assert "Cluster memory-" in printed
        assert "should be of another cluster, start supernode-1 again with --data-dir" in printed
    finally:
        await alone.close()


async def test_addresses_of_two_clusters_in_one_list_are_refused_and_both_are_named(tmp_path: Path) -> None:
    ports = free_ports(2)
    pair = [await prepared("init", name, port, tmp_path) for name, port in zip("ab", ports, strict=True)]
    try:
        for one in pair:
            await one.start()
        code, printed = await command("status", "--member", f"{pair[0].address},{pair[1].address}")
        assert (code, f"{pair[0].address} and {pair[1].address} are of different clusters" in printed) == (1, True)
    finally:
        for one in pair:
            await one.close()


async def test_a_founder_that_is_started_without_its_list_names_the_missing_flag(tmp_path: Path) -> None:
    (port,) = free_ports(1)
    address, data_dir = f"127.0.0.1:{port}", str(tmp_path / "a")
    place = ["--listen", address, "--data-dir", data_dir]
    founder = Supernode("a", address, [*place, "--id", "a", "--members", f"a={address}"])
    try:
        await founder.start()
        await register(founder, 1)
        await founder.end(signal.SIGTERM)
        code, printed = await command(*place)
        assert (code, "start it with --id a and the same --members" in printed) == (1, True), printed
        await founder.start()
    finally:
        await founder.close()
