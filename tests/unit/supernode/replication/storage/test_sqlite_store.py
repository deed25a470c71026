"""A supernode distinguishes its own data folder from another member's folder, an empty one and a damaged one."""

from __future__ import annotations

import os
import random
import re
import shutil
import sqlite3
from pathlib import Path

import pytest

from stampede_rt_supernode.replication.configuration import Configuration
from stampede_rt_supernode.replication.log_entries import Entry
from stampede_rt_supernode.replication.storage import store as storage
from stampede_rt_supernode.replication.storage.known_stores import KnownStores
from stampede_rt_supernode.replication.storage.raft_log import RaftLog
from stampede_rt_supernode.replication.storage.sqlite_store import (
    DATABASE_NAME,
    WATERMARK_NAME,
    SqliteStore,
    _entry_checksum,
    holds_store,
)
from stampede_rt_supernode.replication.storage.store import (
    Promise,
    StoreDamaged,
    StoredSnapshot,
    StoredState,
    StoreRefused,
)


def open_store(folder: Path, *, member_id: str = "m", cluster_id: str = "c", create: bool = True) -> SqliteStore:
    return SqliteStore(folder, cluster_id=cluster_id, member_id=member_id, create=create)


def fill(folder: Path) -> None:
    log = RaftLog(open_store(folder))
    for index in range(1, 6):
        log.append(b"\x00command %d" % index, index, 1)
    log.set_term(1, "m")
    log.close()


def edit(folder: Path, statement: str) -> None:
    with sqlite3.connect(folder / DATABASE_NAME) as db:
        db.execute(statement)
    db.close()


def damage_found(folder: Path) -> str:
    store = open_store(folder)
    try:
        with pytest.raises(StoreDamaged, match="join again under a new id") as caught:
            store.load()
    finally:
        store.close()
    return str(caught.value)


def test_an_empty_folder_is_refused_if_a_store_must_exist(tmp_path: Path) -> None:
    assert not holds_store(tmp_path)
    with pytest.raises(StoreRefused, match="holds no replicated log"):
        open_store(tmp_path, create=False)
    assert not holds_store(tmp_path)


def test_an_existing_store_opens_without_permission_to_create_one(tmp_path: Path) -> None:
    fill(tmp_path)
    assert holds_store(tmp_path)
    store = open_store(tmp_path, create=False)
    assert len(store.load().entries) == 5
    store.close()


@pytest.mark.parametrize("other", [{"member_id": "n"}, {"cluster_id": "d"}])
def test_another_members_folder_is_refused(tmp_path: Path, other: dict[str, str]) -> None:
    fill(tmp_path)
    with pytest.raises(StoreRefused, match="use that member's own folder"):
        open_store(tmp_path, **other)


@pytest.mark.parametrize("mode", [0o755, 0o700])
def test_only_the_user_of_the_supernode_can_read_a_store(tmp_path: Path, mode: int) -> None:
    tmp_path.chmod(mode)
    before = os.umask(0o022)
    try:
        fill(tmp_path)
        (tmp_path / DATABASE_NAME).chmod(0o644)  # as an earlier release left it
        store = open_store(tmp_path)
        modes = {file.name: file.stat().st_mode & 0o777 for file in tmp_path.iterdir()}
        store.close()
    finally:
        os.umask(before)
    assert len(modes) > 1
    assert set(modes.values()) == {0o600}


def test_a_folder_in_use_is_refused(tmp_path: Path) -> None:
    store = open_store(tmp_path)
    with pytest.raises(StoreRefused, match="in use by another process"):
        open_store(tmp_path)
    store.close()


def test_a_changed_entry_is_found_and_not_applied(tmp_path: Path) -> None:
    fill(tmp_path)
    edit(tmp_path, "UPDATE entry SET command = x'00ff' WHERE log_index = 3")
    assert "entry 3 fails its checksum" in damage_found(tmp_path)


def test_a_missing_entry_is_found(tmp_path: Path) -> None:
    fill(tmp_path)
    edit(tmp_path, "DELETE FROM entry WHERE log_index = 3")
    assert "entries before 4 are missing" in damage_found(tmp_path)


def test_a_changed_term_or_vote_is_found(tmp_path: Path) -> None:
    fill(tmp_path)
    edit(tmp_path, "UPDATE hard_state SET voted_for = 'x'")
    assert "term and vote fail their checksum" in damage_found(tmp_path)


def test_a_forgotten_vote_is_found(tmp_path: Path) -> None:
    fill(tmp_path)
    edit(tmp_path, "DELETE FROM hard_state")
    assert "lost its term and vote" in damage_found(tmp_path)


def test_a_log_that_begins_late_without_a_snapshot_is_found(tmp_path: Path) -> None:
    fill(tmp_path)
    edit(tmp_path, "DELETE FROM entry WHERE log_index < 3")
    assert "without a snapshot" in damage_found(tmp_path)


def test_a_file_that_is_no_database_is_found(tmp_path: Path) -> None:
    (tmp_path / DATABASE_NAME).write_bytes(b"not a database at all" * 100)
    with pytest.raises(StoreDamaged, match="join again under a new id"):
        open_store(tmp_path)


def copy_as_after_a_crash(folder: Path, to: Path) -> Path:
    """The store as a kill would leave it during use: the write-ahead log is still there."""
    log = RaftLog(open_store(folder))
    for index in range(1, 61):
        log.append(b"\x00command %d" % index, index, 1)
        log.sync()
    shutil.copytree(folder, to)
    log.close()
    return to / f"{DATABASE_NAME}-wal"


def flip_a_bit_in_the_middle(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)


def test_a_store_opens_with_all_committed_entries_after_a_crash(tmp_path: Path) -> None:
    copy_as_after_a_crash(tmp_path / "a", tmp_path / "b")
    store = open_store(tmp_path / "b")
    assert len(store.load().entries) == 60
    store.close()


def test_a_flipped_bit_in_the_write_ahead_log_is_found(tmp_path: Path) -> None:
    flip_a_bit_in_the_middle(copy_as_after_a_crash(tmp_path / "a", tmp_path / "b"))
    assert re.search(r"holds \d+ commits, but held 60 before", damage_found(tmp_path / "b"))


def test_without_the_watermark_a_flipped_bit_would_silently_lose_entries(tmp_path: Path) -> None:
    flip_a_bit_in_the_middle(copy_as_after_a_crash(tmp_path / "a", tmp_path / "b"))
    (tmp_path / "b" / WATERMARK_NAME).unlink()
    store = open_store(tmp_path / "b")
    assert 0 < len(store.load().entries) < 60
    store.close()


def test_a_commit_fails_on_a_full_disk(tmp_path: Path) -> None:
    store = open_store(tmp_path)
    log = RaftLog(store)
    store._db.execute("PRAGMA max_page_count = 10")
    log.append(b"\x00" * 60_000, 1, 1)
    with pytest.raises(sqlite3.OperationalError, match="full"):
        log.sync()
    store.close()


def adopt(log: RaftLog, index: int, record: bytes) -> None:
    snapshot = StoredSnapshot.of(index, record)
    for piece in snapshot.pieces():
        log.write_piece(piece)
    previous, last = log.entry_at(index - 1), log.entry_at(index)
    assert previous
    assert last
    log.adopt_snapshot(snapshot, previous, last, Configuration(()))


def test_a_changed_piece_of_the_snapshot_is_found(tmp_path: Path) -> None:
    fill(tmp_path)
    log = RaftLog(open_store(tmp_path))
    adopt(log, 3, b"state")
    log.close()
    edit(tmp_path, "UPDATE snapshot_piece SET data = x'00'")
    assert "snapshot fails its checksum" in damage_found(tmp_path)


def test_a_missing_piece_of_the_snapshot_is_found(tmp_path: Path) -> None:
    fill(tmp_path)
    log = RaftLog(open_store(tmp_path))
    adopt(log, 3, b"state")
    log.close()
    edit(tmp_path, "DELETE FROM snapshot_piece")
    assert "snapshot fails its checksum" in damage_found(tmp_path)


def test_the_pieces_of_older_snapshots_are_deleted_a_few_at_a_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(storage, "PIECE_BYTES", 1)
    store = open_store(tmp_path)
    log = RaftLog(store)
    for index in range(1, 6):
        log.append(b"\x00", index, 1)
    adopt(log, 3, b"older")
    log.sync()
    adopt(log, 4, b"newer")
    held = []
    for term in range(1, 6):
        log.set_term(term, "m")
        log.sync()
        held.append(store._db.execute("SELECT COUNT(*) FROM snapshot_piece").fetchone()[0])
    assert held == [10, 8, 6, 5, 5]
    log.close()
    assert open_and_close(tmp_path).snapshot == StoredSnapshot.of(4, b"newer")


def test_a_store_of_another_format_is_not_changed_and_the_error_gives_advice(tmp_path: Path) -> None:
    fill(tmp_path)
    edit(tmp_path, "UPDATE identity SET format_version = 2")
    with pytest.raises(StoreRefused, match="run the version that wrote it"):
        open_store(tmp_path)


def test_missing_last_entries_are_noticed_before_any_new_commit(tmp_path: Path) -> None:
    fill(tmp_path)
    edit(tmp_path, "DELETE FROM entry WHERE log_index > 3")
    assert "holds 1 to 3, and held 1 to 5" in damage_found(tmp_path)


def test_an_entry_of_an_earlier_term_between_later_ones_is_found(tmp_path: Path) -> None:
    fill(tmp_path)
    earlier = Entry(b"\x00command 3", 3, 0)
    edit(tmp_path, f"UPDATE entry SET term = 0, checksum = {_entry_checksum(earlier)} WHERE log_index = 3")
    assert "entry 3 has a lower term than the previous entry" in damage_found(tmp_path)


@pytest.mark.parametrize(
    "statement",
    [
        "UPDATE entry SET checksum = x'00' WHERE log_index = 2",
        "UPDATE entry SET command = NULL WHERE log_index = 2",
        "UPDATE entry SET term = 'one' WHERE log_index = 2",
        "UPDATE hard_state SET commits = NULL",
        "UPDATE hard_state SET promises = 7",
    ],
)
def test_a_value_of_another_type_is_reported_as_damage_and_not_as_a_defect(tmp_path: Path, statement: str) -> None:
    fill(tmp_path)
    schema = (
        "UPDATE sqlite_master SET sql = replace(replace(replace(sql, 'INTEGER NOT NULL', 'ANY'), 'BLOB NOT NULL', "
        "'ANY'), 'TEXT NOT NULL', 'ANY') WHERE name IN ('entry', 'hard_state')"
    )
    with sqlite3.connect(tmp_path / DATABASE_NAME) as db:
        db.execute("PRAGMA writable_schema = 1")
        db.execute(schema)
    db.close()
    edit(tmp_path, statement)
    assert damage_found(tmp_path)


def test_an_emptied_database_is_not_mistaken_for_a_new_one(tmp_path: Path) -> None:
    fill(tmp_path)
    for file in tmp_path.iterdir():
        file.unlink() if file.name == WATERMARK_NAME else file.write_bytes(b"")
    with pytest.raises(StoreDamaged, match="is empty, but held a log before"):
        open_store(tmp_path, create=False)
    KnownStores.open(tmp_path, had_store=True)  # as a member leaves it if no other member knows of its first start
    with pytest.raises(StoreDamaged, match="is empty, but held a log before"):
        open_store(tmp_path, create=True)


def test_a_database_without_term_and_entries_is_not_mistaken_for_a_new_one(tmp_path: Path) -> None:
    fill(tmp_path)
    edit(tmp_path, "DELETE FROM hard_state")
    edit(tmp_path, "DELETE FROM entry")
    (tmp_path / WATERMARK_NAME).unlink()
    store = open_store(tmp_path, create=False)
    with pytest.raises(StoreDamaged, match="lost its term and vote"):
        store.load()
    store.close()


def test_a_store_keeps_the_promises_of_other_members_over_a_restart(tmp_path: Path) -> None:
    fill(tmp_path)
    log = RaftLog(open_store(tmp_path))
    log.note_promise("b", 3, 0)
    log.note_promise("b", 1, 7)
    log.close()
    assert open_and_close(tmp_path).promises == {"b": Promise(3, 7)}


def test_a_flipped_bit_is_always_reported_as_damage(tmp_path: Path) -> None:
    copy_as_after_a_crash(tmp_path / "a", tmp_path / "crashed")
    fill(tmp_path / "closed")
    random_source = random.Random(5)
    for original in (tmp_path / "crashed", tmp_path / "closed"):
        names = sorted(file.name for file in original.iterdir() if "shm" not in file.name)
        whole = read_copy(original, tmp_path / "copy")
        for _ in range(300):
            data = bytearray((original / (name := random_source.choice(names))).read_bytes())
            place = random_source.randrange(len(data))
            data[place] ^= 1 << random_source.randrange(8)
            found = read_copy(original, tmp_path / "copy", name, bytes(data))
            assert found in (None, whole), (original, name, place)


def test_every_commit_is_synced(tmp_path: Path) -> None:
    store = open_store(tmp_path)
    assert store._db.execute("PRAGMA synchronous").fetchone() == (2,)  # FULL: a commit has reached the disk
    store.close()


def read_copy(original: Path, copy: Path, name: str = "", data: bytes = b"") -> StoredState | None:
    """The contents of a copy in which one file has changed; None if it is refused with a reason."""
    shutil.rmtree(copy, ignore_errors=True)
    shutil.copytree(original, copy)
    if name:
        (copy / name).write_bytes(data)
    try:
        return open_and_close(copy)
    except (StoreDamaged, StoreRefused):
        return None


def open_and_close(folder: Path) -> StoredState:
    store = open_store(folder)
    try:
        return store.load()
    finally:
        store.close()
