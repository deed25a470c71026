"""The library's node with its Raft rules corrected, and commands as plain bytes.

`BytesNode` fits the library to our state machine and changes no rule. `RaftRules` replaces the handlers of
messages between members by ones that keep to the Raft paper (Ongaro and Ousterhout 2014, figures 2 and 13);
each says which fault of PySyncObj 0.3.17 it closes. The names of library internals that are used are declared
at the top of each class, and library.py pins the file they are in.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from stampede_rt_supernode.replication.codec import Message
from stampede_rt_supernode.replication.interface import StateMachine
from stampede_rt_supernode.replication.journal import Journal
from stampede_rt_supernode.replication.library import CANDIDATE, COMMAND, FOLLOWER, LEADER
from stampede_rt_supernode.replication.mailroom import Mailroom
from stampede_rt_supernode.replication.snapshots import SnapshotKeeper

# How many batches of entries one member is sent at a time.
BATCHES_PER_ROUND = 4


class InvariantViolation(RuntimeError):
    """The log broke a promise of Raft. The replica stops before it can do more harm."""


class BytesNode:
    """What every variant of the node needs: commands are bytes, applied with their position."""

    _SyncObj__raftLastApplied: int
    _SyncObj__raftLog: Journal
    _SyncObj__raftLeader: Any
    state_machine: StateMachine

    def on_stream_opened(self, node: Any) -> None:
        """A member has opened a new stream; the library itself would not care."""

    def _SyncObj__doApplyCommand(self, command: bytes) -> bytes | None:  # noqa: N802
        # The library unpickles here and picks a method by number.
        if command[0] != COMMAND:
            return None
        return self.state_machine.apply(self._SyncObj__raftLastApplied + 1, command[1:])


class RaftRules(BytesNode):
    """Message handlers that keep to the paper. Tick thread only."""

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
    _SyncObj__getEntries: Any
    _SyncObj__connectedNodes: set[Any]

    conf: Any
    mailroom: Mailroom
    has_room: Callable[[str], bool]
    keeper: SnapshotKeeper
    clock: Any
    reads: Any
    unknown_outcome: int

    # Who voted for this node, and in which term: a repeated vote counts once.
    _votes: tuple[int, set[str]] = (0, set())
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

    def _SyncObj__onMessageReceived(self, node: Any, message: Message) -> None:  # noqa: N802
        if node not in self._SyncObj__otherNodes:
            return
        match message["type"]:
            case "append_entries":
                self._on_append(node, message)
            case "next_node_idx":
                self._on_append_reply(node, message)
            case "request_vote":
                self._on_vote_request(node, message)
            case "response_vote":
                self._on_vote(node, message)
            case "apply_command" | "apply_command_response":
                super()._SyncObj__onMessageReceived(node, message)  # type: ignore[misc]
            case "read_index" | "read_index_response":
                self.reads.on_message(node, message)
            case kind:
                raise InvariantViolation(f"a message of kind {kind!r} came through")

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

    # -- terms and votes ------------------------------------------------------------------------------------

    def _step_down(self, term: int) -> None:
        if term > self._SyncObj__raftCurrentTerm:
            self._SyncObj__setCurrentTerm(term, None)
        self._SyncObj__setState(FOLLOWER)
        self._SyncObj__raftLeader = None

    def _log_end(self) -> tuple[int, int]:
        """(term, index) of the last entry: the order in which logs are more or less complete."""
        last = self._SyncObj__raftLog[-1]
        return last[2], last[1]

    def _on_vote_request(self, node: Any, message: Message) -> None:
        if message["term"] > self._SyncObj__raftCurrentTerm:
            self._step_down(message["term"])
        if message["term"] < self._SyncObj__raftCurrentTerm or self._SyncObj__raftState == LEADER:
            return
        if (message["last_log_term"], message["last_log_index"]) < self._log_end():
            return
        if self._SyncObj__votedForNodeId not in (None, node.id):
            return
        self._SyncObj__setCurrentTerm(self._SyncObj__raftCurrentTerm, node.id)
        self._put_off_election()
        self.mailroom.send(node, {"type": "response_vote", "term": message["term"]})

    def _on_vote(self, node: Any, message: Message) -> None:
        """Count a vote once per node and term. The library counts messages."""
        if message["term"] != self._SyncObj__raftCurrentTerm or self._SyncObj__raftState != CANDIDATE:
            return
        if self._votes[0] != message["term"]:
            self._votes = (message["term"], set())
        self._votes[1].add(node.id)
        self._SyncObj__votesCount = 1 + len(self._votes[1])
        if self.is_majority(self._SyncObj__votesCount):
            self._SyncObj__onBecomeLeader()

    def is_majority(self, count: int) -> bool:
        """Whether so many members, this one included, are more than half of all."""
        return 2 * count > len(self._SyncObj__otherNodes) + 1

    def _put_off_election(self) -> None:
        self._SyncObj__raftElectionDeadline = self.clock() + self._SyncObj__generateRaftTimeout()

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

    # -- the follower's side ----------------------------------------------------------------------------------

    def _on_append(self, node: Any, message: Message) -> None:
        if message["term"] < self._SyncObj__raftCurrentTerm:
            # Tells a leader of an older term that it is one; the library is silent.
            self._reply(node, message, next_index=self._SyncObj__raftLog[-1][1] + 1)
            return
        self._follow(node, message["term"])
        self._SyncObj__leaderCommitIndex = message["commit_index"]
        if "serialized" in message:
            self._on_snapshot_piece(node, message)
        else:
            self._on_entries(node, message)

    def _follow(self, node: Any, term: int) -> None:
        if term == self._SyncObj__raftCurrentTerm and self._SyncObj__raftState == LEADER:
            raise InvariantViolation(f"{node.id} leads in term {term}, and so does this node")
        if self._SyncObj__raftLeader != node:
            self._SyncObj__onLeaderChanged()
            self.reads.on_leader_lost()
            self._SyncObj__raftLeader = node
        if term > self._SyncObj__raftCurrentTerm:
            self._SyncObj__setCurrentTerm(term, None)
        self._SyncObj__setState(FOLLOWER)
        self.last_leader_contact = self.clock()
        self._put_off_election()

    def _on_entries(self, node: Any, message: Message) -> None:
        journal = self._SyncObj__raftLog
        first = journal[0]
        previous, previous_term, entries = message["prevLogIdx"], message["prevLogTerm"], message["entries"]
        if previous < first[1]:
            # All up to our first entry is committed, so it agrees; only what follows needs a look.
            entries = [entry for entry in entries if entry[1] > first[1]]
            previous, previous_term = first[1], first[2]
        held = journal.entry_at(previous)
        if held is None:
            self._reply(node, message, next_index=journal[-1][1] + 1, reset=True)
        elif held.term != previous_term:
            # What is committed agrees with every leader; all behind it may not.
            self._reply(node, message, next_index=self._SyncObj__raftCommitIndex + 1, reset=True)
        else:
            self._merge(entries)
            matched = previous + len(entries)
            self._raise_commit_index(min(message["commit_index"], matched))
            self._reply(node, message, next_index=matched + 1, success=True)

    def _merge(self, entries: list[Any]) -> None:
        """Add what is not held yet; cut off a tail only at a real conflict.

        The library cuts off everything past the previous entry, and with it entries already acknowledged when
        messages come late or twice.
        """
        journal = self._SyncObj__raftLog
        for entry in entries:
            held = journal.entry_at(entry[1])
            if held is not None and held.term == entry[2]:
                continue
            if held is not None:
                self._cut_off(entry[1])
            journal.add(*entry)

    def _cut_off(self, log_index: int) -> None:
        settled = max(self._SyncObj__raftCommitIndex, self._SyncObj__raftLastApplied)
        if log_index <= settled:
            raise InvariantViolation(f"a leader wants entry {log_index} replaced, but {settled} is already committed")
        journal = self._SyncObj__raftLog
        journal.deleteEntriesFrom(log_index - journal[0][1])

    def _on_snapshot_piece(self, node: Any, message: Message) -> None:
        """Take in a piece. The message's commit index says nothing about this log, and is not used.

        The library takes it over, and so commits whatever the log happens to hold. It also acknowledges a
        snapshot that it failed to load; here the failure rises and ends the process.
        """
        if not self.keeper.setTransmissionData(message["serialized"]):
            self._reply(node, message, next_index=self._SyncObj__raftLog[-1][1] + 1)
            return
        applied = self._SyncObj__raftLastApplied
        last = self.keeper.install_received(newer_than=applied)
        if last.log_index > applied:
            self._SyncObj__raftLastApplied = last.log_index
            self._raise_commit_index(last.log_index)
            self._give_up_waiting(last.log_index)
        self._reply(node, message, next_index=last.log_index + 1, success=True)

    def _give_up_waiting(self, log_index: int) -> None:
        """Callers whose commands a snapshot jumped over will not learn what became of them."""
        for index in [index for index in self._SyncObj__commandsWaitingCommit if index <= log_index]:
            for _, callback in self._SyncObj__commandsWaitingCommit.pop(index):
                callback(None, self.unknown_outcome)

    def _raise_commit_index(self, log_index: int) -> None:
        if log_index > self._SyncObj__raftCommitIndex:
            self._SyncObj__raftCommitIndex = log_index
            self._SyncObj__raftLog.setRaftCommitIndex(log_index)

    def _reply(
        self, node: Any, message: Message, *, next_index: int, reset: bool = False, success: bool = False
    ) -> None:
        self.mailroom.send(
            node,
            {
                "type": "next_node_idx",
                "term": self._SyncObj__raftCurrentTerm,
                "round": message["round"],
                "next_node_idx": next_index,
                "reset": reset,
                "success": success,
            },
        )

    # -- the leader's side -------------------------------------------------------------------------------------

    def _on_append_reply(self, node: Any, message: Message) -> None:
        """Take an acknowledgement of this very term. The library's carry no term."""
        if message["term"] > self._SyncObj__raftCurrentTerm:
            self._step_down(message["term"])
        if message["term"] != self._SyncObj__raftCurrentTerm or self._SyncObj__raftState != LEADER:
            return
        end = self._SyncObj__raftLog[-1][1]
        next_index = min(message["next_node_idx"], end + 1)
        if message["success"]:
            if message["next_node_idx"] > end + 1:
                raise InvariantViolation(f"{node.id} acknowledged up to {message['next_node_idx'] - 1}, past {end}")
            match = max(self._SyncObj__raftMatchIndex[node], next_index - 1)
            self._SyncObj__raftMatchIndex[node] = match
            # Never back: what is on its way need not be sent again.
            self._SyncObj__raftNextIndex[node] = max(self._SyncObj__raftNextIndex[node], match + 1)
        elif message["reset"]:
            self._SyncObj__raftNextIndex[node] = max(next_index, self._SyncObj__raftMatchIndex[node] + 1, 2)
        self._SyncObj__lastResponseTime[node] = self.clock()
        self.reads.on_echo(node.id, message["round"])

    def _SyncObj__sendAppendEntries(self) -> None:  # noqa: N802
        """Send every connected member what it lacks, or a heartbeat.

        The library sends a whole log or snapshot in one go, and spins for a heartbeat's time while a snapshot
        has nothing to send; here both have a bound, and the next heartbeat goes on.
        """
        self._SyncObj__newAppendEntriesTime = self.clock() + self.conf.appendEntriesPeriod
        for node in self._SyncObj__otherNodes:
            if node not in self._SyncObj__connectedNodes:
                self.keeper.cancelTransmisstion(node)
            elif self._SyncObj__raftNextIndex[node] > self._SyncObj__raftLog[0][1] or self._send_snapshot(node):
                self._send_entries(node)

    def _send_snapshot(self, node: Any) -> bool:
        """Send the next pieces; True when the last one is among them."""
        header = {
            "type": "append_entries",
            "term": self._SyncObj__raftCurrentTerm,
            "commit_index": self._SyncObj__raftCommitIndex,
        }
        while (piece := self.keeper.getTransmissionData(node)) is not None:
            self.mailroom.send(node, {**header, "serialized": piece})
            if piece.is_last:
                self._SyncObj__raftNextIndex[node] = piece.chunk.last_log_index + 1
                return True
        self.mailroom.send(node, {**header, "serialized": None})
        return False

    def _send_entries(self, node: Any) -> None:
        end = self._SyncObj__raftLog[-1][1]
        for _ in range(BATCHES_PER_ROUND):
            next_index = self._SyncObj__raftNextIndex[node]
            previous = self._SyncObj__raftLog.entry_at(next_index - 1)
            if previous is None:
                raise InvariantViolation(f"{node.id} is to be sent entry {next_index}, but the log ends at {end}")
            entries = self._entries_from(next_index) if self.has_room(node.id) else []
            self.mailroom.send(
                node,
                {
                    "type": "append_entries",
                    "term": self._SyncObj__raftCurrentTerm,
                    "commit_index": self._SyncObj__raftCommitIndex,
                    "entries": entries,
                    "prevLogIdx": next_index - 1,
                    "prevLogTerm": previous.term,
                },
            )
            self._SyncObj__raftNextIndex[node] = next_index + len(entries)
            if not entries or self._SyncObj__raftNextIndex[node] > end:
                return

    def _entries_from(self, log_index: int) -> list[Any]:
        if log_index > self._SyncObj__raftLog[-1][1]:
            return []
        entries: list[Any] = self._SyncObj__getEntries(log_index, None, self.conf.appendEntriesBatchSizeBytes)
        return entries
