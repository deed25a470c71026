"""The leader's rules. A leader counts acknowledgements of its own term only, and sends missing entries in batches."""

from __future__ import annotations

from stampede_rt_supernode.replication.log_entries import Entry
from stampede_rt_supernode.replication.rules.membership import Membership
from stampede_rt_supernode.replication.rules.raft_node import InvariantViolation, PeerAtFault
from stampede_rt_supernode.replication.wire.buffered_transport import MemberNode
from stampede_rt_supernode.replication.wire.messages import (
    AppendEntries,
    AppendReply,
    InstallSnapshot,
    SnapshotChunk,
    TimeoutNow,
)

# The most batches of entries that one call of `send_append_entries` sends to one member.
BATCHES_PER_ROUND = 4
# The entry that reaches this size ends a batch.
APPEND_BATCH_BYTES = 1 << 20


class LeaderRole(Membership):
    """Handles the answers of followers, and sends to them. Tick thread only."""

    def _on_append_reply(self, node: MemberNode, message: AppendReply) -> None:
        """Process an acknowledgement, if it is of the present term.

        The acknowledgements of PySyncObj have no term, so PySyncObj also counts outdated ones.
        """
        if message.term > self.term:
            self.become_follower(message.term)
        if message.term != self.term or not self.is_leader:
            return
        if node not in self.match_index:
            return  # the member was removed meanwhile
        end = self.log.last_index
        next_index = min(message.next_index, end + 1)
        if message.success:
            if message.next_index > end + 1:
                raise PeerAtFault(node.id, f"acknowledged up to {message.next_index - 1}, past {end}")
            match = max(self.match_index[node], next_index - 1)
            self.match_index[node] = match
            # An acknowledgement never lowers `next_index`, so that entries under way are not sent again.
            self.next_index[node] = max(self.next_index[node], match + 1)
        elif message.reset:
            self.next_index[node] = max(next_index, self.match_index[node] + 1, 2)
        self.note_answer(node)
        self.reads.on_echo(node.id, message.round)
        self.poll.note_answer(node.id, message.digest, self.voter_ids())

    def send_append_entries(self) -> None:
        """Send every connected member the entries that it lacks, or a heartbeat.

        In one step PySyncObj sends as much of a log or snapshot as it can in one heartbeat interval. While a snapshot
        has no piece to send, PySyncObj loops until the interval is over. This rule sends a limited number of entries
        and pieces, and the next heartbeat continues.
        """
        self.postpone_heartbeat()
        connected = [node.id for node in self.other_voters if node in self.connected]
        self.poll.ask(self.clock(), self.state_machine.digest(), connected)
        for node in self.sent_to():
            if node not in self.connected:
                self.keeper.cancel_sending(node.id)
            elif self.next_index[node] > self.log.first_sendable or self._send_snapshot(node):
                self._send_entries(node)

    def step_down_if_diverged(self) -> None:
        """Stop leading if more than half of the members have the same state, and this leader has another.

        Then the member of this majority that has acknowledged the most entries is asked to lead.
        """
        if not self.is_leader:
            return
        majority_digest = self.poll.majority_digest(self.voter_ids())
        self.digests.compare_with_majority(*majority_digest)
        if not self.digests.diverged_at:
            return
        right = [node for node in self.other_voters if node.id in self.poll.ids_with_digest(majority_digest[1])]
        successor = max(right, key=lambda node: self.match_index[node], default=None)
        if successor is not None:
            self.transport.send(successor, TimeoutNow(term=self.term))
        self.become_follower(self.term)
        self.postpone_election()

    def _send_snapshot(self, node: MemberNode) -> bool:
        """Send the next pieces of a snapshot. Returns True if the last piece is among them.

        If not, sends a heartbeat without a piece as well.
        """
        while (chunk := self.keeper.next_chunk(node.id)) is not None:
            self._send_chunk(node, chunk)
            if chunk.is_last:
                self.next_index[node] = chunk.last_log_index + 1
                return True
        self._send_chunk(node, None)
        return False

    def _send_chunk(self, node: MemberNode, chunk: SnapshotChunk | None) -> None:
        message = InstallSnapshot(
            term=self.term,
            commit_index=self.commit_index,
            chunk=chunk,
            round=self.reads.round,
            digest=self.poll.named_state,
            majority_digest=self.poll.majority_digest(self.voter_ids()),
        )
        self.transport.send(node, message)

    def _send_entries(self, node: MemberNode) -> None:
        end = self.log.last_index
        for _ in range(BATCHES_PER_ROUND):
            next_index = self.next_index[node]
            previous = self.log.sendable_at(next_index - 1)
            if previous is None:
                raise InvariantViolation(f"{node.id} is to be sent entry {next_index}, but the log ends at {end}")
            entries = self._entries_from(next_index) if self.has_room(node.id) else []
            self.transport.send(
                node,
                AppendEntries(
                    term=self.term,
                    commit_index=self.commit_index,
                    previous_index=next_index - 1,
                    previous_term=previous.term,
                    entries=entries,
                    round=self.reads.round,
                    digest=self.poll.named_state,
                    majority_digest=self.poll.majority_digest(self.voter_ids()),
                ),
            )
            self.next_index[node] = next_index + len(entries)
            if not entries or self.next_index[node] > end:
                return

    def _entries_from(self, log_index: int) -> list[Entry]:
        return self.log.sendable_from(log_index, APPEND_BATCH_BYTES)
