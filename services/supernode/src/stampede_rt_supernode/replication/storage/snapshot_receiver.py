"""Receives a leader's snapshot: its pieces come, a worker thread decodes them, and they go to the disk and the log.

The tick thread does its part in steps. With 100,000 channels the decoding alone takes half a second. If one step did
all of it, this member would answer no leader and confirm no read for that time, and would count as lost.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, replace

from stampede_rt_supernode.replication.interface import ReleaseTooOld, StateMachine
from stampede_rt_supernode.replication.log_entries import Entry
from stampede_rt_supernode.replication.storage.raft_log import RaftLog
from stampede_rt_supernode.replication.storage.store import StoredSnapshot
from stampede_rt_supernode.replication.threads.worker_thread import Result, RunInBackground
from stampede_rt_supernode.replication.wire import records
from stampede_rt_supernode.replication.wire.messages import SnapshotChunk


@dataclass
class _IncomingSnapshot:
    """The pieces received so far. Invariant: `data` is the beginning of the snapshot."""

    last_log_index: int
    total_bytes: int
    sha256: bytes
    data: bytearray


@dataclass(frozen=True, slots=True)
class _DecodedSnapshot:
    """A complete snapshot, and the function that makes it the state of the state machine."""

    stored: StoredSnapshot
    snapshot: records.SnapshotContents
    restore: Callable[[], None]


class UnreadableSnapshot(Exception):
    """The snapshot came complete, but this member cannot use it."""


@dataclass(slots=True)
class _SnapshotInstallation:
    """A complete snapshot that another thread decodes, and that then goes to the disk in pieces."""

    decoded: Result[_DecodedSnapshot | UnreadableSnapshot | ReleaseTooOld]
    pieces_written: int = 0


class SnapshotReceiver:
    """Receives and opens one snapshot at a time. Tick thread only."""

    def __init__(self, log: RaftLog, state_machine: StateMachine, run_in_background: RunInBackground) -> None:
        self._log = log
        self._state_machine = state_machine
        self._run_in_background = run_in_background
        self._incoming: _IncomingSnapshot | None = None
        self._opening: _SnapshotInstallation | None = None

    @property
    def is_opening(self) -> bool:
        """Whether a complete snapshot is being decoded or written."""
        return self._opening is not None

    def take_in(self, chunk: SnapshotChunk) -> StoredSnapshot | None:
        """Add a piece. Returns the snapshot if it is complete and its checksum is right.

        A piece that does not follow the last one drops all pieces. The leader starts again when it sees that this
        replica still lacks the entries.
        """
        if chunk.offset_bytes == 0:
            self._incoming = _IncomingSnapshot(chunk.last_log_index, chunk.total_bytes, chunk.sha256, bytearray())
        incoming = self._incoming
        if incoming is None or not _continues(incoming, chunk):
            self._incoming = None
            return None
        incoming.data += chunk.data
        if len(incoming.data) < incoming.total_bytes:
            return None
        self._incoming = None
        if hashlib.sha256(incoming.data).digest() != incoming.sha256:
            return None
        return StoredSnapshot(
            last_log_index=incoming.last_log_index, record=bytes(incoming.data), sha256=incoming.sha256
        )

    def open(self, received: StoredSnapshot) -> None:
        """Begin to open a snapshot. Call it only while `is_opening` is False."""

        def decode() -> _DecodedSnapshot | UnreadableSnapshot | ReleaseTooOld:
            try:
                snapshot = records.decode_snapshot(received.record)
                restore = self._state_machine.prepare_restore(snapshot.state)
            except ReleaseTooOld as error:
                return error  # the snapshot is sound, so its sender is not at fault
            except Exception as error:  # noqa: BLE001 - a peer has made it, and no content may end this process
                return UnreadableSnapshot(f"it cannot be read: {error!r}")
            return _DecodedSnapshot(replace(received, last_log_index=snapshot.last.log_index), snapshot, restore)

        self._opening = _SnapshotInstallation(self._run_in_background(decode))

    def advance(self, *, newer_than: int, term_max: int) -> Entry | None:
        """Continue to open the snapshot: each call writes at most one piece to the disk.

        Returns the last entry that the snapshot covers, as soon as the state machine and the log have taken the
        snapshot over. Until then returns None. A snapshot that ends at or before `newer_than` is dropped, because it
        would undo applied entries. Raises UnreadableSnapshot for an invalid snapshot, or for a snapshot of a later term
        than `term_max`, and ReleaseTooOld. Then the log is unchanged.
        """
        opening = self._opening
        if opening is None or not opening.decoded.done():
            return None
        decoded = opening.decoded.result()
        if isinstance(decoded, (UnreadableSnapshot, ReleaseTooOld)):
            self._opening = None
            raise decoded
        stored, snapshot = decoded.stored, decoded.snapshot
        if snapshot.last.term > term_max:
            self._opening = None
            raise UnreadableSnapshot(f"it ends in term {snapshot.last.term}, and this is term {term_max}")
        if snapshot.last.log_index <= newer_than:
            self._opening = None
            return None
        if opening.pieces_written < stored.pieces_count:
            self._log.write_piece(stored.piece(opening.pieces_written))
            opening.pieces_written += 1
            return None
        self._opening = None
        decoded.restore()
        # If the snapshot has no configuration, the members have never changed. Then the log's own one is right.
        configuration = snapshot.configuration or self._log.configurations.current
        self._log.adopt_snapshot(stored, snapshot.previous, snapshot.last, configuration)
        return snapshot.last


def _continues(incoming: _IncomingSnapshot, chunk: SnapshotChunk) -> bool:
    return (
        chunk.offset_bytes == len(incoming.data)
        and chunk.last_log_index == incoming.last_log_index
        and chunk.total_bytes == incoming.total_bytes
        and chunk.sha256 == incoming.sha256
    )
