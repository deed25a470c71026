"""The log over a store: a list in memory, and the changes that are not on disk yet.

Nothing is durable before `sync` returns. All changes since the last sync become durable together (group commit). The
tick thread calls `sync` before any message or result leaves the process.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Mapping
from itertools import chain, islice
from typing import overload

from stampede_rt_runtime.metrics.families import Durations
from stampede_rt_supernode.replication.configuration import Configuration, Configurations
from stampede_rt_supernode.replication.log_entries import CONFIGURATION, Entry
from stampede_rt_supernode.replication.storage.store import (
    Promise,
    SnapshotPiece,
    SnapshotTrailer,
    Store,
    StoreChanges,
    StoredSnapshot,
)
from stampede_rt_supernode.replication.wire.records import decode_configuration

WRITE_BOUNDS_SECONDS = (0.0005, 0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 3.0)
# The most promises that the log remembers. No cluster has this number of members, so the log drops only promises of
# non-members.
PROMISES_MAX = 64
# The memory that an entry takes in addition to its command, in bytes, as an estimate.
ENTRY_BYTES = 200


class RaftLog:
    """Log, term, vote and commit index. Entries have no gaps. `log[0]` is the first held entry."""

    def __init__(self, store: Store, *, kept_bytes_max: int = 0) -> None:
        """Load the state of `store`. Blocks. Raises StoreDamaged.

        `kept_bytes_max`: the most bytes of entries that the log keeps for slow members after a snapshot has replaced
        them.
        """
        state = store.load()
        self._kept_bytes_max = kept_bytes_max
        self._store = store
        self.write_times = Durations(WRITE_BOUNDS_SECONDS)
        """The durations of the writes to the store, each with its wait for the disk."""
        self._entries = state.entries
        self._term = state.term
        self._voted_for = state.voted_for
        # The commit index reaches the disk together with the next other change. If it is lost, the leader sends it
        # again.
        self.commit_index = state.commit_index
        self.snapshot = state.snapshot
        self._promises = dict(state.promises)
        self._promises_changed = False
        # The configurations in the entries. Every change of the entries changes them, too.
        self.configurations = Configurations(Configuration(()))
        # Entries that a snapshot has replaced, kept for slow members. They end just before the first held entry.
        self._kept: deque[Entry] = deque()
        self._kept_bytes = 0
        # The lowest log index from which the store differs from `_entries`; None if both agree.
        self._replace_from: int | None = None
        self._pending_pieces: list[SnapshotPiece] = []
        self._pending_trailer: SnapshotTrailer | None = None
        # True if term, vote, entries or snapshot wait for the disk. A change of only the commit index does not count.
        self._dirty = False

    def track_members(self, base: Configuration) -> None:
        """Set the configuration that was in effect before the first entry, and read the later configurations from the
        entries.
        """
        self.configurations = Configurations(base)
        for entry in self._entries:
            self._note_configuration(entry)

    def _note_configuration(self, entry: Entry) -> None:
        if entry.command[0] == CONFIGURATION:
            self.configurations.note(entry.log_index, decode_configuration(entry.command))

    def append(self, command: bytes, log_index: int, term: int) -> None:
        """Append an entry. `log_index` must follow the index of the last held entry."""
        if self._entries and log_index != self._entries[-1].log_index + 1:
            raise AssertionError(f"entry {log_index} does not follow {self._entries[-1].log_index}")
        self._entries.append(Entry(command, log_index, term))
        self._note_configuration(self._entries[-1])
        self._differs_from(log_index)

    def clear(self) -> None:
        """Remove every entry."""
        if self._entries:
            self._differs_from(0)
            self.keep_after(self._entries[-1].log_index)
        self._entries = []

    def cut_from(self, log_index: int) -> None:
        """Remove the entries at or after a position."""
        position = log_index - self._entries[0].log_index if self._entries else 0
        if position < len(self._entries):
            self._differs_from(log_index)
            self.configurations.cut_from(log_index)
            del self._entries[position:]

    @overload
    def __getitem__(self, item: int) -> Entry: ...
    @overload
    def __getitem__(self, item: slice) -> list[Entry]: ...
    def __getitem__(self, item: int | slice) -> Entry | list[Entry]:
        return self._entries[item]

    def __len__(self) -> int:
        return len(self._entries)

    @property
    def last_index(self) -> int:
        """The position of the last entry; 0 for an empty log."""
        return self._entries[-1].log_index if self._entries else 0

    @property
    def term(self) -> int:
        """The latest term."""
        return self._term

    @property
    def voted_for(self) -> str | None:
        """The id of the member for which this one has voted in the latest term; None if it has not voted."""
        return self._voted_for

    def set_term(self, term: int, voted_for: str | None) -> None:
        """Note term and vote. They are durable after the next sync."""
        if (term, voted_for) != (self._term, self._voted_for):
            self._term, self._voted_for = term, voted_for
            self._dirty = True

    @property
    def promises(self) -> Mapping[str, Promise]:
        """The promises of the other members, by id."""
        return self._promises

    def note_promise(self, member_id: str, term: int, held: int) -> None:
        """Raise the promise of a member to this term and this last entry, where they are greater.

        The promise reaches the disk together with the next other change, or after `flush_promises`.
        """
        known = self._promises.get(member_id, Promise(0, 0))
        if term > known.term or held > known.held:
            # A new dictionary, because other threads read the former one.
            promises = {one: promise for one, promise in self._promises.items() if one != member_id}
            promises[member_id] = Promise(max(term, known.term), max(held, known.held))
            self._promises = self._bounded(promises)
            self._promises_changed = True

    def _bounded(self, promises: dict[str, Promise]) -> dict[str, Promise]:
        """The promises. If there are too many, leaves out the oldest promises of non-members."""
        members = {member.member_id for member in self.configurations.known_members()}
        others = [member_id for member_id in promises if member_id not in members]
        for member_id in others[: max(0, len(promises) - PROMISES_MAX)]:
            del promises[member_id]
        return promises

    def flush_promises(self) -> None:
        """Have the next sync write the promises, even if there is no other change."""
        self._dirty = self._dirty or self._promises_changed

    def end(self) -> tuple[int, int]:
        """The latest term, and the position of the last entry. The hellos of this member state both."""
        return self._term, self.last_index

    def entry_at(self, log_index: int) -> Entry | None:
        """The entry at a log index; None if the log does not hold it."""
        position = log_index - self._entries[0].log_index if self._entries else -1
        return self._entries[position] if 0 <= position < len(self._entries) else None

    # -- entries for slow members ------------------------------------------------------------------------------

    @property
    def first_sendable(self) -> int:
        """The position of the first entry that can be sent; 0 for an empty log."""
        return (self._kept[0] if self._kept else self._entries[0]).log_index if self._entries else 0

    def sendable_at(self, log_index: int) -> Entry | None:
        """The entry at this position, also if the log keeps it only for slow members."""
        first = self.first_sendable
        return (
            self._kept[log_index - first] if first <= log_index < first + len(self._kept) else self.entry_at(log_index)
        )

    def sendable_from(self, log_index: int, bytes_max: int) -> list[Entry]:
        """The sendable entries from a position on, up to and including the entry that reaches `bytes_max`."""
        found, size, first = [], 0, self.first_sendable
        kept = islice(self._kept, max(0, log_index - first), None)
        held = islice(self._entries, max(0, log_index - first - len(self._kept)), None)
        for entry in chain(kept, held):
            found.append(entry)
            size += len(entry.command)
            if size >= bytes_max:
                break
        return found

    def keep_after(self, log_index: int) -> None:
        """Free the kept entries at or before a position. They can then no longer be sent."""
        while self._kept and self._kept[0].log_index <= log_index:
            self._free_oldest()

    def _keep(self, entries: list[Entry]) -> None:
        """Keep entries that a snapshot has replaced, in memory only. Frees the oldest beyond the limit in bytes."""
        for entry in entries:
            if self._kept and self._kept[-1].log_index + 1 != entry.log_index:
                self.keep_after(entry.log_index)
            self._kept.append(entry)
            self._kept_bytes += len(entry.command) + ENTRY_BYTES
        while self._kept_bytes > self._kept_bytes_max:
            self._free_oldest()

    def _free_oldest(self) -> None:
        self._kept_bytes -= len(self._kept.popleft().command) + ENTRY_BYTES

    # -- snapshots and the disk --------------------------------------------------------------------------------

    def write_piece(self, piece: SnapshotPiece) -> None:
        """Have the next sync write a piece of a coming snapshot, so that the adoption of the snapshot costs little."""
        self._pending_pieces.append(piece)
        self._dirty = True

    def adopt_snapshot(
        self, snapshot: StoredSnapshot, previous: Entry, last: Entry, configuration: Configuration
    ) -> None:
        """Let the log begin with the last two entries of a snapshot.

        `configuration` is the configuration that was in effect at `last`. Pass all pieces to `write_piece` before.
        Entries after `last` may be acknowledged already. So they stay if this log has the same entry `last`, and has
        either the same entry `previous` or no entry at that position. The snapshot's trailer and the log reach the disk
        together.
        """
        held_before = self.entry_at(previous.log_index) is not None
        # Compares whole entries, because a hostile leader may have made different entries with the same terms.
        if self.entry_at(last.log_index) == last and self.entry_at(previous.log_index) in (None, previous):
            keep_from = last.log_index + 1 - self._entries[0].log_index
            tail = self._entries[keep_from:]
            if held_before:
                self._keep(self._entries[: keep_from - 2])
            self._entries = [previous, last, *tail]
            self._dirty = True
            if not held_before:
                self._differs_from(previous.log_index)
        else:
            self._differs_from(0)
            self._entries = [previous, last]
            self.keep_after(last.log_index)
            self.configurations.cut_from(0)
        self.configurations.rebase(last.log_index, configuration)
        self.snapshot, self._pending_trailer = snapshot, snapshot.trailer()
        self._dirty = True

    def sync(self) -> bool:
        """Make all changes so far durable. Blocks on the disk. Returns True if there were any."""
        if not self._dirty:
            return False
        began_s = time.monotonic()
        self._store.commit(self._changes())
        self.write_times.add(time.monotonic() - began_s)
        self._replace_from, self._pending_trailer, self._dirty = None, None, False
        self._pending_pieces, self._promises_changed = [], False
        return True

    def close(self) -> None:
        """Make all changes durable, the commit index too, and close the store."""
        self._dirty = True
        self.sync()
        self._store.close()

    def _differs_from(self, log_index: int) -> None:
        self._replace_from = log_index if self._replace_from is None else min(self._replace_from, log_index)
        self._dirty = True

    def _changes(self) -> StoreChanges:
        first = self._entries[0].log_index if self._entries else 0
        fresh: list[Entry] = []
        if self._replace_from is not None:
            fresh = self._entries[max(0, self._replace_from - first) :]
        last = self._entries[-1] if self._entries else Entry(b"", 0, 0)
        return StoreChanges(
            replace_from=self._replace_from,
            entries=fresh,
            first_index=first,
            last_index=last.log_index,
            last_term=last.term,
            term=self._term,
            voted_for=self._voted_for,
            commit_index=min(self.commit_index, first + len(self._entries) - 1),
            promises=self._promises,
            pieces=self._pending_pieces,
            trailer=self._pending_trailer,
        )
