"""The leader's rules: believe only acknowledgements of the present term, and send what is lacking in bounds."""

from __future__ import annotations

from typing import Any

from stampede_rt_supernode.replication.library.pinned_copy import LEADER
from stampede_rt_supernode.replication.rules.membership import Membership
from stampede_rt_supernode.replication.rules.raft_node import InvariantViolation
from stampede_rt_supernode.replication.storage.store import Entry
from stampede_rt_supernode.replication.wire.codec import Message

# How many batches of entries one member is sent at a time.
BATCHES_PER_ROUND = 4


class Leading(Membership):
    """Handles what followers answer, and sends to them. Tick thread only."""

    def _on_append_reply(self, node: Any, message: Message) -> None:
        """Take an acknowledgement of this very term. The library's carry no term."""
        if message["term"] > self._SyncObj__raftCurrentTerm:
            self._step_down(message["term"])
        if message["term"] != self._SyncObj__raftCurrentTerm or self._SyncObj__raftState != LEADER:
            return
        if node not in self._SyncObj__raftMatchIndex:
            return  # removed meanwhile
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
        for node in self.sent_to():
            if node not in self._SyncObj__connectedNodes:
                self.keeper.cancelTransmisstion(node)
            elif self._SyncObj__raftNextIndex[node] > self._SyncObj__raftLog.first_sendable or self._send_snapshot(
                node
            ):
                self._send_entries(node)

    def _send_snapshot(self, node: Any) -> bool:
        """Send the next pieces; True when the last one is among them."""
        header = {
            "type": "append_entries",
            "term": self._SyncObj__raftCurrentTerm,
            "commit_index": self._SyncObj__raftCommitIndex,
            "digest": self.state_machine.digest(),
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
            previous = self._SyncObj__raftLog.sendable_at(next_index - 1)
            if previous is None:
                raise InvariantViolation(f"{node.id} is to be sent entry {next_index}, but the log ends at {end}")
            entries = self._entries_from(next_index) if self.has_room(node.id) else []
            self.mailroom.send(
                node,
                {
                    "type": "append_entries",
                    "term": self._SyncObj__raftCurrentTerm,
                    "commit_index": self._SyncObj__raftCommitIndex,
                    "digest": self.state_machine.digest(),
                    "entries": entries,
                    "prevLogIdx": next_index - 1,
                    "prevLogTerm": previous.term,
                },
            )
            self._SyncObj__raftNextIndex[node] = next_index + len(entries)
            if not entries or self._SyncObj__raftNextIndex[node] > end:
                return

    def _entries_from(self, log_index: int) -> list[Entry]:
        return self._SyncObj__raftLog.sendable_from(log_index, self.conf.appendEntriesBatchSizeBytes)
