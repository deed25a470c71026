"""A cluster made from the data of one member of a lost cluster."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from contextlib import suppress
from functools import partial
from pathlib import Path

import pytest

from stampede_rt_supernode.replication import ReplicationSettings, StoreRefused, open_replicated_log, restore_from
from stampede_rt_supernode.replication.configuration import Configuration
from stampede_rt_supernode.replication.interface import LogUnavailable, Member, OutcomeUnknown
from stampede_rt_supernode.replication.log_entries import Entry
from stampede_rt_supernode.replication.storage.backups import BackupHeader, make_backup
from stampede_rt_supernode.replication.storage.sqlite_store import SqliteStore
from stampede_rt_supernode.replication.storage.store import StoreChanges, StoreDamaged, StoredSnapshot
from stampede_rt_supernode.replication.wire.records import decode_configuration, encode_snapshot
from tests.support.supernode.list_machine import ListMachine
from tests.support.supernode.live_cluster import QUICK, LiveCluster, LiveMember, dial, running


async def perform(call: Callable[[], Awaitable[object]]) -> None:
    """Repeat `call` until the log performs it. The leader may change at any time."""
    while True:
        with suppress(OutcomeUnknown, LogUnavailable):
            await call()
            return


async def test_one_supernode_of_three_becomes_a_cluster_of_one_that_holds_its_whole_state(tmp_path: Path) -> None:
    async with LiveCluster(3, tmp_path / "old", snapshot_every=10) as cluster:
        survivor = cluster.all[0]
        for number in range(25):
            await perform(partial(running(survivor).propose, b"%d" % number, timeout=5.0))
        await perform(partial(running(survivor).confirm_read, timeout=5.0))
        held = survivor.machine.entries[:]
    failures: list[BaseException] = []
    founder = LiveMember("new", tmp_path / "new", failures.append)
    assert survivor.folder is not None
    restore_from(survivor.folder, tmp_path / "new", ListMachine(), founder=founder.member, cluster_id="new cluster")
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


def snapshot_of(texts: list[bytes]) -> bytes:
    machine = ListMachine()
    for index, text in enumerate(texts, start=3):
        machine.apply(index, text)
    end = len(texts) + 2
    previous, last = Entry(b"\x00p", end - 1, 7), Entry(b"\x00l", end, 7)
    configuration = Configuration.of([Member(member_id=name, address=f"{name}:1") for name in "ab"])
    return encode_snapshot(previous=previous, last=last, configuration=configuration, state=machine.snapshot())


HEADER = BackupHeader(member_id="a", cluster_id="c", log_index=4, time_unix_nano=1)
FOUNDER = Member(member_id="new", address="new:1")


def test_after_a_restore_all_former_member_ids_are_retired(tmp_path: Path) -> None:
    record = snapshot_of([b"one", b"two"])
    backup = make_backup(HEADER, record)
    (tmp_path / "backup").write_bytes(b"".join(backup.parts()))
    assert (tmp_path / "backup").stat().st_size == backup.size_bytes
    assert restore_from(tmp_path / "backup", tmp_path / "new", ListMachine(), founder=FOUNDER, cluster_id="n") == 4
    store = SqliteStore(tmp_path / "new", cluster_id="n", member_id="new", create=False)
    state = store.load()
    store.close()
    assert state.snapshot == StoredSnapshot.of(4, record)
    configuration = decode_configuration(state.entries[-1].command)
    assert (configuration.members, configuration.retired) == ((FOUNDER,), ("a", "b"))


@pytest.mark.parametrize("at", [10, 60, -40, -1])
def test_a_backup_with_a_changed_bit_anywhere_is_refused(tmp_path: Path, at: int) -> None:
    data = bytearray(b"".join(make_backup(HEADER, snapshot_of([b"one", b"two"])).parts()))
    data[at] ^= 1
    (tmp_path / "backup").write_bytes(data)
    with pytest.raises(StoreDamaged, match=r"is not a backup|fails its checksum"):
        restore_from(tmp_path / "backup", tmp_path / "new", ListMachine(), founder=FOUNDER, cluster_id="n")
    assert not (tmp_path / "new").exists()


def test_a_backup_that_was_cut_off_is_refused(tmp_path: Path) -> None:
    data = b"".join(make_backup(HEADER, snapshot_of([b"one", b"two"])).parts())
    for size in (0, 31, 40, 100, len(data) - 1):
        (tmp_path / "backup").write_bytes(data[:size])
        with pytest.raises(StoreDamaged):
            restore_from(tmp_path / "backup", tmp_path / "new", ListMachine(), founder=FOUNDER, cluster_id="n")


def test_a_folder_without_a_log_cannot_be_restored(tmp_path: Path) -> None:
    founder = LiveMember.__new__(LiveMember)
    with pytest.raises(StoreRefused, match="has ever run"):
        restore_from(tmp_path, tmp_path / "new", ListMachine(), founder=founder, cluster_id="")  # type: ignore[arg-type]


def test_a_damaged_folder_cannot_be_restored(tmp_path: Path) -> None:
    (tmp_path / "replicated_log.sqlite3").write_bytes(b"no database, but long enough to be taken for one" * 100)
    founder = LiveMember.__new__(LiveMember)
    with pytest.raises(StoreDamaged):
        restore_from(tmp_path, tmp_path / "new", ListMachine(), founder=founder, cluster_id="")  # type: ignore[arg-type]


async def test_a_term_that_a_hostile_member_has_raised_is_reported_and_not_restored(
    tmp_path: Path,
) -> None:
    async with LiveCluster(1, tmp_path / "old") as cluster:
        await running(cluster.all[0]).propose(b"kept", timeout=5.0)
        [member] = cluster.all
        await member.stop()
        assert member.folder is not None
        raise_term(member, 2**63 - 1)
        with pytest.raises(StoreDamaged, match=r"no elections explain that.*init --restore"):
            await cluster.start(member)
    founder = LiveMember("new", tmp_path / "new", cluster.failures.append)
    restore_from(member.folder, tmp_path / "new", ListMachine(), founder=founder.member, cluster_id="")
    await founder.start([founder.member], QUICK, snapshot_every=5000)
    await running(founder).propose(b"after", timeout=5.0)
    assert [command for _, command in founder.machine.entries] == [b"kept", b"after"]
    await founder.stop()
    assert cluster.failures == []


def raise_term(member: LiveMember, term: int) -> None:
    """Store a very high term at the member, as earlier releases did when any caller named one."""
    assert member.folder is not None
    store = SqliteStore(member.folder, cluster_id="", member_id=member.member.member_id, create=False)
    state = store.load()
    last = state.entries[-1]
    changes = StoreChanges(
        replace_from=None,
        entries=[],
        first_index=state.entries[0].log_index,
        last_index=last.log_index,
        last_term=last.term,
        term=term,
        voted_for=None,
        commit_index=state.commit_index,
    )
    store.commit(changes)
    store.close()
