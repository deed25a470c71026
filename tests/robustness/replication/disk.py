"""A disk that keeps what was committed and nothing else, and may fail in the middle of a commit."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

from stampede_rt_supernode.replication.storage import (
    Entry,
    SnapshotSeal,
    StoreChanges,
    StoredSnapshot,
    StoredState,
)


class Crash(BaseException):
    """The process was killed while it waited for its disk."""


@dataclass
class Disk:
    """Outlives its replica. `crash_at_commit` says for each commit: None, "before" or "after"."""

    crash_at_commit: Callable[[], str | None] = lambda: None
    # A planted fault: commits are acknowledged but kept only from the next but `forgets`-th on.
    forgets: int = 0
    states: list[StoredState] = field(default_factory=lambda: [StoredState()])
    # Of all snapshots, by last log index and number: without a seal they count for nothing.
    pieces: dict[tuple[int, int], bytes] = field(default_factory=dict)

    def survive(self) -> StoredState:
        """What is still there after a crash, as a copy."""
        kept = max(0, len(self.states) - 1 - self.forgets)
        self.states = [self.states[kept]]
        state = self.states[-1]
        return replace(state, entries=list(state.entries))


class DiskStore:
    """A Store over a Disk, with the meaning of SqliteStore."""

    def __init__(self, disk: Disk) -> None:
        self._disk = disk

    def load(self) -> StoredState:
        return self._disk.survive()

    def commit(self, changes: StoreChanges) -> None:
        crash = self._disk.crash_at_commit()
        if crash == "before":
            raise Crash
        for piece in changes.pieces:
            self._disk.pieces[piece.last_log_index, piece.number] = piece.data
        self._disk.states.append(_applied(self._disk.states[-1], changes, self._disk.pieces))
        del self._disk.states[: -1 - self._disk.forgets]
        if crash == "after":
            raise Crash

    def close(self) -> None:
        pass


def _applied(state: StoredState, changes: StoreChanges, pieces: Mapping[tuple[int, int], bytes]) -> StoredState:
    entries: list[Entry] = state.entries
    if changes.replace_from is not None:
        entries = [entry for entry in entries if entry.log_index < changes.replace_from] + changes.entries
    return StoredState(
        entries=[entry for entry in entries if entry.log_index >= changes.first_index],
        term=changes.term,
        voted_for=changes.voted_for,
        commit_index=changes.commit_index,
        snapshot=_sealed(changes.seal, pieces) if changes.seal else state.snapshot,
        promises=changes.promises,
    )


def _sealed(seal: SnapshotSeal, pieces: Mapping[tuple[int, int], bytes]) -> StoredSnapshot:
    record = b"".join(pieces[seal.last_log_index, number] for number in range(seal.pieces_count))
    sealed = StoredSnapshot.of(seal.last_log_index, record)
    assert sealed.sha256 == seal.sha256
    return sealed
