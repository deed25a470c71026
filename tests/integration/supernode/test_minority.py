"""An operator can still save the data of a cluster that has lost its majority."""

from __future__ import annotations

import asyncio
import json
import signal
from pathlib import Path

from tests.support.supernode.commands import command
from tests.support.supernode.processes import Supernode, free_ports, open_channel, register, resolve, running_cluster


async def test_a_supernode_without_a_majority_gives_a_stale_backup_that_founds_a_new_cluster(
    tmp_path: Path,
) -> None:
    async with running_cluster(tmp_path, "--lease-ttl", "1h") as cluster:
        last, *others = cluster.supernodes
        await register(last, 1)
        opened = await open_channel(last, "cam/kept")
        await asyncio.gather(*(one.end(signal.SIGKILL) for one in others))
        refused = await command("snapshot", last.name, "--member", last.address)
        assert refused[0] == 1
        assert "no majority confirmed the read" in refused[1]
        assert "stale_ok (--stale-ok) returns the state that this supernode holds" in refused[1]
        backup = str(tmp_path / "backup")
        words = ("snapshot", last.name, "--stale-ok", "--member", last.address, "--out", backup, "-o", "json")
        code, printed = await command(*words)
        assert (code, json.loads(printed)["supernode"]) == (0, last.name), printed
    address = f"127.0.0.1:{free_ports(1)[0]}"
    words = ("--data-dir", str(tmp_path / "new"), "--listen", address, "--id", "new")
    code, printed = await command("init", "--restore", backup, *words)
    assert code == 0, printed
    founder = Supernode("new", address, ["--listen", address, "--data-dir", str(tmp_path / "new")])
    try:
        await founder.start()
        assert (await resolve(founder, "cam/kept")).channel.channel_id == opened.channel.channel_id
    finally:
        await founder.close()
