"""The library's serializer over our journal: snapshots in the store's own transaction, and in pieces on the wire."""

# The camelCase names, one of them misspelt, are the library's.
# ruff: noqa: N802, N803

from __future__ import annotations

import hashlib
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
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

    def result(self) -> bytes:
        """What it gave, once it is finished. Raises what it raised."""


RunAside = Callable[[Callable[[], bytes]], Result]


def run_at_once(work: Callable[[], bytes]) -> Result:
    """Do the work here and now."""
    finished: Future[bytes] = Future()
    finished.set_result(work())
    return finished


@dataclass(frozen=True, slots=True)
class _Taking:
    """A snapshot on its way to bytes."""

    record: Result
    previous: Entry
    last: Entry
    configuration: Configuration
    id: int


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
        self._received: bytes | None = None
        self._sha256 = b""

    def begin_step(self) -> None:
        """Allow the next pieces to be sent."""
        self._chunks_left = self._chunks_per_step

    def checkSerializing(self) -> tuple[int, int | None]:
        """SERIALIZING until the snapshot is encoded, then SUCCESS once, with snapshot and log on their way to the disk.

        Raises what encoding it has raised.
        """
        taking = self._taking
        if taking is None:
            return NOT_SERIALIZING, None
        if not taking.record.done():
            return SERIALIZING, None
        self._taking = None
        record = taking.record.result()
        if taking.last.log_index > self._journal[0].log_index:  # else a leader has sent a newer one meanwhile
            stored = StoredSnapshot(last_log_index=taking.last.log_index, record=record)
            self._adopt(stored, taking.previous, taking.last, taking.configuration)
        return SUCCESS, taking.id

    def serialize(self, data: tuple[Any, Any, Any, Any], id: int) -> None:
        """Begin a snapshot as of the last applied entry. It and the log's new beginning reach the disk together."""
        _, last, previous, _ = data
        last, previous = Entry(*last), Entry(*previous)
        configuration = self._journal.configurations.at(last.log_index)
        encode_state = self._state_machine.begin_snapshot()

        def encode() -> bytes:
            state = encode_state()
            return codec.encode_snapshot(previous=previous, last=last, configuration=configuration, state=state)

        self._taking = _Taking(self._run_aside(encode), previous, last, configuration, id)

    def deserialize(self) -> tuple[None, Entry, Entry, list[str]]:
        """Open the present snapshot into the state machine, as the unchanged library asks for it."""
        if self._received is not None:
            record, self._received = self._received, None
        else:
            assert self._journal.snapshot is not None
            record = self._journal.snapshot.record
        snapshot = codec.decode_snapshot(record)
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
        record, self._received = self._received, None
        snapshot = codec.decode_snapshot(record)
        last = snapshot.last
        if last.log_index > newer_than:
            self._state_machine.restore(snapshot.state)
            stored = StoredSnapshot(last_log_index=last.log_index, record=record)
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
        if not self._sha256:
            self._sha256 = hashlib.sha256(snapshot.record).digest()
        offset = self._sent.get(transmissionID.id, 0)
        data = snapshot.record[offset : offset + self._chunk_bytes]
        end = offset + len(data)
        is_last = end >= len(snapshot.record)
        self._sent[transmissionID.id] = 0 if is_last else end
        chunk = pb.RaftSnapshotChunk(
            last_log_index=snapshot.last_log_index,
            offset_bytes=offset,
            total_bytes=len(snapshot.record),
            sha256=self._sha256,
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
        self._received = bytes(incoming.data)
        return True

    def cancelTransmisstion(self, id: Any) -> None:
        """Start from the beginning with this node next time."""
        self._sent.pop(id.id, None)

    def _adopt(self, snapshot: StoredSnapshot, previous: Entry, last: Entry, configuration: Configuration) -> None:
        self._journal.adopt_snapshot(snapshot, previous, last, configuration)
        self._sent.clear()
        self._sha256 = b""


def _continues(incoming: _Incoming, chunk: pb.RaftSnapshotChunk) -> bool:
    return (
        chunk.offset_bytes == len(incoming.data)
        and chunk.last_log_index == incoming.last_log_index
        and chunk.total_bytes == incoming.total_bytes
        and chunk.sha256 == incoming.sha256
    )
