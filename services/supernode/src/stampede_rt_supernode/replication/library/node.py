"""The Raft node of PySyncObj in the words of the Raft paper (Ongaro and Ousterhout 2014, figure 2).

This module alone knows the private names of the library: `_SyncObj__raftCurrentTerm` is `term` from here on, and a
private method that the library calls is a method with a plain name. Without a rule above it, the node does what the
unchanged library does. pinned_copy.py proves that the library is the one with these names.
"""

# The library's own names are in camelCase.
# ruff: noqa: N802, N803, N815

from __future__ import annotations

import enum
from collections.abc import Callable
from typing import Any, Generic, Protocol, TypeVar

from stampede_rt_supernode.replication.interface import Member, StateMachine
from stampede_rt_supernode.replication.library.seams import LibraryLog
from stampede_rt_supernode.replication.library.translation import to_library
from stampede_rt_supernode.replication.log_entries import COMMAND
from stampede_rt_supernode.replication.storage.raft_log import RaftLog
from stampede_rt_supernode.replication.wire.buffered_transport import MemberNode
from stampede_rt_supernode.replication.wire.messages import Message

T = TypeVar("T")

FOLLOWER, CANDIDATE, LEADER = 0, 1, 2


class RandomSource(Protocol):
    """Where election timeouts get their randomness."""

    def random(self) -> float:
        """A number in [0, 1)."""


class Fate(enum.Enum):
    """The fate of a command without a result."""

    # It is certainly not in the log, or was cut off the log before anybody applied it.
    NOT_TAKEN = enum.auto()
    # It may be in the log.
    UNKNOWN = enum.auto()


ProposalDone = Callable[[bytes | Fate], None]

# The library's FAIL_REASON numbers. A command was not taken when its queue was full, no leader was known, its entry was
# discarded, the leader refused, or the state does not take it yet. Nothing is known after a change of the leader, or
# when the library says so.
_SUCCESS = 0
_REASON_DENIED = 6
_REASONS_NOT_TAKEN = frozenset((1, 2, 3, 4, _REASON_DENIED))
_REASON_UNKNOWN = 7
_REASONS_UNKNOWN = frozenset((5, _REASON_UNKNOWN))


class _Private(Generic[T]):
    """A private attribute of the library under another name."""

    def __init__(self, name: str) -> None:
        self._name = f"_SyncObj__{name}"

    def __get__(self, node: Any, owner: type) -> T:
        value: T = getattr(node, self._name)
        return value

    def __set__(self, node: Any, value: T) -> None:
        setattr(node, self._name, value)


class LibraryNode:
    """Stands before the library's class in the order of methods. Tick thread only.

    The library's constructor runs last: what its methods need is attached before (see rules/node_builder.py). A member
    is a node of the library with an `id`; sets and dictionaries of members leave this node out.
    """

    term = _Private[int]("raftCurrentTerm")
    voted_for = _Private[str | None]("votedForNodeId")
    votes_count = _Private[int]("votesCount")
    # FOLLOWER, CANDIDATE or LEADER.
    role = _Private[int]("raftState")
    # Whom this node follows, itself, or None.
    leader = _Private[MemberNode | None]("raftLeader")
    # Everybody who votes with this node.
    other_voters = _Private[set[MemberNode]]("otherNodes")
    # To whom messages leave at present.
    connected = _Private[set[MemberNode]]("connectedNodes")
    # By the clock that was given to `load_library`.
    election_deadline = _Private[float]("raftElectionDeadline")
    commit_index = _Private[int]("raftCommitIndex")
    # As the leader said last.
    leader_commit_index = _Private[int]("leaderCommitIndex")
    last_applied = _Private[int]("raftLastApplied")
    # Of the leader, by member.
    next_index = _Private[dict[MemberNode, int]]("raftNextIndex")
    match_index = _Private[dict[MemberNode, int]]("raftMatchIndex")
    last_response_time = _Private[dict[MemberNode, float]]("lastResponseTime")
    # The position of the first entry that this node has written as the leader of its term.
    first_index_of_term = _Private[int | None]("noopIDx")

    state_machine: StateMachine
    clock: Callable[[], float]

    _SyncObj__raftLog: LibraryLog
    _SyncObj__commandsWaitingCommit: dict[int, list[tuple[int, Callable[[Any, int], None]]]]
    _SyncObj__commandsWaitingReply: dict[int, Callable[[Any, int], None]]
    _SyncObj__setCurrentTerm: Callable[[int, str | None], None]
    _SyncObj__onBecomeLeader: Callable[[], None]
    _SyncObj__onLeaderChanged: Callable[[], None]
    _SyncObj__onNodeConnected: Callable[[MemberNode], None]
    _SyncObj__onNodeDisconnected: Callable[[MemberNode], None]
    _SyncObj__generateRaftTimeout: Callable[[], float]
    _SyncObj__callErrCallback: Callable[[int, Any], None]
    doTick: Callable[[float], None]
    forceLogCompaction: Callable[[], None]
    conf: Any

    @property
    def log(self) -> RaftLog:
        """Entries, term and vote on their way to the disk."""
        return self._SyncObj__raftLog.log

    @property
    def is_leader(self) -> bool:
        """Whether this node leads, as far as it knows."""
        return self.role == LEADER

    # -- what the rules have the library do ------------------------------------------------------------------------

    def tick(self) -> None:
        """Do what is due: stand for election, commit, apply, send, and begin a snapshot."""
        self.doTick(0.0)

    def set_term(self, term: int, voted_for: str | None) -> None:
        """Enter a term with a vote, or without one."""
        self._SyncObj__setCurrentTerm(term, voted_for)

    def become_follower(self, term: int) -> None:
        """Follow nobody yet, in `term` if that is newer."""
        if term > self.term:
            self.set_term(term, None)
        self.set_role(FOLLOWER)
        self.leader = None

    def become_leader(self) -> None:
        """Lead, and begin with an empty entry of this term."""
        self._SyncObj__onBecomeLeader()

    def put_off_election(self) -> None:
        """Wait for a new election timeout, drawn at random."""
        self.election_deadline = self.clock() + self._SyncObj__generateRaftTimeout()

    def raise_commit_index(self, log_index: int) -> None:
        """Take everything up to a position for committed."""
        if log_index > self.commit_index:
            self.commit_index = log_index
            self.log.commit_index = log_index

    def propose(self, command: bytes, done: ProposalDone) -> None:
        """Put a command into the log, or send it to the leader. `done` is called with the result, or with its fate."""
        self._applyCommand(command, lambda result, reason: done(_outcome(result, reason)), COMMAND)

    def give_up_forwarded(self) -> None:
        """The leader that this node sent commands to is another one now: their callers learn that nothing is known."""
        self._SyncObj__onLeaderChanged()

    def callers_waiting_count(self) -> int:
        """Of how many positions callers wait to hear that they are committed."""
        return len(self._SyncObj__commandsWaitingCommit)

    def disown_forwarded(self, request_id: int) -> None:
        """The caller of a forwarded command learns that nothing is known."""
        callback = self._SyncObj__commandsWaitingReply.pop(request_id, None)
        if callback is not None:
            callback(None, _REASON_UNKNOWN)

    def give_up_waiting(self, log_index: int) -> None:
        """A snapshot has jumped over the commands up to a position: their callers learn that nothing is known."""
        waiting = self._SyncObj__commandsWaitingCommit
        for index in [index for index in waiting if index <= log_index]:
            for _, callback in waiting.pop(index):
                callback(None, _REASON_UNKNOWN)

    def put_off_heartbeat(self) -> None:
        """The next heartbeat is due a period from now."""
        self._SyncObj__newAppendEntriesTime = self.clock() + self.conf.appendEntriesPeriod

    def request_snapshot(self) -> None:
        """Take a snapshot with one of the next ticks, however short the log is."""
        self.forceLogCompaction()

    def skip_own_restore(self) -> None:
        """The snapshot is loaded already: the library would do it in its first tick, swallow every failure, and start
        empty."""
        self._SyncObj__needLoadDumpFile = False

    def number_forwarded_after(self, request_id: int) -> None:
        """Commands that this node forwards count from here on."""
        self._SyncObj__commandsLocalCounter = request_id

    # -- what the library calls, and rules replace -----------------------------------------------------------------

    def receive(self, node: MemberNode, message: Message) -> None:
        """Handle a member's message."""
        super()._SyncObj__onMessageReceived(node, to_library(message))  # type: ignore[misc]

    def set_role(self, role: int) -> None:
        """Become FOLLOWER, CANDIDATE or LEADER."""
        super()._SyncObj__setState(role)  # type: ignore[misc]

    def send_append_entries(self) -> None:
        """Send every member what it lacks, or a heartbeat."""
        super()._SyncObj__sendAppendEntries()  # type: ignore[misc]

    def take_snapshot_if_due(self) -> None:
        """Begin a snapshot when the log has grown long, and go on with one that was begun."""
        super()._SyncObj__tryLogCompaction()  # type: ignore[misc]

    def on_connected(self, node: MemberNode) -> None:
        """Messages to a member leave from now on."""
        self._SyncObj__onNodeConnected(node)

    def on_disconnected(self, node: MemberNode) -> None:
        """Messages to a member are lost from now on."""
        self._SyncObj__onNodeDisconnected(node)

    def on_stream_opened(self, node: MemberNode) -> None:
        """A member has opened a new stream; the library does not care."""

    def on_members_told(self, teller_id: str, members: tuple[Member, ...]) -> None:
        """A member has said who the members are; the library does not care."""

    def on_disputed(self, member_id: str, why: str) -> None:
        """A member refuses this one's store, or takes it again; the library does not care."""

    def on_introduced(self, member: Member) -> None:
        """A stranger has said that it is a member; the library does not care."""

    def apply(self, log_index: int, command: bytes) -> bytes:
        """Apply a committed command."""
        return self.state_machine.apply(log_index, command)

    def _applyCommand(self, command: bytes, callback: Any, commandType: int | None = None) -> None:
        # Of this member's callers, or forwarded to it; only the latter has the byte for its kind.
        if self.state_machine.takes(command if commandType is not None else command[1:]):
            super()._applyCommand(command, callback, commandType)  # type: ignore[misc]
        else:
            self._SyncObj__callErrCallback(_REASON_DENIED, callback)

    def _SyncObj__setState(self, role: int) -> None:
        self.set_role(role)

    def _SyncObj__sendAppendEntries(self) -> None:
        self.send_append_entries()

    def _SyncObj__tryLogCompaction(self) -> None:
        self.take_snapshot_if_due()

    def _SyncObj__doApplyCommand(self, command: bytes) -> bytes | None:
        # The library unpickles here and picks a method by number.
        return self.apply(self.last_applied + 1, command[1:]) if command[0] == COMMAND else None


def _outcome(result: bytes | None, reason: int) -> bytes | Fate:
    if reason == _SUCCESS:
        assert result is not None
        return result
    if reason in _REASONS_NOT_TAKEN:
        return Fate.NOT_TAKEN
    if reason in _REASONS_UNKNOWN:
        return Fate.UNKNOWN
    raise AssertionError(f"the library answered a command with reason {reason}")
