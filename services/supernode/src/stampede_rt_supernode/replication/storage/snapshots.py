"""Snapshots over the log: in the store's own transaction, and in pieces on the wire."""

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
class _Taking:
    """A snapshot on its way to bytes, and then, piece by piece, to the disk."""

    encoded: Result[StoredSnapshot]
    previous: Entry
    last: Entry
    configuration: Configuration
    pieces_written: int = 0


@dataclass(slots=True)
class _Sending:
    """A snapshot on its way to a member. A newer one does not take its place: the transfer would never end."""

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
        # What is still allowed in this step, for all members together: the library would send all in one go.
        self._chunks_left = chunks_per_step
        self._run_in_background = run_in_background
        # The snapshot that another thread encodes, and what it is of.
        self._taking: _Taking | None = None
        # Member id -> the snapshot that it is being sent.
        self._sending: dict[str, _Sending] = {}
        self._receiver = SnapshotReceiver(log, state_machine, run_in_background)

    def begin_step(self) -> None:
        """Allow the next pieces to be sent."""
        self._chunks_left = self._chunks_per_step

    def go_on_taking(self) -> Entry | None:
        """Go on with the snapshot that was begun; the first entry that the log keeps, once it is adopted.

        It is encoded on another thread; then one piece is written in each step, so that nobody waits for more. The seal
        and the log's new beginning reach the disk together. Raises what encoding it has raised.
        """
        taking = self._taking
        if taking is None or not taking.encoded.done():
            return None
        stored = taking.encoded.result()
        present = self._log.snapshot
        if present is None or stored.last_log_index > present.last_log_index:  # else a leader has sent a newer one
            if taking.pieces_written < stored.pieces_count:
                self._log.write_piece(stored.piece(taking.pieces_written))
                taking.pieces_written += 1
                return None
            self._log.adopt_snapshot(stored, taking.previous, taking.last, taking.configuration)
        self._taking = None
        return taking.previous

    @property
    def is_taking(self) -> bool:
        """Whether a snapshot is on its way."""
        return self._taking is not None

    @property
    def is_busy(self) -> bool:
        """Whether a snapshot is taken, or a leader's is opened: no other is begun, as both might end with one entry."""
        return self.is_taking or self.is_opening

    def begin_taking(self, *, previous: Entry, last: Entry) -> None:
        """Begin a snapshot as of the last applied entry."""
        configuration = self._log.configurations.at(last.log_index)
        encode_state = self._state_machine.begin_snapshot()

        def encode() -> StoredSnapshot:
            state = encode_state()
            record = records.encode_snapshot(previous=previous, last=last, configuration=configuration, state=state)
            return StoredSnapshot.of(last.log_index, record)

        self._taking = _Taking(self._run_in_background(encode), previous, last, configuration)

    def open_at_once(self, stored: StoredSnapshot) -> records.SnapshotContents:
        """Open a snapshot into the state machine, whatever the log holds."""
        snapshot = records.decode_snapshot(stored.record)
        self._state_machine.prepare_restore(snapshot.state)()
        return snapshot

    def restore(self) -> Entry | None:
        """Open the stored snapshot into the state machine and return the last entry it covers; None without one.

        Raises what decoding and the state machine raise: a replica must not go on without its state.
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
        """Whether a received snapshot is on its way into the state machine."""
        return self._receiver.is_opening

    def take_in(self, chunk: SnapshotChunk | None) -> StoredSnapshot | None:
        """Take in a piece, if there is one; the snapshot when it is whole and its checksum holds."""
        return None if chunk is None else self._receiver.take_in(chunk)

    def open(self, received: StoredSnapshot) -> None:
        """Begin to open a snapshot that has come in; see `install_opened`."""
        self._receiver.open(received)

    def install_opened(self, *, newer_than: int, term_max: int) -> Entry | None:
        """Go on with what is opened; see `SnapshotReceiver.advance`."""
        last = self._receiver.advance(newer_than=newer_than, term_max=term_max)
        if last is not None:
            self.end_sending()
        return last

    def end_sending(self) -> None:
        """Let go of all snapshots that are being sent: this member does not lead any more."""
        self._sending.clear()

    def next_chunk(self, member_id: str) -> SnapshotChunk | None:
        """The next piece for a member; None while its link or this step is full, or there is no snapshot."""
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

    def _sending_to(self, member_id: str) -> _Sending | None:
        """The snapshot on its way to a member: the present one, or an older one behind which the log is kept."""
        sending, present = self._sending.get(member_id), self._log.snapshot
        if sending is not None and sending.snapshot.last_log_index >= self._log.first_sendable:
            return sending
        if present is None:
            return None
        self._sending[member_id] = _Sending(present)
        return self._sending[member_id]

    def sent_bytes(self, member_id: str) -> int:
        """How much a member was sent of the snapshot that it is being sent; 0 if it is sent none."""
        sending = self._sending.get(member_id)
        return sending.sent_bytes if sending is not None else 0

    def cancel_sending(self, member_id: str) -> None:
        """Start from the beginning with this member next time."""
        self._sending.pop(member_id, None)
