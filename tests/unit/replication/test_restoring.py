"""A cluster from what one member of a lost one has kept."""

from __future__ import annotations

from pathlib import Path

import pytest

from stampede_rt_supernode.replication import ReplicationSettings, StoreRefused, open_replicated_log, restore_from
from stampede_rt_supernode.replication.storage import StoreDamaged
from tests.robustness.replication.live_cluster import LiveCluster, LiveMember, dial, running
from tests.robustness.replication.machine import ListMachine


async def test_one_of_three_becomes_a_cluster_of_one_that_holds_everything_it_held(tmp_path: Path) -> None:
    async with LiveCluster(3, tmp_path / "old", snapshot_every=10) as cluster:
        for number in range(25):
            await running(cluster.all[0]).propose(b"%d" % number, timeout=5.0)
        survivor = cluster.all[0]
        await running(survivor).confirm_read(timeout=5.0)
        held = survivor.machine.entries[:]
    failures: list[BaseException] = []
    founder = LiveMember("new", tmp_path / "new", failures.append)
    assert survivor.folder is not None
    restore_from(survivor.folder, tmp_path / "new", founder=founder.member, cluster_id="new cluster")
    settings = ReplicationSettings(
        self_member=founder.member,
        initial_members=[founder.member],
        data_dir=tmp_path / "new",
        cluster_id="new cluster",
        create=False,
    )
    machine = ListMachine()
    log = await open_replicated_log(settings, machine, dial, founder.server, on_fatal=failures.append)
    await founder.server.start()
    await log.propose(b"after", timeout=5.0)
    assert machine.entries[: len(held)] == held
    assert machine.entries[-1][1] == b"after"
    assert [member.member_id for member in log.status().members] == ["new"]
    await log.close()
    await founder.server.stop(None)
    assert failures == []


def test_a_folder_without_a_log_cannot_be_restored(tmp_path: Path) -> None:
    founder = LiveMember.__new__(LiveMember)
    with pytest.raises(StoreRefused, match="holds no replicated log"):
        restore_from(tmp_path, tmp_path / "new", founder=founder, cluster_id="")  # type: ignore[arg-type]


def test_a_damaged_folder_cannot_be_restored(tmp_path: Path) -> None:
    (tmp_path / "replicated_log.sqlite3").write_bytes(b"no database, but long enough to be taken for one" * 100)
    founder = LiveMember.__new__(LiveMember)
    with pytest.raises(StoreDamaged):
        restore_from(tmp_path, tmp_path / "new", founder=founder, cluster_id="")  # type: ignore[arg-type]
