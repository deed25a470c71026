"""Takes, sends, receives and opens the snapshots of the log, all in pieces."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from stampede_rt_supernode.replication.configuration import Configuration
from stampede_rt_supernode.replication.interface import StateMachine
from stampede_rt_supernode.replication.log_entries import Entry
from stampede_rt_supernode.replication.storage.raft_log import RaftLog
from stampede_rt_supernode.replication.storage.snapshot_receiver import SnapshotReceiver
from stampede_rt_supernode.replication.storage.store import StoredSnapshot
from stampede_rt_supernode.replication.threads.worker_thread import Result, RunInBackground, run_inline
from stampede_rt_supernode.replication.wire import records
from stampede_rt_supernode.replication.wire.messages import SnapshotChunk


@dataclass(slots=True)
class _SnapshotUnderWay:
    """A snapshot that is being encoded, and that then goes to the disk in pieces."""

    encoded: Result[StoredSnapshot]
    previous: Entry
    last: Entry
    configuration: Configuration
    pieces_written: int = 0


@dataclass(slots=True)
class _SnapshotTransfer:
    """A snapshot that is being sent to a member.

    A newer snapshot replaces it only if the log lacks the entries after it. Otherwise a transfer might never end.
    """

    snapshot: StoredSnapshot
    sent_bytes: int = 0


class SnapshotKeeper:
    """Takes, sends, receives and opens snapshots. Tick thread only."""

    def __init__(
        self,
        log: RaftLog,
        state_machine: StateMachine,
        has_room: Callable[[str], bool],
        *,
        run_in_background: RunInBackground = run_inline,
        chunk_bytes: int = 256 * 1024,
        chunks_per_step: int = 8,
    ) -> None:
        self._log = log
        self._state_machine = state_machine
        self._has_room = has_room
        self._chunk_bytes = chunk_bytes
        self._chunks_per_step = chunks_per_step
        # The pieces that this step may still send, for all members together. The library would send all of them in one
        # step.
        self._chunks_left = chunks_per_step
        self._run_in_background = run_in_background
        # The snapshot that is being taken; None if there is none.
        self._taking: _SnapshotUnderWay | None = None
        # Member id -> the snapshot that this node is sending to the member.
        self._sending: dict[str, _SnapshotTransfer] = {}
        self._receiver = SnapshotReceiver(log, state_machine, run_in_background)

    def begin_step(self) -> None:
        """Begin a step of the tick thread, which may send `chunks_per_step` pieces again."""
        self._chunks_left = self._chunks_per_step

    def continue_snapshot(self) -> Entry | None:
        """Continue to take the snapshot under way.

        Returns None unless the snapshot ends in this step. Otherwise returns the entry before the last entry that the
        snapshot covers. If the log adopts the snapshot, this entry is now the log's first entry. The log does not adopt
        the snapshot if a leader has sent a newer one meanwhile.

        Another thread encodes the snapshot. Then each step writes one piece, so that no step takes long. The trailer
        and the log's new beginning reach the disk together. Raises the errors of the encoding.
        """
        taking = self._taking
        if taking is None or not taking.encoded.done():
            return None
        stored = taking.encoded.result()
        present = self._log.snapshot
        if present is None or stored.last_log_index > present.last_log_index:  # a leader may have sent a newer snapshot
            if taking.pieces_written < stored.pieces_count:
                self._log.write_piece(stored.piece(taking.pieces_written))
                taking.pieces_written += 1
                return None
            self._log.adopt_snapshot(stored, taking.previous, taking.last, taking.configuration)
        self._taking = None
        return taking.previous

    @property
    def is_taking(self) -> bool:
        """Whether a snapshot is being taken."""
        return self._taking is not None

    @property
    def is_busy(self) -> bool:
        """Whether a snapshot is being taken, or a leader's snapshot is being opened.

        Then no other snapshot begins, because both might end with the same entry.
        """
        return self.is_taking or self.is_opening

    def begin_taking(self, *, previous: Entry, last: Entry) -> None:
        """Begin a snapshot as of `last`, the last applied entry. `previous` is the entry before it."""
        configuration = self._log.configurations.at(last.log_index)
        encode_state = self._state_machine.begin_snapshot()

        def encode() -> StoredSnapshot:
            state = encode_state()
            record = records.encode_snapshot(previous=previous, last=last, configuration=configuration, state=state)
            return StoredSnapshot.of(last.log_index, record)

        self._taking = _SnapshotUnderWay(self._run_in_background(encode), previous, last, configuration)

    def open_immediately(self, stored: StoredSnapshot) -> records.SnapshotContents:
        """Replace the state machine's state by a snapshot, whatever the log holds. Returns the snapshot's parts."""
        snapshot = records.decode_snapshot(stored.record)
        self._state_machine.prepare_restore(snapshot.state)()
        return snapshot

    def restore(self) -> Entry | None:
        """Open the stored snapshot into the state machine, and return the last entry that it covers; None without a
        snapshot.

        Raises the errors of the decoding and of the state machine: a replica must not continue without its state.
        """
        if self._log.snapshot is None:
            return None
        snapshot = records.decode_snapshot(self._log.snapshot.record)
        if self._log[0] != snapshot.previous or self._log[1] != snapshot.last:
            raise AssertionError("the stored log does not begin where the stored snapshot ends")
        if snapshot.configuration is not None:
            self._log.configurations.rebase(snapshot.last.log_index, snapshot.configuration)
        self._state_machine.prepare_restore(snapshot.state)()
        return snapshot.last

    @property
    def is_opening(self) -> bool:
        """Whether a received snapshot is being opened into the state machine."""
        return self._receiver.is_opening

    def take_in(self, chunk: SnapshotChunk | None) -> StoredSnapshot | None:
        """Add a piece, if there is one. Returns the snapshot if it is complete and its checksum is right."""
        return None if chunk is None else self._receiver.take_in(chunk)

    def open(self, received: StoredSnapshot) -> None:
        """Begin to open a received snapshot; see `install_opened`."""
        self._receiver.open(received)

    def install_opened(self, *, newer_than: int, term_max: int) -> Entry | None:
        """Continue to open a snapshot; see `SnapshotReceiver.advance`."""
        last = self._receiver.advance(newer_than=newer_than, term_max=term_max)
        if last is not None:
            self.end_sending()
        return last

    def end_sending(self) -> None:
        """Stop sending snapshots to all members. Only a leader sends snapshots."""
        self._sending.clear()

    def next_chunk(self, member_id: str) -> SnapshotChunk | None:
        """The next piece for a member.

        None if the member's link has no room, if this step has sent enough pieces, or if there is no snapshot.
        """
        if self._chunks_left == 0 or not self._has_room(member_id):
            return None
        sending = self._sending_to(member_id)
        if sending is None:
            return None
        self._chunks_left -= 1
        snapshot, offset = sending.snapshot, sending.sent_bytes
        data = snapshot.record[offset : offset + self._chunk_bytes]
        sending.sent_bytes = offset + len(data)
        if sending.sent_bytes >= len(snapshot.record):
            del self._sending[member_id]
        return SnapshotChunk(
            last_log_index=snapshot.last_log_index,
            offset_bytes=offset,
            total_bytes=len(snapshot.record),
            sha256=snapshot.sha256,
            data=data,
        )

    def _sending_to(self, member_id: str) -> _SnapshotTransfer | None:
        """The snapshot that is being sent to a member; None if this node has no snapshot.

        Begins to send the present snapshot if none is being sent, or if the log no longer has the entries that follow
        the snapshot being sent.
        """
        sending, present = self._sending.get(member_id), self._log.snapshot
        if sending is not None and sending.snapshot.last_log_index >= self._log.first_sendable:
            return sending
        if present is None:
            return None
        self._sending[member_id] = _SnapshotTransfer(present)
        return self._sending[member_id]

    def sent_bytes(self, member_id: str) -> int:
        """The bytes of the snapshot under way that were sent to a member so far; 0 if none is under way to it."""
        sending = self._sending.get(member_id)
        return sending.sent_bytes if sending is not None else 0

    def cancel_sending(self, member_id: str) -> None:
        """Stop sending to this member. The next time, its snapshot begins from the first piece."""
        self._sending.pop(member_id, None)
