"""Trial elections (PreVote; Ongaro's dissertation, section 9.6): nobody's term moves before a majority would vote.

Without them a member that cannot hear the leader raises its term again and again, and every time it is heard
it unseats a leader that serves well. The library has none.
"""

from __future__ import annotations

from typing import Any

from stampede_rt_supernode.replication.codec import Message
from stampede_rt_supernode.replication.library import LEADER
from stampede_rt_supernode.replication.raft_node import RaftRules


class TrialElections(RaftRules):
    """The full set of rules: corrected handlers, and a trial before every election. Tick thread only."""

    # A leader heard of within this time is alive, and no trial finds a vote here.
    leader_alive_seconds: float

    # The term that is being asked about, and who would vote for this node in it.
    _trial: tuple[int, set[str]] = (0, set())
    # The last term in which a majority would vote for this node.
    _trial_won_term: int = 0

    def before_tick(self) -> None:
        """Turn an election that is due into a trial, unless its trial was won already."""
        due = self._SyncObj__raftElectionDeadline < self.clock()
        if not due or self._SyncObj__raftState == LEADER or not self._SyncObj__otherNodes:
            return
        term = self._SyncObj__raftCurrentTerm + 1
        self._lose_leader()
        if self._trial_won_term == term:
            return
        self._put_off_election()
        self._trial = (term, set())
        last_term, last_index = self._log_end()
        for node in self._SyncObj__otherNodes:
            self.mailroom.send(
                node,
                {
                    "type": "request_vote",
                    "trial": True,
                    "term": term,
                    "last_log_index": last_index,
                    "last_log_term": last_term,
                },
            )

    def _lose_leader(self) -> None:
        """Nothing was heard of the leader for an election timeout: nobody's commands or reads go to it any more."""
        if self._SyncObj__raftLeader is not None:
            self._SyncObj__raftLeader = None
            self._SyncObj__onLeaderChanged()
            self.reads.on_leader_lost()

    def _on_vote_request(self, node: Any, message: Message) -> None:
        if not message["trial"]:
            super()._on_vote_request(node, message)
            return
        leader_alive = self.clock() - self.last_leader_contact < self.leader_alive_seconds
        complete = (message["last_log_term"], message["last_log_index"]) >= self._log_end()
        if leader_alive or not complete or self._SyncObj__raftState == LEADER:
            return
        reply = {"type": "response_vote", "trial": True, "term": message["term"]}
        self.mailroom.send(node, {**reply, "voter_term": self._SyncObj__raftCurrentTerm})

    def _on_vote(self, node: Any, message: Message) -> None:
        if not message["trial"]:
            super()._on_vote(node, message)
            return
        if message["voter_term"] > self._SyncObj__raftCurrentTerm:
            self._step_down(message["voter_term"])
        term, voters = self._trial
        if message["term"] != term or self._SyncObj__raftState == LEADER:
            return
        voters.add(node.id)
        if self.is_majority(1 + len(voters)):
            self._trial = (0, set())
            self._trial_won_term = self._SyncObj__raftCurrentTerm + 1
            self._SyncObj__raftElectionDeadline = float("-inf")

    def send_now(self) -> None:
        """Send to every member now, if this node leads."""
        if self._SyncObj__raftState == LEADER:
            self._SyncObj__sendAppendEntries()
