"""The store on disk: one SQLite database for log, term, vote, commit index and snapshot.

SQLite keeps a write-ahead log with `synchronous=FULL`, so a commit is on the disk when it returns. The entries, the
snapshot, and the row of term and vote have checksums. That row also holds the positions of the first and the last
entry, and the number of commits. So `load` finds damage, and no member applies damaged data.

A snapshot is written in pieces, over several commits. The commit that writes its trailer also drops the entries that it
replaces. Until then the former snapshot is complete. After that each commit deletes a few pieces of the former
snapshot. So, after the first trailer, the database always has one complete snapshot, even if the process is killed, and
the log begins with the last two entries of that snapshot.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import sqlite3
import zlib
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from stampede_rt_supernode.replication.log_entries import Entry
from stampede_rt_supernode.replication.storage.known_stores import FILE_NAME as NOTES_NAME
from stampede_rt_supernode.replication.storage.known_stores import force_folder
from stampede_rt_supernode.replication.storage.store import (
    REJOIN,
    Promise,
    SnapshotPiece,
    SnapshotTrailer,
    StoreChanges,
    StoreDamaged,
    StoredSnapshot,
    StoredState,
    StoreRefused,
)
from stampede_rt_supernode.replication.storage.watermark import Watermark

FORMAT_VERSION = 3
# How many pieces of former snapshots one commit deletes.
OLD_PIECES_PER_COMMIT = 2
DATABASE_NAME = "replicated_log.sqlite3"
WATERMARK_NAME = "replicated_log.watermark"

_SCHEMA = """
CREATE TABLE identity (
    id INTEGER PRIMARY KEY CHECK (id = 1), format_version INTEGER NOT NULL,
    cluster_id TEXT NOT NULL, member_id TEXT NOT NULL) STRICT;
CREATE TABLE hard_state (
    id INTEGER PRIMARY KEY CHECK (id = 1), term INTEGER NOT NULL, voted_for TEXT,
    commit_index INTEGER NOT NULL, commits INTEGER NOT NULL, first_index INTEGER NOT NULL,
    last_index INTEGER NOT NULL, last_term INTEGER NOT NULL, promises TEXT NOT NULL, checksum INTEGER NOT NULL) STRICT;
CREATE TABLE entry (
    log_index INTEGER PRIMARY KEY, term INTEGER NOT NULL, command BLOB NOT NULL, checksum INTEGER NOT NULL) STRICT;
CREATE TABLE snapshot (
    id INTEGER PRIMARY KEY CHECK (id = 1), last_log_index INTEGER NOT NULL,
    pieces_count INTEGER NOT NULL, sha256 BLOB NOT NULL) STRICT;
CREATE TABLE snapshot_piece (
    last_log_index INTEGER NOT NULL, number INTEGER NOT NULL, data BLOB NOT NULL,
    PRIMARY KEY (last_log_index, number)) STRICT;
"""

_HARD_STATE = "term, voted_for, commit_index, commits, first_index, last_index, last_term, promises, checksum"
# The errors that SQLite raises, and the errors that a row with a changed bit can cause.
_UNREADABLE = (sqlite3.Error, TypeError, ValueError, AttributeError, OverflowError, RecursionError)


class _HardState(NamedTuple):
    """The row that every commit writes anew: term, vote, and the positions of the first and last entry of the log.

    `commits` is the number of commits so far, this one included. `promises` is JSON.
    """

    term: int
    voted_for: str | None
    commit_index: int
    commits: int
    first_index: int
    last_index: int
    last_term: int
    promises: str

    def checksum(self) -> int:
        """The checksum of the whole row."""
        return zlib.crc32(repr(tuple(self)).encode())


def make_private(path: Path) -> None:
    """Make the database readable only by the user of the process. SQLite gives its journals the same mode."""
    # `touch` opens and closes the file. If SQLite has the file open, that would release SQLite's locks on it.
    if not path.exists():
        path.touch(mode=0o600)
    for file in path.parent.glob(f"{path.name}*"):
        file.chmod(0o600)


def holds_store(data_dir: Path) -> bool:
    """Whether this folder has the database of a replica's log."""
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
    except _UNREADABLE as error:
        raise StoreDamaged(f"{path} is not a sound database ({error})") from error
    if row is None:
        raise StoreDamaged(f"{path} does not name its cluster and member")
    return str(row[0]), str(row[1])


class SqliteStore:
    """One replica's store in `data_dir`. An open store is locked against every other process."""

    def __init__(self, data_dir: Path, *, cluster_id: str, member_id: str, create: bool) -> None:
        """Open or create the store. Blocks. Raises StoreRefused or StoreDamaged, with the way out."""
        self._path = data_dir / DATABASE_NAME
        # The number of commits so far. The file beside the database has it, too (see watermark.py).
        self._commits = 0
        # Whether there may be pieces of earlier snapshots, of this process or of a killed process.
        self._has_old_pieces = True
        existed = holds_store(data_dir)
        if not existed and not create:
            raise StoreRefused(
                f"{data_dir} holds no replicated log: if this member lost its disk, let it join again under a new id "
                "(stampede supernode remove, then join); if it has another folder, name that one"
            )
        data_dir.mkdir(parents=True, exist_ok=True, mode=0o700)
        self._watermark = Watermark(data_dir / WATERMARK_NAME)
        # Whether the store was used before, so that it must not be empty. At the first use the member writes the notes
        # (KnownStores) before it joins the network, and the first commit writes the watermark.
        notes = data_dir / NOTES_NAME
        self._was_used = not create or notes.exists() or self._watermark.read() > 0
        with contextlib.ExitStack() as undo:
            undo.callback(self._watermark.close)
            self._open(cluster_id, member_id, undo)
            undo.pop_all()
        if not existed:
            # The files are on the disk; their names must be, too.
            force_folder(data_dir)
            force_folder(data_dir.parent)

    def _open(self, cluster_id: str, member_id: str, undo: contextlib.ExitStack) -> None:
        try:
            # The log hands the store to its own thread. No other thread uses it after that.
            make_private(self._path)
            self._db = sqlite3.connect(self._path, isolation_level=None, check_same_thread=False, timeout=0.2)
            undo.callback(self._db.close)
            self._db.execute("PRAGMA locking_mode=EXCLUSIVE")
            self._db.execute("PRAGMA journal_mode=WAL")
            self._db.execute("PRAGMA synchronous=FULL")
            self._claim(cluster_id, member_id)
        except sqlite3.OperationalError as error:
            if "locked" in str(error):
                raise StoreRefused(f"{self._path} is in use by another process: stop that one first") from error
            raise StoreDamaged(f"{self._path} cannot be opened ({error}): {REJOIN}") from error
        except _UNREADABLE as error:
            raise StoreDamaged(f"{self._path} is not a sound database ({error}): {REJOIN}") from error

    def _claim(self, cluster_id: str, member_id: str) -> None:
        self._db.execute("BEGIN IMMEDIATE")
        has_schema = self._db.execute("SELECT 1 FROM sqlite_master WHERE name = 'identity'").fetchone()
        if not has_schema:
            if self._was_used:
                raise StoreDamaged(f"{self._path} is empty, but held a log before: {REJOIN}")
            # A crash within the very first transaction leaves a file without a schema. Nothing was acknowledged then.
            for statement in _SCHEMA.split(";")[:-1]:
                self._db.execute(statement)
            self._db.execute("INSERT INTO identity VALUES (1, ?, ?, ?)", (FORMAT_VERSION, cluster_id, member_id))
        self._db.execute("COMMIT")
        row = self._db.execute("SELECT format_version, cluster_id, member_id FROM identity").fetchone()
        if row is None:
            raise StoreDamaged(f"{self._path} does not name its cluster and member: {REJOIN}")
        if row[0] != FORMAT_VERSION:
            raise StoreRefused(
                f"{self._path} has format {row[0]}, and this version reads format {FORMAT_VERSION}: run the version "
                "that wrote it, or, if this version wrote it, the file is damaged; then " + REJOIN
            )
        if row[1:] != (cluster_id, member_id):
            raise StoreRefused(
                f"{self._path} belongs to member {row[2]!r} of cluster {row[1]!r}, not to {member_id!r} of "
                f"{cluster_id!r}: use that member's own folder, or, if this is it, the file is damaged; then {REJOIN}"
            )

    def load(self) -> StoredState:
        """Read and check everything. Blocks. Raises StoreDamaged."""
        try:
            return self._load()
        except _UNREADABLE as error:
            raise StoreDamaged(f"{self._path} cannot be read ({error}): {REJOIN}") from error

    def _load(self) -> StoredState:
        entries = self._load_entries()
        snapshot = self._load_snapshot()
        row = self._db.execute(f"SELECT {_HARD_STATE} FROM hard_state").fetchone()
        if row is None:
            if entries or snapshot or self._was_used:
                raise StoreDamaged(f"{self._path} has lost its term and vote: {REJOIN}")
            return StoredState()
        facts = _HardState(*row[:-1])
        if row[-1] != facts.checksum():
            raise StoreDamaged(f"{self._path}: term and vote fail their checksum: {REJOIN}")
        self._commits = facts.commits
        if self._commits < self._watermark.read():
            raise StoreDamaged(
                f"{self._path} holds {self._commits} commits, but held {self._watermark.read()} before: {REJOIN}"
            )
        if not entries:
            raise StoreDamaged(f"{self._path} has lost its entries: {REJOIN}")
        self._check_shape(entries, snapshot, facts)
        return StoredState(
            entries=entries,
            term=facts.term,
            voted_for=facts.voted_for,
            commit_index=facts.commit_index,
            snapshot=snapshot,
            promises=_read_promises(facts.promises),
        )

    def _check_shape(self, entries: list[Entry], snapshot: StoredSnapshot | None, facts: _HardState) -> None:
        first, last = entries[0].log_index, entries[-1]
        if snapshot is None and first != 1:
            raise StoreDamaged(f"{self._path} starts at entry {first} without a snapshot: {REJOIN}")
        if snapshot is not None and snapshot.last_log_index != first + 1:
            raise StoreDamaged(f"{self._path}: entries are missing between snapshot and log: {REJOIN}")
        if (first, last.log_index, last.term) != (facts.first_index, facts.last_index, facts.last_term):
            raise StoreDamaged(
                f"{self._path} has lost entries: it holds {first} to {last.log_index}, and held {facts.first_index} to "
                f"{facts.last_index}: {REJOIN}"
            )
        if facts.commit_index > last.log_index:
            raise StoreDamaged(f"{self._path} has lost committed entries: {REJOIN}")

    def _load_entries(self) -> list[Entry]:
        entries: list[Entry] = []
        rows = self._db.execute("SELECT log_index, term, command, checksum FROM entry ORDER BY log_index")
        for log_index, term, command, checksum in rows:
            entry = Entry(command, log_index, term)
            if checksum != _entry_checksum(entry):
                raise StoreDamaged(f"{self._path}: entry {log_index} fails its checksum: {REJOIN}")
            if entries and log_index != entries[-1].log_index + 1:
                raise StoreDamaged(f"{self._path}: entries before {log_index} are missing: {REJOIN}")
            if entries and term < entries[-1].term:
                raise StoreDamaged(
                    f"{self._path}: entry {log_index} has a lower term than the previous entry: {REJOIN}"
                )
            entries.append(entry)
        return entries

    def _load_snapshot(self) -> StoredSnapshot | None:
        row = self._db.execute("SELECT last_log_index, pieces_count, sha256 FROM snapshot").fetchone()
        if row is None:
            return None
        trailer = SnapshotTrailer(*row)
        pieces = self._db.execute(
            "SELECT data FROM snapshot_piece WHERE last_log_index = ? AND number < ? ORDER BY number", trailer[:2]
        )
        record = b"".join(data for (data,) in pieces)
        if hashlib.sha256(record).digest() != trailer.sha256:
            raise StoreDamaged(f"{self._path}: the snapshot fails its checksum: {REJOIN}")
        return StoredSnapshot(last_log_index=trailer.last_log_index, record=record, sha256=trailer.sha256)

    def commit(self, changes: StoreChanges) -> None:
        """Perform one transaction, which is on the disk when this call returns.

        Raises sqlite3.Error; then the outcome of the transaction is unknown.
        """
        db = self._db
        db.execute("BEGIN IMMEDIATE")
        if changes.replace_from is not None:
            db.execute("DELETE FROM entry WHERE log_index >= ?", (changes.replace_from,))
            rows = ((entry.log_index, entry.term, entry.command, _entry_checksum(entry)) for entry in changes.entries)
            db.executemany("INSERT INTO entry VALUES (?, ?, ?, ?)", rows)
        db.execute("DELETE FROM entry WHERE log_index < ?", (changes.first_index,))
        facts = _hard_state(changes, self._commits + 1)
        values = ", ".join("?" * (len(facts) + 1))
        db.execute(f"INSERT OR REPLACE INTO hard_state VALUES (1, {values})", (*facts, facts.checksum()))
        self._write_pieces(changes.pieces)
        if changes.trailer is not None:
            self._write_trailer(changes.trailer)
        elif self._has_old_pieces:
            self._drop_old_pieces()
        db.execute("COMMIT")
        self._commits += 1
        self._watermark.note(self._commits)

    def _write_pieces(self, pieces: Iterable[SnapshotPiece]) -> None:
        # A piece that a killed process has left at the same position does not count, and is replaced.
        self._db.executemany("INSERT OR REPLACE INTO snapshot_piece VALUES (?, ?, ?)", pieces)

    def _write_trailer(self, trailer: SnapshotTrailer) -> None:
        self._db.execute("INSERT OR REPLACE INTO snapshot VALUES (1, ?, ?, ?)", trailer)
        self._has_old_pieces = True

    def _drop_old_pieces(self) -> None:
        """Drop a few pieces of earlier snapshots. Snapshot positions only grow, so these pieces are of no use."""
        old = "SELECT rowid FROM snapshot_piece WHERE last_log_index < (SELECT last_log_index FROM snapshot)"
        dropped = self._db.execute(
            f"DELETE FROM snapshot_piece WHERE rowid IN ({old} LIMIT ?)", (OLD_PIECES_PER_COMMIT,)
        ).rowcount
        self._has_old_pieces = dropped == OLD_PIECES_PER_COMMIT

    def close(self) -> None:
        """Close the database and release its lock."""
        self._db.close()
        self._watermark.close()


def _hard_state(changes: StoreChanges, commits: int) -> _HardState:
    return _HardState(
        changes.term,
        changes.voted_for,
        changes.commit_index,
        commits,
        changes.first_index,
        changes.last_index,
        changes.last_term,
        json.dumps(changes.promises),
    )


def _read_promises(text: str) -> dict[str, Promise]:
    return {member_id: Promise(*facts) for member_id, facts in json.loads(text).items()}


def _entry_checksum(entry: Entry) -> int:
    return zlib.crc32(entry.command, zlib.crc32(b"%d/%d" % (entry.log_index, entry.term)))
