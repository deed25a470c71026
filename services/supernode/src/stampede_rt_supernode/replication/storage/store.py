"""The log's data on stable storage, and the interface of stores."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

from stampede_rt_supernode.replication.log_entries import Entry

# So much of a snapshot is written at once: a few milliseconds on a disk, for whoever waits for the log.
PIECE_BYTES = 1 << 20


class Promise(NamedTuple):
    """The promise of another member: its term, and committed entries up to `held`.

    Both only grow. A store of that member that has less is an older copy of it.
    """

    term: int
    held: int

    def is_kept_by(self, term: int, last_index: int) -> bool:
        """Whether a store with this term and this last entry can be the one that was spoken of."""
        return term >= self.term and last_index >= self.held


REJOIN = "empty the folder and let this member join again under a new id"


class StoreDamaged(RuntimeError):
    """The disk holds something else than was written. The member must rejoin under a new id with an empty folder."""


class StoreRefused(RuntimeError):
    """The folder cannot serve this replica: none there, another member's, or in use."""


class SnapshotPiece(NamedTuple):
    """A part of an encoded snapshot on its way to the disk; it counts once the seal is there, too."""

    last_log_index: int
    number: int
    data: bytes


@dataclass(frozen=True, kw_only=True, slots=True)
class StoredSnapshot:
    """An encoded snapshot, its checksum, and the last position that it covers."""

    last_log_index: int
    record: bytes
    sha256: bytes

    @classmethod
    def of(cls, last_log_index: int, record: bytes) -> StoredSnapshot:
        """With the checksum of the record; takes a while for a large one."""
        return cls(last_log_index=last_log_index, record=record, sha256=hashlib.sha256(record).digest())

    @property
    def pieces_count(self) -> int:
        """How many pieces it is written in."""
        return -(-len(self.record) // PIECE_BYTES)

    def piece(self, number: int) -> SnapshotPiece:
        """One of them, from 0 on."""
        return SnapshotPiece(
            self.last_log_index, number, self.record[number * PIECE_BYTES : (number + 1) * PIECE_BYTES]
        )

    def pieces(self) -> Iterator[SnapshotPiece]:
        """All of them."""
        return map(self.piece, range(self.pieces_count))

    def seal(self) -> SnapshotSeal:
        """The change that makes the pieces the present snapshot."""
        return SnapshotSeal(self.last_log_index, self.pieces_count, self.sha256)


class SnapshotSeal(NamedTuple):
    """Which pieces are the present snapshot: the first so many of that position, with this checksum in all."""

    last_log_index: int
    pieces_count: int
    sha256: bytes


@dataclass(frozen=True, kw_only=True, slots=True)
class StoredState:
    """All that survives a crash. `entries` are without gaps, in order; empty in a new store."""

    entries: list[Entry] = field(default_factory=list)
    term: int = 0
    voted_for: str | None = None
    commit_index: int = 1
    snapshot: StoredSnapshot | None = None
    promises: Mapping[str, Promise] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True, slots=True)
class StoreChanges:
    """The changes that one sync makes durable, all or nothing.

    Entries at or past `replace_from` are replaced by `entries`; then those before `first_index` are dropped. Pieces of
    a snapshot may come with any number of commits before, and at the latest with, the one that has its seal. The log
    then ends with the entry of `last_index` and `last_term`. `promises` are those of the other members, by id.
    """

    replace_from: int | None
    entries: list[Entry]
    first_index: int
    last_index: int
    last_term: int
    term: int
    voted_for: str | None
    commit_index: int
    promises: Mapping[str, Promise] = field(default_factory=dict)
    pieces: list[SnapshotPiece] = field(default_factory=list)
    seal: SnapshotSeal | None = None


class Store(Protocol):
    """Stable storage of one replica. Used from one thread at a time; every method blocks on the disk."""

    def load(self) -> StoredState:
        """The state that was committed last. Raises StoreDamaged."""

    def commit(self, changes: StoreChanges) -> None:
        """Make the changes durable, all or nothing, before returning."""

    def close(self) -> None:
        """Let go of the storage."""


class MemoryStore:
    """For development: forgets everything with the process."""

    def load(self) -> StoredState:
        """A new, empty state."""
        return StoredState()

    def commit(self, changes: StoreChanges) -> None:
        """Nothing to do: the log itself is the only copy."""

    def close(self) -> None:
        """Nothing to let go of."""
