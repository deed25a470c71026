"""The library's serializer over our journal: snapshots in the store's own transaction, and in pieces on the wire."""

# The camelCase names, one of them misspelt, are the library's.
# ruff: noqa: N802, N803

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

from stampede_rt.v1 import raft_service_pb2 as pb
from stampede_rt_supernode.replication.configuration import Configuration
from stampede_rt_supernode.replication.interface import StateMachine
from stampede_rt_supernode.replication.storage.journal import Journal
from stampede_rt_supernode.replication.storage.receiving import SnapshotReceiver
from stampede_rt_supernode.replication.storage.store import Entry, StoredSnapshot
from stampede_rt_supernode.replication.threads.aside import Result, RunAside, run_at_once
from stampede_rt_supernode.replication.wire import codec

NOT_SERIALIZING, SERIALIZING, SUCCESS, FAILED = 0, 1, 2, 3


class Piece(NamedTuple):
    """What the library carries between two serializers. It reads only the third field."""

    chunk: pb.RaftSnapshotChunk
    is_first: bool
    is_last: bool


@dataclass(slots=True)
class _Taking:
    """A snapshot on its way to bytes, and then, piece by piece, to the disk."""

    encoded: Result[StoredSnapshot]
    previous: Entry
    last: Entry
    configuration: Configuration
    id: int
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
        journal: Journal,
        state_machine: StateMachine,
        has_room: Callable[[str], bool],
        *,
        run_aside: RunAside = run_at_once,
        chunk_bytes: int = 256 * 1024,
        chunks_per_step: int = 8,
    ) -> None:
        self._journal = journal
        self._state_machine = state_machine
        self._has_room = has_room
        self._chunk_bytes = chunk_bytes
        self._chunks_per_step = chunks_per_step
        # What is still allowed in this step, for all members together: the library would send all in one go.
        self._chunks_left = chunks_per_step
        self._run_aside = run_aside
        # The snapshot that another thread encodes, and what it is of.
        self._taking: _Taking | None = None
        # Member id -> the snapshot that it is being sent.
        self._sending: dict[str, _Sending] = {}
        self._receiver = SnapshotReceiver(journal, state_machine, run_aside)
        # The last one that is whole.
        self._received: StoredSnapshot | None = None

    def begin_step(self) -> None:
        """Allow the next pieces to be sent."""
        self._chunks_left = self._chunks_per_step

    def checkSerializing(self) -> tuple[int, int | None]:
        """SERIALIZING until the snapshot is encoded and all but its seal written; then SUCCESS once, with the seal and
        the log's new beginning on their way to the disk.

        One piece is written in each step: nobody waits for more. Raises what encoding it has raised.
        """
        taking = self._taking
        if taking is None:
            # None is begun while a leader's is opened: both might end with the same entry.
            return SERIALIZING if self.is_opening else NOT_SERIALIZING, None
        if not taking.encoded.done():
            return SERIALIZING, None
        stored = taking.encoded.result()
        present = self._journal.snapshot
        if present is None or stored.last_log_index > present.last_log_index:  # else a leader has sent a newer one
            if taking.pieces_written < stored.pieces_count:
                self._journal.write_piece(stored.piece(taking.pieces_written))
                taking.pieces_written += 1
                return SERIALIZING, None
            self._adopt(stored, taking.previous, taking.last, taking.configuration)
        self._taking = None
        return SUCCESS, taking.id

    @property
    def is_taking(self) -> bool:
        """Whether a snapshot is on its way."""
        return self._taking is not None

    def serialize(self, data: tuple[Any, Any, Any, Any], id: int) -> None:
        """Begin a snapshot as of the last applied entry."""
        _, last, previous, _ = data
        last, previous = Entry(*last), Entry(*previous)
        configuration = self._journal.configurations.at(last.log_index)
        encode_state = self._state_machine.begin_snapshot()

        def encode() -> StoredSnapshot:
            state = encode_state()
            record = codec.encode_snapshot(previous=previous, last=last, configuration=configuration, state=state)
            return StoredSnapshot.of(last.log_index, record)

        self._taking = _Taking(self._run_aside(encode), previous, last, configuration, id)

    def deserialize(self) -> tuple[None, Entry, Entry, list[str]]:
        """Open the present snapshot into the state machine, as the unchanged library asks for it."""
        stored, self._received = self._received or self._journal.snapshot, None
        assert stored is not None
        snapshot = codec.decode_snapshot(stored.record)
        self._state_machine.prepare_restore(snapshot.state)()
        return None, snapshot.last, snapshot.previous, []

    def restore(self) -> Entry | None:
        """Open the stored snapshot into the state machine and return the last entry it covers; None without one.

        Raises what decoding and the state machine raise: a replica must not go on without its state.
        """
        if self._journal.snapshot is None:
            return None
        snapshot = codec.decode_snapshot(self._journal.snapshot.record)
        if self._journal[0] != snapshot.previous or self._journal[1] != snapshot.last:
            raise AssertionError("the stored log does not begin where the stored snapshot ends")
        if snapshot.configuration is not None:
            self._journal.configurations.rebase(snapshot.last.log_index, snapshot.configuration)
        self._state_machine.prepare_restore(snapshot.state)()
        return snapshot.last

    @property
    def is_opening(self) -> bool:
        """Whether a received snapshot is on its way into the state machine."""
        return self._receiver.is_opening

    def open_received(self) -> None:
        """Begin to open the snapshot that has just come in."""
        assert self._received is not None
        received, self._received = self._received, None
        self._receiver.open(received)

    def install_opened(self, *, newer_than: int) -> Entry | None:
        """Go on with what is opened; see `SnapshotReceiver.advance`."""
        last = self._receiver.advance(newer_than=newer_than)
        if last is not None:
            self.end_sending()
        return last

    def end_sending(self) -> None:
        """Let go of all snapshots that are being sent: this member does not lead any more."""
        self._sending.clear()

    def getTransmissionData(self, transmissionID: Any) -> Piece | None:
        """The next piece for a node; None while its link or this step is full, or there is no snapshot."""
        if self._chunks_left == 0 or not self._has_room(transmissionID.id):
            return None
        sending = self._sending_to(transmissionID.id)
        if sending is None:
            return None
        self._chunks_left -= 1
        snapshot, offset = sending.snapshot, sending.sent_bytes
        data = snapshot.record[offset : offset + self._chunk_bytes]
        sending.sent_bytes = offset + len(data)
        is_last = sending.sent_bytes >= len(snapshot.record)
        if is_last:
            del self._sending[transmissionID.id]
        chunk = pb.RaftSnapshotChunk(
            last_log_index=snapshot.last_log_index,
            offset_bytes=offset,
            total_bytes=len(snapshot.record),
            sha256=snapshot.sha256,
            data=data,
        )
        return Piece(chunk, offset == 0, is_last)

    def _sending_to(self, member_id: str) -> _Sending | None:
        """What is being sent to a member: the present snapshot, or an older one behind which the log is kept."""
        sending, present = self._sending.get(member_id), self._journal.snapshot
        if sending is not None and sending.snapshot.last_log_index >= self._journal.first_sendable:
            return sending
        if present is None:
            return None
        self._sending[member_id] = _Sending(present)
        return self._sending[member_id]

    def setTransmissionData(self, data: Any) -> bool:
        """Take in a piece; True when the snapshot is whole and its checksum holds."""
        if data is None:
            return False
        self._received = self._receiver.take_in(data.chunk if isinstance(data, Piece) else data)
        return self._received is not None

    def sent_bytes(self, member_id: str) -> int:
        """How much a member was sent of the snapshot that it is being sent; 0 if it is sent none."""
        sending = self._sending.get(member_id)
        return sending.sent_bytes if sending is not None else 0

    def cancelTransmisstion(self, id: Any) -> None:
        """Start from the beginning with this node next time."""
        self._sending.pop(id.id, None)

    def _adopt(self, snapshot: StoredSnapshot, previous: Entry, last: Entry, configuration: Configuration) -> None:
        self._journal.adopt_snapshot(snapshot, previous, last, configuration)
