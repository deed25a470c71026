"""Whom this node counts, hears and sends to: always what the newest configuration in its log says.

Three circles: the *voters* are counted; the *learner* is sent the log, so that it can become a voter soon; every other
*known* node is heard, since a member that was away does not know yet who leads by now (Ongaro's dissertation,
section 4.1: requests are taken from servers that are not in the configuration). Whose removal is applied is not heard
again.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from stampede_rt_supernode.replication.configuration import Configuration
from stampede_rt_supernode.replication.interface import Member
from stampede_rt_supernode.replication.library.pinned_copy import LEADER
from stampede_rt_supernode.replication.rules.raft_node import NodeState
from stampede_rt_supernode.replication.wire.codec import encode_configuration

TOLD_MEMBERS_MAX = 64


class Membership(NodeState):
    """Follows the configurations of the log. Tick thread only."""

    self_member: Member
    # Makes the library's node for an id.
    make_node: Callable[[str], Any]
    _SyncObj__sendAppendEntries: Callable[[], None]
    # Who is catching up in order to be added; only while this node leads.
    learner: Member | None = None

    # Members of whom others told us, by id, the last told of last; at first those of whom the settings told.
    _told: dict[str, Member]
    # Everybody whom this node hears, itself excepted, by id.
    peers: dict[str, Member]
    # What was adopted last: the version of the log's configurations, and the one that is applied.
    _adopted: tuple[int, Configuration | None] = (-1, None)

    def open_snapshot(self) -> None:
        """Load the state, and the members with it."""
        super().open_snapshot()
        self.follow_log()
        if self.is_voter() and not self._SyncObj__otherNodes:
            # Nobody could object: lead at once.
            self._SyncObj__raftElectionDeadline = float("-inf")
        else:
            self._put_off_election()

    def is_voter(self) -> bool:
        """Whether this node is a member, by its own log: others neither stand for election nor take snapshots."""
        return self._SyncObj__raftLog.configurations.current.find(self.self_member.member_id) is not None

    def voter_ids(self) -> set[str]:
        """Every other member that is counted."""
        return {node.id for node in self._SyncObj__otherNodes}

    def follow_log(self) -> None:
        """Adopt the newest configuration in the log, and those removed in the newest applied, if they are others."""
        configurations = self._SyncObj__raftLog.configurations
        seen = (configurations.version, configurations.at(self._SyncObj__raftLastApplied))
        if seen != self._adopted:
            self._adopted = seen
            self._adopt()

    def on_members_told(self, members: tuple[Member, ...]) -> None:
        """A known member has said who the members are.

        Those known already are noted, too: a snapshot from before they came may take them off the log's own list.
        """
        if any(self._told.get(member.member_id) != member for member in members):
            for member in members:
                self._told.pop(member.member_id, None)
                self._told[member.member_id] = member
            for member_id in list(self._told)[:-TOLD_MEMBERS_MAX]:
                del self._told[member_id]
            self._adopt()

    def on_introduced(self, member: Member) -> None:
        """A stranger has said that it is a member: hear it, as requests are heard from whoever leads."""
        self.on_members_told((member,))

    def set_learner(self, learner: Member | None) -> None:
        """Begin or end to send the log to a node that is no member yet."""
        self.learner = learner
        self._adopt()
        if learner is not None:
            node = self.mailroom.node(learner.member_id)
            self._SyncObj__raftNextIndex[node] = self._SyncObj__raftLog[-1][1] + 1
            self._SyncObj__raftMatchIndex[node] = 0

    def append_configuration(self, configuration: Configuration) -> int:
        """Put a configuration into the log, as the leader; it holds from now on. Returns its position."""
        log_index = self._SyncObj__raftLog[-1][1] + 1
        self._SyncObj__raftLog.add(encode_configuration(configuration), log_index, self._SyncObj__raftCurrentTerm)
        self.follow_log()
        self._SyncObj__sendAppendEntries()
        return log_index

    def _adopt(self) -> None:
        configurations = self._SyncObj__raftLog.configurations
        self._adopt_peers(configurations.known_members(), configurations.current)
        voters = {member.member_id for member in configurations.current.members} - {self.self_member.member_id}
        for node in [node for node in self._SyncObj__otherNodes if node.id not in voters]:
            self._SyncObj__otherNodes.discard(node)
        for member_id in sorted(voters - self.voter_ids()):
            node = self.mailroom.node(member_id)
            self._SyncObj__otherNodes.add(node)
            # A learner that becomes a voter keeps what it has acknowledged.
            self._SyncObj__raftNextIndex.setdefault(node, self._SyncObj__raftLog[-1][1] + 1)
            self._SyncObj__raftMatchIndex.setdefault(node, 0)
            self._SyncObj__lastResponseTime[node] = self.clock()
        self._forget_progress()

    def _adopt_peers(self, known: list[Member], current: Configuration) -> None:
        peers = {**self._told, **{member.member_id: member for member in known}}
        if self.learner is not None:
            peers[self.learner.member_id] = self.learner
        peers.update({member.member_id: member for member in current.members})
        # A removal that is not committed may be undone, and by the removed one at that.
        settled = self._SyncObj__raftLog.configurations.at(self._SyncObj__raftLastApplied)
        for member_id in (*settled.retired, self.self_member.member_id):
            peers.pop(member_id, None)
        for member_id in self.peers.keys() - peers.keys():
            self.mailroom.dropNode(self.mailroom.node(member_id))
        for member_id in sorted(peers.keys() - self.peers.keys()):
            self.mailroom.addNode(self.make_node(member_id))
        self.peers = peers

    def _forget_progress(self) -> None:
        sent_to = {node.id for node in self.sent_to()}
        for progress in (self._SyncObj__raftNextIndex, self._SyncObj__raftMatchIndex):
            for node in [node for node in progress if node.id not in sent_to]:
                del progress[node]

    def sent_to(self) -> list[Any]:
        """Everybody whom a leader sends its log to, in the order of the library's set."""
        learner = self.mailroom.node(self.learner.member_id) if self.learner is not None else None
        others = list(self._SyncObj__otherNodes)
        return others if learner is None or learner in self._SyncObj__otherNodes else [*others, learner]

    def _SyncObj__setState(self, new_state: int) -> None:  # noqa: N802
        super()._SyncObj__setState(new_state)
        if new_state != LEADER and self.learner is not None:
            self.set_learner(None)

    def _SyncObj__tryLogCompaction(self) -> None:  # noqa: N802
        # Who is not in yet may not know which configuration held at the beginning of its log.
        applied = self._SyncObj__raftLog.configurations.at(self._SyncObj__raftLastApplied)
        if applied.find(self.self_member.member_id) is not None:
            super()._SyncObj__tryLogCompaction()  # type: ignore[misc]

    # -- what member changes ask -------------------------------------------------------------------------------

    def may_change_members(self) -> bool:
        """Whether this node leads, with an entry of its own term committed, and no change is still on its way.

        Without the second, two changes by leaders of different terms may overlap (Ongaro, raft-dev, July 2015).
        """
        return self.can_confirm_reads() and self._SyncObj__raftLog.configurations.current_index <= self.commit_index()

    def configuration(self) -> Configuration:
        """The one that holds."""
        return self._SyncObj__raftLog.configurations.current

    def log_end(self) -> int:
        """The last position of the log."""
        return self._SyncObj__raftLog[-1][1]

    def held_by(self, member_id: str) -> int:
        """Up to where a member or the learner has acknowledged this leader's log; 0 for others."""
        node = self.mailroom.node(member_id)
        return 0 if node is None else self._SyncObj__raftMatchIndex.get(node, 0)

    def note_promises(self) -> None:
        """Remember what every follower has acknowledged of what is committed: it must never come back without it."""
        for node, match in self._SyncObj__raftMatchIndex.items():
            held = min(match, self._SyncObj__raftCommitIndex)
            self._SyncObj__raftLog.note_promise(node.id, 0, held)

    def let_go_of_log(self) -> None:
        """Keep, of what the log has cut off, only what somebody who is sent it may lack, and the entry before it; as a
        follower, nothing.
        """
        held = [self._SyncObj__raftMatchIndex.get(node, 0) for node in self.sent_to()]
        leads = self._SyncObj__raftState == LEADER
        self._SyncObj__raftLog.keep_after(min(held, default=self.log_end()) - 1 if leads else self.log_end())

    def term_at(self, log_index: int) -> int | None:
        """The term of an entry, None when it is not held."""
        entry = self._SyncObj__raftLog.entry_at(log_index)
        return None if entry is None else entry.term

    def alive_voters(self, *, within_seconds: float) -> set[str]:
        """Every other member that has answered this leader lately."""
        since = self.clock() - within_seconds
        heard = self._SyncObj__lastResponseTime
        return {node.id for node in self._SyncObj__otherNodes if heard.get(node, float("-inf")) > since}

    def send_timeout_now(self, member_id: str) -> bool:
        """Ask a member to lead; False when the message cannot leave."""
        node = self.mailroom.node(member_id)
        return node is not None and self.mailroom.send(
            node, {"type": "timeout_now", "term": self._SyncObj__raftCurrentTerm}
        )
