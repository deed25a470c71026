"""The follower's rules. A follower accepts entries and snapshots, and reports truthfully which entries it holds."""

from __future__ import annotations

from collections.abc import Sequence

from stampede_rt_supernode.replication.library.node import FOLLOWER
from stampede_rt_supernode.replication.log_entries import Entry
from stampede_rt_supernode.replication.rules.membership import Membership
from stampede_rt_supernode.replication.rules.raft_node import PeerAtFault
from stampede_rt_supernode.replication.storage.snapshot_receiver import UnreadableSnapshot
from stampede_rt_supernode.replication.wire.buffered_transport import MemberNode
from stampede_rt_supernode.replication.wire.messages import AppendEntries, AppendReply, FromLeader, InstallSnapshot


class FollowerRole(Membership):
    """Handles the messages of leaders. Tick thread only."""

    # The id of the member that has sent the snapshot that is being opened.
    _snapshot_from: str = ""

    def _on_append(self, node: MemberNode, message: FromLeader) -> None:
        if message.term < self.term:
            # From this reply a leader of an older term learns that its term is over. The library sends none.
            self._reply(node, message, next_index=self.log.last_index + 1)
            return
        self._follow(node, message.term)
        self.leader_commit_index = message.commit_index
        # A stranger's digests do not count. With false digests it could keep this node from leading.
        if not self.is_stranger(node.id):
            self.digests.compare(*message.digest)
            self.digests.compare_with_majority(*message.majority_digest)
        if isinstance(message, InstallSnapshot):
            self._on_install_snapshot(node, message)
        else:
            self._on_entries(node, message)

    def _follow(self, node: MemberNode, term: int) -> None:
        if term == self.term and self.is_leader:
            raise PeerAtFault(node.id, f"says that it leads in term {term}, but this member leads in that term")
        if self.leader != node:
            self.give_up_forwarded()
            self.reads.on_leader_lost()
            self.leader = node
        if term > self.term:
            self.set_term(term, None)
        self.set_role(FOLLOWER)
        self.last_leader_contact = self.clock()
        self.postpone_election()

    def _on_entries(self, node: MemberNode, message: AppendEntries) -> None:
        first = self.log[0]
        previous, previous_term, entries = message.previous_index, message.previous_term, message.entries
        if previous < first.log_index:
            # Entries up to the first held entry are committed, so they are the same at the leader. Only later entries
            # need a check.
            entries = [entry for entry in entries if entry.log_index > first.log_index]
            previous, previous_term = first.log_index, first.term
        held = self.log.entry_at(previous)
        if (held is None or held.term != previous_term) and self.keeper.is_opening:
            # The missing entries are in the snapshot that is being opened, so the leader need not send them.
            self._reply(node, message, next_index=self.log.last_index + 1)
        elif held is None:
            self._reply(node, message, next_index=self.log.last_index + 1, reset=True)
        elif held.term != previous_term:
            # The committed entries are the same at every leader. Later entries may differ.
            self._reply(node, message, next_index=self.commit_index + 1, reset=True)
        else:
            self._merge(entries)
            self.follow_log()
            matched = previous + len(entries)
            self.raise_commit_index(min(message.commit_index, matched))
            self._reply(node, message, next_index=matched + 1, success=True)

    def _merge(self, entries: Sequence[Entry]) -> None:
        """Add the missing entries. Cuts this log off only where it holds another entry at the same position.

        The library cuts off everything after the previous entry. If messages come late or twice, that removes
        acknowledged entries.
        """
        for entry in entries:
            held = self.log.entry_at(entry.log_index)
            if held is not None and held.term == entry.term:
                continue
            if held is not None:
                self._cut_off(entry.log_index)
            self.log.append(*entry)

    def _cut_off(self, log_index: int) -> None:
        committed = max(self.commit_index, self.last_applied)
        if log_index <= committed:
            assert self.leader is not None, "only a leader's entries are merged"
            raise PeerAtFault(
                self.leader.id, f"leads, and replaces entry {log_index}, but entry {committed} is committed"
            )
        self.log.cut_from(log_index)

    def _on_install_snapshot(self, node: MemberNode, message: InstallSnapshot) -> None:
        """Process a piece of a snapshot. Ignores the message's commit index, which says nothing about this log.

        The library uses that commit index, so it may commit entries that the leader does not have. It also acknowledges
        a snapshot that it failed to load. Under this rule a damaged snapshot changes nothing, and its sender counts as
        faulty.
        """
        # While this node opens one snapshot, it ignores the pieces of another. If this node still lacks entries
        # afterwards, the leader sends the pieces again.
        if not self.keeper.is_opening and (received := self.keeper.take_in(message.chunk)) is not None:
            self._snapshot_from = node.id
            self.keeper.open(received)
        self._reply(node, message, next_index=self.log.last_index + 1)

    def install_opened(self) -> None:
        """Continue to open a received snapshot, if there is one.

        The answer to the leader's next message acknowledges the snapshot. Raises PeerAtFault if the snapshot is
        unreadable, and ReleaseTooOld if its feature level is unknown to this release.
        """
        try:
            last = self.keeper.install_opened(newer_than=self.last_applied, term_max=self.term)
        except UnreadableSnapshot as error:
            raise PeerAtFault(self._snapshot_from, f"has sent a snapshot: {error}") from error
        if last is not None:
            self.follow_log()
            self.last_applied = last.log_index
            self.raise_commit_index(last.log_index)
            self.digests.note(*self.state_machine.digest())
            self.give_up_waiting(last.log_index)

    def _reply(
        self, node: MemberNode, message: FromLeader, *, next_index: int, reset: bool = False, success: bool = False
    ) -> None:
        reply = AppendReply(
            term=self.term,
            round=message.round,
            next_index=next_index,
            reset=reset,
            success=success,
            digest=self.digests.answer,
        )
        self.transport.send(node, reply)
