"""The follower's rules: take in entries and snapshots, and say truly what is held."""

from __future__ import annotations

from collections.abc import Sequence

from stampede_rt_supernode.replication.library.node import FOLLOWER
from stampede_rt_supernode.replication.log_entries import Entry
from stampede_rt_supernode.replication.rules.membership import Membership
from stampede_rt_supernode.replication.rules.raft_node import PeerAtFault
from stampede_rt_supernode.replication.storage.snapshot_receiver import UnreadableSnapshot
from stampede_rt_supernode.replication.wire.buffered_transport import MemberNode
from stampede_rt_supernode.replication.wire.messages import AppendEntries, AppendReply, FromLeader, InstallSnapshot


class Following(Membership):
    """Handles what leaders send. Tick thread only."""

    # Who has sent the snapshot that is being opened.
    _snapshot_from: str = ""

    def _on_append(self, node: MemberNode, message: FromLeader) -> None:
        if message.term < self.term:
            # Tells a leader of an older term that it is one; the library is silent.
            self._reply(node, message, next_index=self.log.last_index + 1)
            return
        self._follow(node, message.term)
        self.leader_commit_index = message.commit_index
        if not self.is_stranger(node.id):  # whose word must not set this node aside for good
            self.digests.told(*message.digest)
            self.digests.told_of_most(*message.digest_of_most)
        if isinstance(message, InstallSnapshot):
            self._on_install_snapshot(node, message)
        else:
            self._on_entries(node, message)

    def _follow(self, node: MemberNode, term: int) -> None:
        if term == self.term and self.is_leader:
            raise PeerAtFault(node.id, f"says that it leads in term {term}, and this node does")
        if self.leader != node:
            self.give_up_forwarded()
            self.reads.on_leader_lost()
            self.leader = node
        if term > self.term:
            self.set_term(term, None)
        self.set_role(FOLLOWER)
        self.last_leader_contact = self.clock()
        self.put_off_election()

    def _on_entries(self, node: MemberNode, message: AppendEntries) -> None:
        first = self.log[0]
        previous, previous_term, entries = message.previous_index, message.previous_term, message.entries
        if previous < first.log_index:
            # All up to our first entry is committed, so it agrees; only what follows needs a look.
            entries = [entry for entry in entries if entry.log_index > first.log_index]
            previous, previous_term = first.log_index, first.term
        held = self.log.entry_at(previous)
        if (held is None or held.term != previous_term) and self.keeper.is_opening:
            # What is lacking is here already, and there in a moment: nothing need be sent again.
            self._reply(node, message, next_index=self.log.last_index + 1)
        elif held is None:
            self._reply(node, message, next_index=self.log.last_index + 1, reset=True)
        elif held.term != previous_term:
            # What is committed agrees with every leader; all behind it may not.
            self._reply(node, message, next_index=self.commit_index + 1, reset=True)
        else:
            self._merge(entries)
            self.follow_log()
            matched = previous + len(entries)
            self.raise_commit_index(min(message.commit_index, matched))
            self._reply(node, message, next_index=matched + 1, success=True)

    def _merge(self, entries: Sequence[Entry]) -> None:
        """Add what is not held yet; cut off a tail only at a real conflict.

        The library cuts off everything past the previous entry, and with it entries already acknowledged when
        messages come late or twice.
        """
        for entry in entries:
            held = self.log.entry_at(entry.log_index)
            if held is not None and held.term == entry.term:
                continue
            if held is not None:
                self._cut_off(entry.log_index)
            self.log.append(*entry)

    def _cut_off(self, log_index: int) -> None:
        settled = max(self.commit_index, self.last_applied)
        if log_index <= settled:
            assert self.leader is not None, "only a leader's entries are merged"
            raise PeerAtFault(
                self.leader.id, f"leads, and wants entry {log_index} replaced, but {settled} is committed"
            )
        self.log.cut_from(log_index)

    def _on_install_snapshot(self, node: MemberNode, message: InstallSnapshot) -> None:
        """Take in a piece. The message's commit index says nothing about this log, and is not used.

        The library takes it over, and so commits whatever the log happens to hold. It also acknowledges a
        snapshot that it failed to load; here nothing of it is taken over, and its sender is at fault.
        """
        # Of two at a time the second is not kept: if it is still needed then, the leader sends it again.
        if not self.keeper.is_opening and (received := self.keeper.take_in(message.chunk)) is not None:
            self._snapshot_from = node.id
            self.keeper.open(received)
        self._reply(node, message, next_index=self.log.last_index + 1)

    def install_opened(self) -> None:
        """Go on opening a received snapshot, if there is one. The leader hears of it with its next message."""
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
