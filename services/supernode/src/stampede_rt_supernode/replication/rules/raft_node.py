"""The library's node, made to fit our state machine, and what its corrected rules share.

`BytesNode` changes no rule. `NodeState` declares every name of the library's inside that the rules use;
library/pinned_copy.py pins the file they are in. The rules themselves are in following.py, leading.py and
elections.py. They keep to the Raft paper (Ongaro and Ousterhout 2014, figures 2 and 13); each says which fault of
PySyncObj 0.3.17 it closes.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from stampede_rt_supernode.replication.interface import Member, StateMachine
from stampede_rt_supernode.replication.library.pinned_copy import COMMAND, FOLLOWER, LEADER
from stampede_rt_supernode.replication.rules.digests import Digests
from stampede_rt_supernode.replication.storage.journal import Journal
from stampede_rt_supernode.replication.storage.snapshots import SnapshotKeeper
from stampede_rt_supernode.replication.wire.mailroom import Mailroom


class InvariantViolation(RuntimeError):
    """The log broke a promise of Raft. The replica stops before it can do more harm."""


class BytesNode:
    """What every variant of the node needs: commands are bytes, applied with their position."""

    _SyncObj__raftLastApplied: int
    _SyncObj__raftLog: Journal
    _SyncObj__raftLeader: Any
    state_machine: StateMachine
    digests: Digests

    def on_stream_opened(self, node: Any) -> None:
        """A member has opened a new stream; the library itself would not care."""

    def on_members_told(self, members: tuple[Member, ...]) -> None:
        """A member has said who the members are; the library itself would not care."""

    def on_introduced(self, member: Member) -> None:
        """A stranger has said that it is a member; the library itself would not care."""

    def _SyncObj__doApplyCommand(self, command: bytes) -> bytes | None:  # noqa: N802
        # The library unpickles here and picks a method by number.
        if command[0] != COMMAND:
            return None
        result = self.state_machine.apply(self._SyncObj__raftLastApplied + 1, command[1:])
        self.digests.note(*self.state_machine.digest())
        return result


class NodeState(BytesNode):
    """What all rules read and change. Tick thread only."""

    _SyncObj__otherNodes: set[Any]
    _SyncObj__raftState: int
    _SyncObj__raftCurrentTerm: int
    _SyncObj__votedForNodeId: str | None
    _SyncObj__votesCount: int
    _SyncObj__raftElectionDeadline: float
    _SyncObj__raftCommitIndex: int
    _SyncObj__leaderCommitIndex: int
    _SyncObj__raftNextIndex: dict[Any, int]
    _SyncObj__raftMatchIndex: dict[Any, int]
    _SyncObj__lastResponseTime: dict[Any, float]
    _SyncObj__commandsWaitingCommit: dict[int, list[Any]]
    _SyncObj__commandsLocalCounter: int
    _SyncObj__noopIDx: int | None
    _SyncObj__needLoadDumpFile: bool
    _SyncObj__setCurrentTerm: Any
    _SyncObj__onLeaderChanged: Any
    _SyncObj__onBecomeLeader: Any
    _SyncObj__generateRaftTimeout: Any
    _SyncObj__newAppendEntriesTime: float
    _SyncObj__connectedNodes: set[Any]

    conf: Any
    mailroom: Mailroom
    has_room: Callable[[str], bool]
    keeper: SnapshotKeeper
    clock: Any
    reads: Any
    unknown_outcome: int

    # When this node last heard from a leader of its term, by `clock`.
    last_leader_contact: float = float("-inf")

    def open_snapshot(self) -> None:
        """Load the stored snapshot before the first tick. Raises: a node without its state must not take part.

        The library does this in its first tick, swallows every failure and starts empty.
        """
        self._SyncObj__needLoadDumpFile = False
        last = self.keeper.restore()
        if last is not None:
            self._SyncObj__raftLastApplied = last.log_index
            self._raise_commit_index(last.log_index)
            self.digests.note(*self.state_machine.digest())

    def _SyncObj__onNodeDisconnected(self, node: Any) -> None:  # noqa: N802
        super()._SyncObj__onNodeDisconnected(node)  # type: ignore[misc]
        # Pieces of a snapshot may be lost with the link; the library would go on in the middle.
        self.keeper.cancelTransmisstion(node)
        self.on_stream_opened(node)

    def on_stream_opened(self, node: Any) -> None:
        """Our stream to a member broke, or it opened a new one to us: requests or replies may be lost.

        The library lets the callers of forwarded commands wait for ever.
        """
        if node == self._SyncObj__raftLeader:
            self._SyncObj__onLeaderChanged()
            self.reads.on_leader_lost()

    def _SyncObj__setState(self, new_state: int) -> None:  # noqa: N802
        was_leader = self._SyncObj__raftState == LEADER
        super()._SyncObj__setState(new_state)  # type: ignore[misc]
        if was_leader and new_state != LEADER:
            self.reads.on_leader_lost()
            self.keeper.end_sending()
            self._SyncObj__raftLog.keep_after(self._SyncObj__raftLog[-1][1])

    def _step_down(self, term: int) -> None:
        if term > self._SyncObj__raftCurrentTerm:
            self._SyncObj__setCurrentTerm(term, None)
        self._SyncObj__setState(FOLLOWER)
        self._SyncObj__raftLeader = None

    def _log_end(self) -> tuple[int, int]:
        """(term, index) of the last entry: the order in which logs are more or less complete."""
        last = self._SyncObj__raftLog[-1]
        return last[2], last[1]

    def is_majority(self, count: int) -> bool:
        """Whether so many members, this one included, are more than half of all."""
        return 2 * count > len(self._SyncObj__otherNodes) + 1

    def _put_off_election(self) -> None:
        self._SyncObj__raftElectionDeadline = self.clock() + self._SyncObj__generateRaftTimeout()

    def _raise_commit_index(self, log_index: int) -> None:
        if log_index > self._SyncObj__raftCommitIndex:
            self._SyncObj__raftCommitIndex = log_index
            self._SyncObj__raftLog.setRaftCommitIndex(log_index)

    # -- what confirmed reads ask ------------------------------------------------------------------------------

    def can_confirm_reads(self) -> bool:
        """Whether this node leads and has applied an entry of its own term: before, it may lack older ones."""
        own = self._SyncObj__noopIDx
        return self._SyncObj__raftState == LEADER and own is not None and own <= self._SyncObj__raftLastApplied

    def commit_index(self) -> int:
        """Everything up to here is committed."""
        return self._SyncObj__raftCommitIndex

    def applied_index(self) -> int:
        """Everything up to here is applied."""
        return self._SyncObj__raftLastApplied

    def leader_node(self) -> Any:
        """The leader this node follows, itself, or None."""
        return self._SyncObj__raftLeader
