"""The library's serializer over our journal: snapshots in the store's own transaction, and in pieces on the wire."""

# The camelCase names, one of them misspelt, are the library's.
# ruff: noqa: N802, N803

from __future__ import annotations

import hashlib
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Protocol

from stampede_rt.v1 import raft_service_pb2 as pb
from stampede_rt_supernode.replication import codec
from stampede_rt_supernode.replication.configuration import Configuration
from stampede_rt_supernode.replication.interface import StateMachine
from stampede_rt_supernode.replication.journal import Journal
from stampede_rt_supernode.replication.storage import Entry, StoredSnapshot

NOT_SERIALIZING, SERIALIZING, SUCCESS, FAILED = 0, 1, 2, 3


class Piece(NamedTuple):
    """What the library carries between two serializers. It reads only the third field."""

    chunk: pb.RaftSnapshotChunk
    is_first: bool
    is_last: bool


class Result(Protocol):
    """What becomes of work that is done aside."""

    def done(self) -> bool:
        """Whether it is finished."""

    def result(self) -> StoredSnapshot:
        """What it gave, once it is finished. Raises what it raised."""


RunAside = Callable[[Callable[[], StoredSnapshot]], Result]


def run_at_once(work: Callable[[], StoredSnapshot]) -> Result:
    """Do the work here and now."""
    finished: Future[StoredSnapshot] = Future()
    finished.set_result(work())
    return finished


@dataclass(slots=True)
class _Taking:
    """A snapshot on its way to bytes, and then, piece by piece, to the disk."""

    encoded: Result
    previous: Entry
    last: Entry
    configuration: Configuration
    id: int
    pieces_written: int = 0


@dataclass
class _Incoming:
    """A snapshot on its way in. Invariant: `data` is its first len(data) bytes."""

    last_log_index: int
    total_bytes: int
    sha256: bytes
    data: bytearray


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
        # Member id -> how many bytes of the present snapshot it was sent.
        self._sent: dict[str, int] = {}
        self._incoming: _Incoming | None = None
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
            return NOT_SERIALIZING, None
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
        self._state_machine.restore(snapshot.state)
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
        self._state_machine.restore(snapshot.state)
        return snapshot.last

    def install_received(self, *, newer_than: int) -> Entry:
        """Open the snapshot that has just come in and let the log begin with it; return its last entry.

        One that ends at or before `newer_than` is dropped: going back would undo what was applied.
        Raises what decoding and the state machine raise.
        """
        assert self._received is not None
        received, self._received = self._received, None
        snapshot = codec.decode_snapshot(received.record)
        last = snapshot.last
        if last.log_index > newer_than:
            self._state_machine.restore(snapshot.state)
            stored = replace(received, last_log_index=last.log_index)
            for piece in stored.pieces():
                self._journal.write_piece(piece)
            # Without one the sender has never seen a change, and neither has this log.
            configuration = snapshot.configuration or self._journal.configurations.current
            self._adopt(stored, snapshot.previous, last, configuration)
        return last

    def getTransmissionData(self, transmissionID: Any) -> Piece | None:
        """The next piece for a node; None while its link or this step is full, or there is no snapshot."""
        snapshot = self._journal.snapshot
        if snapshot is None or self._chunks_left == 0 or not self._has_room(transmissionID.id):
            return None
        self._chunks_left -= 1
        offset = self._sent.get(transmissionID.id, 0)
        data = snapshot.record[offset : offset + self._chunk_bytes]
        end = offset + len(data)
        is_last = end >= len(snapshot.record)
        self._sent[transmissionID.id] = 0 if is_last else end
        chunk = pb.RaftSnapshotChunk(
            last_log_index=snapshot.last_log_index,
            offset_bytes=offset,
            total_bytes=len(snapshot.record),
            sha256=snapshot.sha256,
            data=data,
        )
        return Piece(chunk, offset == 0, is_last)

    def setTransmissionData(self, data: Any) -> bool:
        """Take in a piece; True when the snapshot is whole and its checksum holds.

        A piece that does not follow the last one drops what there is: the leader starts again when it sees
        that this replica still lacks the entries.
        """
        if data is None:
            return False
        chunk: pb.RaftSnapshotChunk = data.chunk if isinstance(data, Piece) else data
        if chunk.offset_bytes == 0:
            self._incoming = _Incoming(chunk.last_log_index, chunk.total_bytes, chunk.sha256, bytearray())
        incoming = self._incoming
        if incoming is None or not _continues(incoming, chunk):
            self._incoming = None
            return False
        incoming.data += chunk.data
        if len(incoming.data) < incoming.total_bytes:
            return False
        self._incoming = None
        if hashlib.sha256(incoming.data).digest() != incoming.sha256:
            return False
        self._received = StoredSnapshot(
            last_log_index=incoming.last_log_index, record=bytes(incoming.data), sha256=incoming.sha256
        )
        return True

    def cancelTransmisstion(self, id: Any) -> None:
        """Start from the beginning with this node next time."""
        self._sent.pop(id.id, None)

    def _adopt(self, snapshot: StoredSnapshot, previous: Entry, last: Entry, configuration: Configuration) -> None:
        self._journal.adopt_snapshot(snapshot, previous, last, configuration)
        self._sent.clear()


def _continues(incoming: _Incoming, chunk: pb.RaftSnapshotChunk) -> bool:
    return (
        chunk.offset_bytes == len(incoming.data)
        and chunk.last_log_index == incoming.last_log_index
        and chunk.total_bytes == incoming.total_bytes
        and chunk.sha256 == incoming.sha256
    )
