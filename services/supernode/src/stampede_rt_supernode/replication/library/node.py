"""The Raft node of PySyncObj with the names of the Raft paper (Ongaro and Ousterhout 2014, figure 2).

Only this module knows the private names of the library. Other modules use plain names: for example, `term` for the
attribute `_SyncObj__raftCurrentTerm`, and `set_role` for the method `_SyncObj__setState`. Without rules above it, the
node behaves like the unchanged library. pinned_copy.py proves that the installed library has these names.
"""

# The library's own names are in camelCase.
# ruff: noqa: N802, N803, N815

from __future__ import annotations

import enum
from collections.abc import Callable
from typing import Any, Generic, Protocol, TypeVar

from stampede_rt_supernode.replication.interface import Member, StateMachine
from stampede_rt_supernode.replication.library.adapters import LibraryLog
from stampede_rt_supernode.replication.library.translation import to_library
from stampede_rt_supernode.replication.log_entries import COMMAND
from stampede_rt_supernode.replication.storage.raft_log import RaftLog
from stampede_rt_supernode.replication.wire.buffered_transport import MemberNode
from stampede_rt_supernode.replication.wire.messages import Message

T = TypeVar("T")

FOLLOWER, CANDIDATE, LEADER = 0, 1, 2


class RandomSource(Protocol):
    """The source of randomness for election timeouts."""

    def random(self) -> float:
        """A number in [0, 1)."""


class ProposalFailure(enum.Enum):
    """Why a command has no result."""

    # The command is certainly not in the log, or another leader removed it before any member applied it.
    NOT_TAKEN = enum.auto()
    # The command may be in the log.
    UNKNOWN = enum.auto()


# Gets the result of a command, or why there is none.
ProposalDone = Callable[[bytes | ProposalFailure], None]

# The library's FAIL_REASON numbers. The library did not take a command in five cases: its queue was full, no leader was
# known, another entry replaced the command's entry, the member that got the command did not lead, or the state does not
# accept the command yet. The outcome is unknown after a change of the leader, or if the library says so.
_SUCCESS = 0
_REASON_DENIED = 6
_REASONS_NOT_TAKEN = frozenset((1, 2, 3, 4, _REASON_DENIED))
_REASON_UNKNOWN = 7
_REASONS_UNKNOWN = frozenset((5, _REASON_UNKNOWN))


class _PrivateAttribute(Generic[T]):
    """A private attribute of the library under another name."""

    def __init__(self, name: str) -> None:
        self._name = f"_SyncObj__{name}"

    def __get__(self, node: Any, owner: type) -> T:
        value: T = getattr(node, self._name)
        return value

    def __set__(self, node: Any, value: T) -> None:
        setattr(node, self._name, value)


class LibraryNode:
    """The library's node. This class comes before the library's class in the method resolution order. Tick thread only.

    rules/node_builder.py attaches the objects that the methods need, and then calls the library's constructor. A member
    is a node of the library with an `id`. Sets and dictionaries of members leave this node out.
    """

    term = _PrivateAttribute[int]("raftCurrentTerm")
    voted_for = _PrivateAttribute[str | None]("votedForNodeId")
    votes_count = _PrivateAttribute[int]("votesCount")
    # FOLLOWER, CANDIDATE or LEADER.
    role = _PrivateAttribute[int]("raftState")
    # The leader that this node follows, itself, or None.
    leader = _PrivateAttribute[MemberNode | None]("raftLeader")
    # All members that vote, without this node.
    other_voters = _PrivateAttribute[set[MemberNode]]("otherNodes")
    # The members to which messages can be sent at present.
    connected = _PrivateAttribute[set[MemberNode]]("connectedNodes")
    # When this node stands for election, by the clock given to `load_library`.
    election_deadline = _PrivateAttribute[float]("raftElectionDeadline")
    commit_index = _PrivateAttribute[int]("raftCommitIndex")
    # The commit index in the leader's last message.
    leader_commit_index = _PrivateAttribute[int]("leaderCommitIndex")
    last_applied = _PrivateAttribute[int]("raftLastApplied")
    # A leader's knowledge of each member: the next entry to send to it, the last entry that it has acknowledged, and
    # when it last answered.
    next_index = _PrivateAttribute[dict[MemberNode, int]]("raftNextIndex")
    match_index = _PrivateAttribute[dict[MemberNode, int]]("raftMatchIndex")
    last_response_time = _PrivateAttribute[dict[MemberNode, float]]("lastResponseTime")
    # The position of the first entry that this node has written as the leader of its term.
    first_index_of_term = _PrivateAttribute[int | None]("noopIDx")

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
        """The entries, term and vote, including those still on their way to the disk."""
        return self._SyncObj__raftLog.log

    @property
    def is_leader(self) -> bool:
        """Whether this node leads, as far as it knows."""
        return self.role == LEADER

    # -- operations that the rules ask of the library --------------------------------------------------------------

    def tick(self) -> None:
        """Do everything that is due: stand for election, commit, apply, send, and begin a snapshot."""
        self.doTick(0.0)

    def set_term(self, term: int, voted_for: str | None) -> None:
        """Enter a term. `voted_for`: the id of the member that gets this node's vote; None if no member has it yet."""
        self._SyncObj__setCurrentTerm(term, voted_for)

    def become_follower(self, term: int) -> None:
        """Become a follower without a known leader, in `term` if that is newer."""
        if term > self.term:
            self.set_term(term, None)
        self.set_role(FOLLOWER)
        self.leader = None

    def become_leader(self) -> None:
        """Become the leader, and append an empty entry of this term."""
        self._SyncObj__onBecomeLeader()

    def postpone_election(self) -> None:
        """Set the election deadline to a new, random timeout from now."""
        self.election_deadline = self.clock() + self._SyncObj__generateRaftTimeout()

    def raise_commit_index(self, log_index: int) -> None:
        """Treat all entries up to a position as committed."""
        if log_index > self.commit_index:
            self.commit_index = log_index
            self.log.commit_index = log_index

    def propose(self, command: bytes, done: ProposalDone) -> None:
        """Put a command into the log, or send it to the leader. Calls `done` with the result or the failure."""
        self._applyCommand(command, lambda result, reason: done(_outcome(result, reason)), COMMAND)

    def give_up_forwarded(self) -> None:
        """Report an unknown outcome for all commands that this node has forwarded: their answers may be lost."""
        self._SyncObj__onLeaderChanged()

    def callers_waiting_count(self) -> int:
        """The number of log positions for whose commit a caller waits."""
        return len(self._SyncObj__commandsWaitingCommit)

    def disown_forwarded(self, request_id: int) -> None:
        """Report an unknown outcome to the caller of a forwarded command."""
        callback = self._SyncObj__commandsWaitingReply.pop(request_id, None)
        if callback is not None:
            callback(None, _REASON_UNKNOWN)

    def give_up_waiting(self, log_index: int) -> None:
        """Report an unknown outcome for commands up to a position, because a snapshot has replaced them."""
        waiting = self._SyncObj__commandsWaitingCommit
        for index in [index for index in waiting if index <= log_index]:
            for _, callback in waiting.pop(index):
                callback(None, _REASON_UNKNOWN)

    def postpone_heartbeat(self) -> None:
        """Set the next heartbeat to one period from now."""
        self._SyncObj__newAppendEntriesTime = self.clock() + self.conf.appendEntriesPeriod

    def request_snapshot(self) -> None:
        """Take a snapshot in one of the next ticks, however short the log is."""
        self.forceLogCompaction()

    def skip_own_restore(self) -> None:
        """Keep the library from loading the snapshot, which is loaded already.

        The library would load it in its first tick, hide every failure, and start empty.
        """
        self._SyncObj__needLoadDumpFile = False

    def number_forwarded_after(self, request_id: int) -> None:
        """Give numbers above `request_id` to the commands that this node forwards from now on."""
        self._SyncObj__commandsLocalCounter = request_id

    # -- operations that the library calls, and rules replace ------------------------------------------------------

    def receive(self, node: MemberNode, message: Message) -> None:
        """Handle a member's message."""
        super()._SyncObj__onMessageReceived(node, to_library(message))  # type: ignore[misc]

    def set_role(self, role: int) -> None:
        """Become FOLLOWER, CANDIDATE or LEADER."""
        super()._SyncObj__setState(role)  # type: ignore[misc]

    def send_append_entries(self) -> None:
        """Send every member the entries that it lacks, or a heartbeat."""
        super()._SyncObj__sendAppendEntries()  # type: ignore[misc]

    def take_snapshot_if_due(self) -> None:
        """Continue a snapshot under way. If there is none, begin one when the log is long, or the last one is old."""
        super()._SyncObj__tryLogCompaction()  # type: ignore[misc]

    def on_connected(self, node: MemberNode) -> None:
        """Note that messages to a member can be sent from now on."""
        self._SyncObj__onNodeConnected(node)

    def on_disconnected(self, node: MemberNode) -> None:
        """Note that messages to a member are lost from now on."""
        self._SyncObj__onNodeDisconnected(node)

    def on_stream_opened(self, node: MemberNode) -> None:
        """A member has opened a new stream. The library needs no action."""

    def on_members_reported(self, reporter_id: str, members: tuple[Member, ...]) -> None:
        """A member has sent its view of the members. The library needs no action."""

    def on_disputed(self, member_id: str, why: str) -> None:
        """A member refuses this node's store, or accepts it again. The library needs no action."""

    def on_introduced(self, member: Member) -> None:
        """An unknown node has said that it is a member. The library needs no action."""

    def apply(self, log_index: int, command: bytes) -> bytes:
        """Apply a committed command."""
        return self.state_machine.apply(log_index, command)

    def _applyCommand(self, command: bytes, callback: Any, commandType: int | None = None) -> None:
        # The library calls this for a command of this member and for a command that another member has forwarded. Only
        # the forwarded command begins with the byte of its kind.
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
        # The library's own method unpickles the command, and picks a method by a number in it. This method does
        # neither.
        return self.apply(self.last_applied + 1, command[1:]) if command[0] == COMMAND else None


def _outcome(result: bytes | None, reason: int) -> bytes | ProposalFailure:
    if reason == _SUCCESS:
        assert result is not None
        return result
    if reason in _REASONS_NOT_TAKEN:
        return ProposalFailure.NOT_TAKEN
    if reason in _REASONS_UNKNOWN:
        return ProposalFailure.UNKNOWN
    raise AssertionError(f"the library answered a command with reason {reason}")
