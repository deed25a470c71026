"""What the log keeps on stable storage, and the interface of what keeps it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple, Protocol


class Entry(NamedTuple):
    """One position of the log. The order of the fields is the library's: it indexes entries by number."""

    command: bytes
    log_index: int
    term: int


class StoreDamaged(RuntimeError):
    """What is on disk is not what was written. The member must rejoin under a new id with an empty folder."""


class StoreRefused(RuntimeError):
    """The folder cannot serve this replica: none there, another member's, or in use."""


@dataclass(frozen=True, kw_only=True, slots=True)
class StoredSnapshot:
    """An encoded snapshot, and the last position that it covers."""

    last_log_index: int
    record: bytes


@dataclass(frozen=True, kw_only=True, slots=True)
class StoredState:
    """All that survives a crash. `entries` are without gaps, in order; empty in a new store."""

    entries: list[Entry] = field(default_factory=list)
    term: int = 0
    voted_for: str | None = None
    commit_index: int = 1
    snapshot: StoredSnapshot | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class StoreChanges:
    """What one sync makes durable, all or nothing.

    Entries at or past `replace_from` are replaced by `entries`; then those before `first_index` are dropped.
    """

    replace_from: int | None
    entries: list[Entry]
    first_index: int
    term: int
    voted_for: str | None
    commit_index: int
    snapshot: StoredSnapshot | None


class Store(Protocol):
    """Stable storage of one replica. Used from one thread at a time; every method blocks on the disk."""

    def load(self) -> StoredState:
        """What was committed last. Raises StoreDamaged."""

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
        """Nothing to do: the journal itself is the only copy."""

    def close(self) -> None:
        """Nothing to let go of."""
