"""A disk that needs time to store data. After a loss of power it has only the synced data."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from stampede_rt_supernode.replication.log_entries import Entry
from stampede_rt_supernode.replication.storage.store import SnapshotTrailer, StoreChanges, StoredSnapshot, StoredState

# The most commits that may be under way together. All writes of one step of the replica begin with the step.
COMMITS_PER_STEP_MAX = 4


class Commit(NamedTuple):
    """The written data, the time of the write, and the end of its sync."""

    began: float
    durable: float
    state: StoredState


@dataclass
class Disk:
    """A disk that survives a crash of its replica. A crash keeps or loses a commit whose sync has not ended."""

    # A planted fault: a loss of power also deletes this number of commits that the disk has acknowledged as synced.
    lost_commits: int = 0
    commits: list[Commit] = field(default_factory=lambda: [Commit(0.0, 0.0, StoredState())])
    # All pieces of snapshots, by last log index and number. No reader sees them before the trailer is stored.
    pieces: dict[tuple[int, int], bytes] = field(default_factory=dict)

    @property
    def newest(self) -> StoredState:
        """The data that the running process reads."""
        return self.commits[-1].state

    def durable(self, now: float) -> StoredState:
        """The data that certainly survives a crash at `now`."""
        return [one for one in self.commits if one.durable <= now][-1].state

    def lose_power(self, now: float, *, lucky: Callable[[], bool]) -> None:
        """Lose the power. Synced data stays. The data under way stays if `lucky()` is true."""
        kept = len([one for one in self.commits if one.durable <= now]) - 1
        while kept + 1 < len(self.commits) and self.commits[kept + 1].began <= now and lucky():
            kept += 1
        del self.commits[kept + 1 :]
        del self.commits[len(self.commits) - min(self.lost_commits, len(self.commits) - 1) :]

    def put_back(self, state: StoredState) -> None:
        """Restore a backup of the disk."""
        self.commits = [Commit(0.0, 0.0, state)]

    def copied(self) -> StoredState:
        """A copy of the data that the running process reads."""
        return replace(self.newest, entries=list(self.newest.entries))


class DiskStore:
    """A Store over a Disk, with the behaviour of SqliteStore. `write` returns when a commit begins, and when its sync
    ends.
    """

    def __init__(self, disk: Disk, write: Callable[[], tuple[float, float]] = lambda: (0.0, 0.0)) -> None:
        self._disk = disk
        self._write = write

    def load(self) -> StoredState:
        return self._disk.copied()

    def commit(self, changes: StoreChanges) -> None:
        began, durable = self._write()
        for piece in changes.pieces:
            self._disk.pieces[piece.last_log_index, piece.number] = piece.data
        state = _applied(self._disk.newest, changes, self._disk.pieces)
        self._disk.commits.append(Commit(began, durable, state))
        del self._disk.commits[: -COMMITS_PER_STEP_MAX - 1 - self._disk.lost_commits]

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
        snapshot=_complete(changes.trailer, pieces) if changes.trailer else state.snapshot,
        promises=changes.promises,
    )


def _complete(trailer: SnapshotTrailer, pieces: Mapping[tuple[int, int], bytes]) -> StoredSnapshot:
    record = b"".join(pieces[trailer.last_log_index, number] for number in range(trailer.pieces_count))
    complete = StoredSnapshot.of(trailer.last_log_index, record)
    assert complete.sha256 == trailer.sha256
    return complete
