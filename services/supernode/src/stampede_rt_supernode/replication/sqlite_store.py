"""The store on disk: one SQLite database for log, term, vote, commit index and snapshot.

Write-ahead log with `synchronous=FULL`: a commit is on the disk when it returns. Every row carries a checksum, and
every commit is counted, so that damage is found when the store is opened, and never applied.
"""

from __future__ import annotations

import hashlib
import os
import sqlite3
import zlib
from pathlib import Path

from stampede_rt_supernode.replication.storage import (
    Entry,
    StoreChanges,
    StoreDamaged,
    StoredSnapshot,
    StoredState,
    StoreRefused,
)
from stampede_rt_supernode.replication.watermark import Watermark

FORMAT_VERSION = 1
DATABASE_NAME = "replicated_log.sqlite3"
WATERMARK_NAME = "replicated_log.watermark"

_SCHEMA = """
CREATE TABLE identity (
    id INTEGER PRIMARY KEY CHECK (id = 1), format_version INTEGER NOT NULL,
    cluster_id TEXT NOT NULL, member_id TEXT NOT NULL) STRICT;
CREATE TABLE hard_state (
    id INTEGER PRIMARY KEY CHECK (id = 1), term INTEGER NOT NULL, voted_for TEXT,
    commit_index INTEGER NOT NULL, commits INTEGER NOT NULL, checksum INTEGER NOT NULL) STRICT;
CREATE TABLE entry (
    log_index INTEGER PRIMARY KEY, term INTEGER NOT NULL, command BLOB NOT NULL, checksum INTEGER NOT NULL) STRICT;
CREATE TABLE snapshot (
    id INTEGER PRIMARY KEY CHECK (id = 1), last_log_index INTEGER NOT NULL,
    record BLOB NOT NULL, sha256 BLOB NOT NULL) STRICT;
"""


def holds_store(data_dir: Path) -> bool:
    """Whether a replica has ever kept its log in this folder."""
    return (data_dir / DATABASE_NAME).exists()


def read_identity(data_dir: Path) -> tuple[str, str]:
    """(cluster id, member id) of the store in a folder that no process uses. Raises StoreDamaged or StoreRefused."""
    path = data_dir / DATABASE_NAME
    try:
        db = sqlite3.connect(path, timeout=0.2)
        try:
            row = db.execute("SELECT cluster_id, member_id FROM identity").fetchone()
        finally:
            db.close()
    except sqlite3.OperationalError as error:
        if "locked" in str(error):
            raise StoreRefused(f"{path} is in use by another process: stop that one first") from error
        raise StoreDamaged(f"{path} cannot be opened ({error})") from error
    except sqlite3.DatabaseError as error:
        raise StoreDamaged(f"{path} is not a sound database ({error})") from error
    if row is None:
        raise StoreDamaged(f"{path} does not say whose it is")
    return str(row[0]), str(row[1])


class SqliteStore:
    """One replica's store in `data_dir`. Opening locks it against every other process."""

    def __init__(self, data_dir: Path, *, cluster_id: str, member_id: str, create: bool) -> None:
        """Open or create; blocks. Raises StoreRefused or StoreDamaged with the way out."""
        self._path = data_dir / DATABASE_NAME
        # How many transactions the store has seen; also beside the database, see watermark.py.
        self._commits = 0
        existed = holds_store(data_dir)
        if not existed and not create:
            raise StoreRefused(
                f"{data_dir} holds no replicated log: initialise a new cluster there, or, if this member lost its "
                "disk, let it join again under a new id"
            )
        data_dir.mkdir(parents=True, exist_ok=True, mode=0o700)
        try:
            self._db = self._connect()
            self._claim(cluster_id, member_id)
        except sqlite3.OperationalError as error:
            if "locked" in str(error):
                raise StoreRefused(f"{self._path} is in use by another process: stop that one first") from error
            raise StoreDamaged(f"{self._path} cannot be opened ({error}): {_REJOIN}") from error
        except sqlite3.DatabaseError as error:
            raise StoreDamaged(f"{self._path} is not a sound database ({error}): {_REJOIN}") from error
        self._watermark = Watermark(data_dir / WATERMARK_NAME)
        if not existed:
            # The files are on the disk; their names must be too.
            _force_folder(data_dir)
            _force_folder(data_dir.parent)

    def _connect(self) -> sqlite3.Connection:
        # The log hands the store to its own thread, and nobody else uses it then.
        db = sqlite3.connect(self._path, isolation_level=None, check_same_thread=False, timeout=0.2)
        db.execute("PRAGMA locking_mode=EXCLUSIVE")
        db.execute("PRAGMA journal_mode=WAL")
        db.execute("PRAGMA synchronous=FULL")
        return db

    def _claim(self, cluster_id: str, member_id: str) -> None:
        self._db.execute("BEGIN IMMEDIATE")
        has_schema = self._db.execute("SELECT 1 FROM sqlite_master WHERE name = 'identity'").fetchone()
        if not has_schema:
            # A file without a schema was left by a crash within the very first transaction: nothing was promised.
            for statement in _SCHEMA.split(";")[:-1]:
                self._db.execute(statement)
            self._db.execute("INSERT INTO identity VALUES (1, ?, ?, ?)", (FORMAT_VERSION, cluster_id, member_id))
        self._db.execute("COMMIT")
        row = self._db.execute("SELECT format_version, cluster_id, member_id FROM identity").fetchone()
        if row is None:
            raise StoreDamaged(f"{self._path} does not say whose it is: {_REJOIN}")
        if row != (FORMAT_VERSION, cluster_id, member_id):
            self._db.close()
            raise StoreRefused(
                f"{self._path} has format {row[0]} and belongs to member {row[2]!r} of cluster {row[1]!r}, not to "
                f"{member_id!r} of {cluster_id!r} (format {FORMAT_VERSION}): use that member's own folder"
            )

    def load(self) -> StoredState:
        """Read everything and check it; blocks. Raises StoreDamaged."""
        try:
            return self._load()
        except sqlite3.DatabaseError as error:
            raise StoreDamaged(f"{self._path} cannot be read ({error}): {_REJOIN}") from error

    def _load(self) -> StoredState:
        entries = self._load_entries()
        snapshot = self._load_snapshot()
        row = self._db.execute("SELECT term, voted_for, commit_index, commits, checksum FROM hard_state").fetchone()
        if row is None:
            if entries or snapshot or self._watermark.read():
                raise StoreDamaged(f"{self._path} has lost its term and vote: {_REJOIN}")
            return StoredState()
        term, voted_for, commit_index, self._commits, checksum = row
        if checksum != _hard_state_checksum(*row[:-1]):
            raise StoreDamaged(f"{self._path}: term and vote fail their checksum: {_REJOIN}")
        if self._commits < self._watermark.read():
            raise StoreDamaged(
                f"{self._path} holds {self._commits} commits and has held {self._watermark.read()}: {_REJOIN}"
            )
        if not entries:
            raise StoreDamaged(f"{self._path} has lost its entries: {_REJOIN}")
        self._check_shape(entries, snapshot, commit_index)
        return StoredState(
            entries=entries, term=term, voted_for=voted_for, commit_index=commit_index, snapshot=snapshot
        )

    def _check_shape(self, entries: list[Entry], snapshot: StoredSnapshot | None, commit_index: int) -> None:
        first = entries[0].log_index
        if snapshot is None and first != 1:
            raise StoreDamaged(f"{self._path} starts at entry {first} without a snapshot: {_REJOIN}")
        if snapshot is not None and snapshot.last_log_index != first + 1:
            raise StoreDamaged(f"{self._path}: snapshot and log do not meet: {_REJOIN}")
        if commit_index > entries[-1].log_index:
            raise StoreDamaged(f"{self._path} has lost committed entries: {_REJOIN}")

    def _load_entries(self) -> list[Entry]:
        entries: list[Entry] = []
        rows = self._db.execute("SELECT log_index, term, command, checksum FROM entry ORDER BY log_index")
        for log_index, term, command, checksum in rows:
            entry = Entry(command, log_index, term)
            if checksum != _entry_checksum(entry):
                raise StoreDamaged(f"{self._path}: entry {log_index} fails its checksum: {_REJOIN}")
            if entries and log_index != entries[-1].log_index + 1:
                raise StoreDamaged(f"{self._path}: entries before {log_index} are missing: {_REJOIN}")
            entries.append(entry)
        return entries

    def _load_snapshot(self) -> StoredSnapshot | None:
        row = self._db.execute("SELECT last_log_index, record, sha256 FROM snapshot").fetchone()
        if row is None:
            return None
        if hashlib.sha256(row[1]).digest() != row[2]:
            raise StoreDamaged(f"{self._path}: the snapshot fails its checksum: {_REJOIN}")
        return StoredSnapshot(last_log_index=row[0], record=row[1])

    def commit(self, changes: StoreChanges) -> None:
        """One transaction, on the disk when this returns. Raises sqlite3.Error, after which nothing is certain."""
        db = self._db
        db.execute("BEGIN IMMEDIATE")
        if changes.replace_from is not None:
            db.execute("DELETE FROM entry WHERE log_index >= ?", (changes.replace_from,))
            rows = ((entry.log_index, entry.term, entry.command, _entry_checksum(entry)) for entry in changes.entries)
            db.executemany("INSERT INTO entry VALUES (?, ?, ?, ?)", rows)
        db.execute("DELETE FROM entry WHERE log_index < ?", (changes.first_index,))
        hard_state = (changes.term, changes.voted_for, changes.commit_index, self._commits + 1)
        row = (*hard_state, _hard_state_checksum(*hard_state))
        db.execute("INSERT OR REPLACE INTO hard_state VALUES (1, ?, ?, ?, ?, ?)", row)
        if changes.snapshot is not None:
            record = changes.snapshot.record
            sealed = (changes.snapshot.last_log_index, record, hashlib.sha256(record).digest())
            db.execute("INSERT OR REPLACE INTO snapshot VALUES (1, ?, ?, ?)", sealed)
        db.execute("COMMIT")
        self._commits += 1
        self._watermark.note(self._commits)

    def close(self) -> None:
        """Let go of the database and its lock."""
        self._db.close()
        self._watermark.close()


_REJOIN = "empty the folder and let this member join again under a new id"


def _force_folder(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _hard_state_checksum(term: int, voted_for: str | None, commit_index: int, commits: int) -> int:
    return zlib.crc32(repr((term, voted_for, commit_index, commits)).encode())


def _entry_checksum(entry: Entry) -> int:
    return zlib.crc32(entry.command, zlib.crc32(b"%d/%d" % (entry.log_index, entry.term)))
