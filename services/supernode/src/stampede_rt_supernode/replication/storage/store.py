"""The log's data on stable storage, and the interface of stores."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

from stampede_rt_supernode.replication.log_entries import Entry

# The size of the parts in which a snapshot is written. The log waits a few milliseconds for the disk to write a part.
PIECE_BYTES = 1 << 20


class Promise(NamedTuple):
    """The least that the store of another member must hold: the term `term`, and the committed entries up to `held`.

    The member has reported both after it had written them to its disk. Both only grow. A store of that member with less
    is an older copy.
    """

    term: int
    held: int

    def is_kept_by(self, term: int, last_index: int) -> bool:
        """Whether a store with this term and this last entry holds all promised entries."""
        return term >= self.term and last_index >= self.held


# The way out, at the end of the error texts for a store that is not usable.
REJOIN = "empty the folder and let this member join again under a new id"


class StoreDamaged(RuntimeError):
    """The disk holds other data than was written. The member must rejoin under a new id with an empty folder."""


class StoreRefused(RuntimeError):
    """The folder cannot serve this replica. For example, it has no store, another member's store, or a store in use."""


class SnapshotPiece(NamedTuple):
    """A part of an encoded snapshot. It counts only when the trailer of the snapshot is also on the disk."""

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
        """The snapshot that an encoded `record` makes, with its checksum. Takes a while for a large record."""
        return cls(last_log_index=last_log_index, record=record, sha256=hashlib.sha256(record).digest())

    @property
    def pieces_count(self) -> int:
        """The number of pieces in which the snapshot is written."""
        return -(-len(self.record) // PIECE_BYTES)

    def piece(self, number: int) -> SnapshotPiece:
        """The piece with that number. The first piece has the number 0."""
        return SnapshotPiece(
            self.last_log_index, number, self.record[number * PIECE_BYTES : (number + 1) * PIECE_BYTES]
        )

    def pieces(self) -> Iterator[SnapshotPiece]:
        """All pieces."""
        return map(self.piece, range(self.pieces_count))

    def trailer(self) -> SnapshotTrailer:
        """The change that makes the pieces the present snapshot."""
        return SnapshotTrailer(self.last_log_index, self.pieces_count, self.sha256)


class SnapshotTrailer(NamedTuple):
    """Makes written pieces the present snapshot: the first `pieces_count` pieces of position `last_log_index`.

    `sha256` is the checksum of all these pieces together.
    """

    last_log_index: int
    pieces_count: int
    sha256: bytes


@dataclass(frozen=True, kw_only=True, slots=True)
class StoredState:
    """All data that survives a crash. `entries` is in order and without gaps, and empty in a new store."""

    entries: list[Entry] = field(default_factory=list)
    term: int = 0
    voted_for: str | None = None
    commit_index: int = 1
    snapshot: StoredSnapshot | None = None
    promises: Mapping[str, Promise] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True, slots=True)
class StoreChanges:
    """The changes that one sync makes durable, all or nothing.

    `entries` replace the stored entries at or after `replace_from`; if it is None, all stored entries stay. Then the
    store drops the entries before `first_index`. The last stored entry then has `last_index` and `last_term`. The
    pieces of a snapshot come in earlier commits than its trailer, or in the same one. `promises` are the promises of
    the other members, by id.
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
    trailer: SnapshotTrailer | None = None


class Store(Protocol):
    """Stable storage of one replica. Used from one thread at a time. Every method blocks on the disk."""

    def load(self) -> StoredState:
        """The state of the last commit. Raises StoreDamaged."""

    def commit(self, changes: StoreChanges) -> None:
        """Make the changes durable, all or nothing, before returning."""

    def close(self) -> None:
        """Close the storage."""


class MemoryStore:
    """A store in memory, for development: its data ends with the process."""

    def load(self) -> StoredState:
        """A new, empty state."""
        return StoredState()

    def commit(self, changes: StoreChanges) -> None:
        """Do nothing: the log itself is the only copy."""

    def close(self) -> None:
        """Do nothing: there is nothing to close."""
