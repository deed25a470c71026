"""Our log, snapshots and transport, in the form that the library expects.

The names in camelCase, one of them misspelt, are public names of the library.
"""

# ruff: noqa: N802, N803, N815

from __future__ import annotations

from typing import Any, overload

from stampede_rt_supernode.replication.library.translation import LibraryMessage, from_library
from stampede_rt_supernode.replication.log_entries import Entry
from stampede_rt_supernode.replication.storage.raft_log import RaftLog
from stampede_rt_supernode.replication.storage.snapshots import SnapshotKeeper
from stampede_rt_supernode.replication.storage.store import StoredSnapshot
from stampede_rt_supernode.replication.wire.buffered_transport import BufferedTransport

# The library's SERIALIZER_STATE numbers.
_NOT_SERIALIZING, _SERIALIZING, _SUCCESS = 0, 1, 2


class LibraryLog:
    """Our log as the library's log. For the library the first held entry has the number 0."""

    def __init__(self, log: RaftLog) -> None:
        self.log = log

    @overload
    def __getitem__(self, item: int) -> Entry: ...
    @overload
    def __getitem__(self, item: slice) -> list[Entry]: ...
    def __getitem__(self, item: int | slice) -> Entry | list[Entry]:
        return self.log[item]

    def __len__(self) -> int:
        return len(self.log)

    def add(self, command: bytes, idx: int, term: int) -> None:
        """Append an entry."""
        self.log.append(command, idx, term)

    def clear(self) -> None:
        """Forget every entry."""
        self.log.clear()

    def deleteEntriesFrom(self, entryFrom: int) -> None:
        """Remove the entries from number `entryFrom` on."""
        if entryFrom < len(self.log):
            self.log.cut_from(self.log[entryFrom].log_index)

    def deleteEntriesTo(self, entryTo: int) -> None:
        """Do nothing, because the adoption of a snapshot has already removed the entries that it replaces.

        Raises AssertionError if the library wants to remove more.
        """
        if entryTo > 0:
            raise AssertionError(f"the library wants to cut off {entryTo} entries that no snapshot contains")

    def setRaftCommitIndex(self, raftCommitIndex: int) -> None:
        """Note the commit index."""
        self.log.commit_index = raftCommitIndex

    def getRaftCommitIndex(self) -> int:
        """The commit index noted last."""
        return self.log.commit_index

    def setCurrentTerm(self, term: int, votedForNodeId: str | None) -> None:
        """Note term and vote."""
        self.log.set_term(term, votedForNodeId)

    def getCurrentTerm(self) -> int:
        """The term noted last."""
        return self.log.term

    def getVotedForNodeId(self) -> str | None:
        """The vote noted last."""
        return self.log.voted_for

    def onOneSecondTimer(self) -> None:
        """Have the next sync write the promises of the members. The library calls this about once a second."""
        self.log.flush_promises()


class LibrarySerializer:
    """Our snapshots as the library's serializer.

    Only the unchanged library receives snapshots through this class. Our rules use the SnapshotKeeper directly.
    """

    def __init__(self, keeper: SnapshotKeeper, log: RaftLog) -> None:
        self._keeper = keeper
        self._log = log
        # The last received snapshot, until the library opens it.
        self._received: StoredSnapshot | None = None

    def checkSerializing(self) -> tuple[int, int | None]:
        """The state of the present snapshot, and, as soon as it is adopted, the position of the log's first entry."""
        first = self._keeper.continue_snapshot()
        if first is not None:
            return _SUCCESS, first.log_index
        return (_SERIALIZING if self._keeper.is_busy else _NOT_SERIALIZING), None

    def serialize(self, data: tuple[Any, Any, Any, Any], id_: int) -> None:
        """Begin a snapshot as of the last applied entry."""
        _, last, previous, _ = data
        self._keeper.begin_taking(previous=Entry(*previous), last=Entry(*last))

    def setTransmissionData(self, data: Any) -> bool:
        """Add a piece. Returns True if the snapshot is complete and its checksum is right."""
        self._received = self._keeper.take_in(data)
        return self._received is not None

    def deserialize(self) -> tuple[None, Entry, Entry, list[str]]:
        """Open the last received snapshot, or else the stored one, into the state machine. Returns its parts."""
        stored, self._received = self._received or self._log.snapshot, None
        assert stored is not None
        snapshot = self._keeper.open_immediately(stored)
        return None, snapshot.last, snapshot.previous, []

    def cancelTransmisstion(self, id_: Any) -> None:
        """Stop sending to this member. The next time, its snapshot begins from the first piece."""
        self._keeper.cancel_sending(id_.id)


class LibraryTransport:
    """Our transport as the library's transport, for outgoing messages only.

    BufferedTransport passes incoming messages to the node directly. So no message reaches the functions of the library
    for remote administration and for read-only members without a name.
    """

    ready = True

    def __init__(self, transport: BufferedTransport) -> None:
        self._transport = transport

    def send(self, node: Any, message: LibraryMessage) -> bool:
        """Queue a message. Returns False if the member is not connected."""
        return self._transport.send(node, from_library(message))

    def _ignore(self, *callbacks: Any) -> None:
        """Ignore the callbacks that the library registers. They are never called."""

    setOnMessageReceivedCallback = setOnNodeConnectedCallback = setOnNodeDisconnectedCallback = _ignore
    setOnReadonlyNodeConnectedCallback = setOnReadonlyNodeDisconnectedCallback = setOnUtilityMessageCallback = _ignore
