"""The follower's rules: take in entries and snapshots, and say truly what is held."""

from __future__ import annotations

from typing import Any

from stampede_rt_supernode.replication.library.pinned_copy import FOLLOWER, LEADER
from stampede_rt_supernode.replication.rules.membership import Membership
from stampede_rt_supernode.replication.rules.raft_node import InvariantViolation
from stampede_rt_supernode.replication.wire.codec import Message


class Following(Membership):
    """Handles what leaders send. Tick thread only."""

    def _on_append(self, node: Any, message: Message) -> None:
        if message["term"] < self._SyncObj__raftCurrentTerm:
            # Tells a leader of an older term that it is one; the library is silent.
            self._reply(node, message, next_index=self._SyncObj__raftLog[-1][1] + 1)
            return
        self._follow(node, message["term"])
        self._SyncObj__leaderCommitIndex = message["commit_index"]
        if "digest" in message:
            self.digests.told(*message["digest"])
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
        if (held is None or held.term != previous_term) and self.keeper.is_opening:
            # What is lacking is here already, and there in a moment: nothing need be sent again.
            self._reply(node, message, next_index=journal[-1][1] + 1)
        elif held is None:
            self._reply(node, message, next_index=journal[-1][1] + 1, reset=True)
        elif held.term != previous_term:
            # What is committed agrees with every leader; all behind it may not.
            self._reply(node, message, next_index=self._SyncObj__raftCommitIndex + 1, reset=True)
        else:
            self._merge(entries)
            self.follow_log()
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
        # Of two at a time the second is not kept: if it is still needed then, the leader sends it again.
        if not self.keeper.is_opening and self.keeper.setTransmissionData(message["serialized"]):
            self.keeper.open_received()
        self._reply(node, message, next_index=self._SyncObj__raftLog[-1][1] + 1)

    def install_opened(self) -> None:
        """Go on opening a received snapshot, if there is one. The leader hears of it with its next message."""
        last = self.keeper.install_opened(newer_than=self._SyncObj__raftLastApplied)
        if last is not None:
            self.follow_log()
            self._SyncObj__raftLastApplied = last.log_index
            self._raise_commit_index(last.log_index)
            self.digests.note(*self.state_machine.digest())
            self._give_up_waiting(last.log_index)

    def _give_up_waiting(self, log_index: int) -> None:
        """Callers whose commands a snapshot jumped over will not learn what became of them."""
        for index in [index for index in self._SyncObj__commandsWaitingCommit if index <= log_index]:
            for _, callback in self._SyncObj__commandsWaitingCommit.pop(index):
                callback(None, self.unknown_outcome)

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
