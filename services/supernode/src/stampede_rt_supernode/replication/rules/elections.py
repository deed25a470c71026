"""Elections, and the full set of rules.

An election begins with a pre-vote (Ongaro's dissertation, section 9.6): a member asks the others whether they would
vote for it. It raises its term only if a majority would. Without a pre-vote, a member that cannot hear the leader
raises its term again and again. When the others hear that member, its higher term ends the term of a working leader.
The library has no pre-votes. A member that the leader has asked to lead needs no pre-vote.
"""

from __future__ import annotations

from typing import assert_never

from stampede_rt_supernode.replication.library.node import CANDIDATE
from stampede_rt_supernode.replication.rules.follower_role import FollowerRole
from stampede_rt_supernode.replication.rules.leader_role import LeaderRole
from stampede_rt_supernode.replication.rules.raft_node import PeerAtFault
from stampede_rt_supernode.replication.wire.buffered_transport import MemberNode
from stampede_rt_supernode.replication.wire.messages import (
    AppendEntries,
    AppendReply,
    ForwardedCommand,
    ForwardedCommandReply,
    InstallSnapshot,
    Message,
    ReadIndexReply,
    ReadIndexRequest,
    TimeoutNow,
    VoteReply,
    VoteRequest,
)

# Every leader begins its term with an entry, so only failed elections put the term ahead of the log's last term. More
# than this many failed elections are not believable: at one a second they would take twelve days.
TERMS_AHEAD_MAX = 1 << 20
# A term that is at most this far ahead of this member's term is accepted, too. So elections continue from any term that
# this member has reached. A hostile member that raises the term by this number with each message needs a hundred
# thousand years to use up the numbers.
TERMS_STEP_MAX = 1000
# A stored term above this leaves too few terms for further elections.
TERM_MAX = 1 << 61


class RaftRules(FollowerRole, LeaderRole):
    """Passes every message to its rule, and votes. Tick thread only."""

    # A term, and the ids of the members that have voted for this node in that term. A repeated vote counts once.
    _votes: tuple[int, set[str]] = (0, set())

    def receive(self, node: MemberNode, message: Message) -> None:
        """Pass a member's message to its rule. Ignores unknown senders. The library accepts messages of all senders.

        Raises PeerAtFault if the message breaks the protocol.
        """
        if self.transport.find_node(node.id) is None:
            return
        self._check_term(node.id, message)
        self._note_promise(node.id, message)
        match message:
            case AppendEntries() | InstallSnapshot():
                self._on_append(node, message)
            case AppendReply():
                self._on_append_reply(node, message)
            case VoteRequest():
                self._on_vote_request(node, message)
            case VoteReply():
                self._on_vote(node, message)
            case ForwardedCommand():
                super().receive(node, message)
            case ForwardedCommandReply():
                self._on_command_answer(node, message)
            case ReadIndexRequest():
                self.reads.on_request(node, message)
            case ReadIndexReply():
                self.reads.on_reply(node.id, message)
            case TimeoutNow():
                self._on_timeout_now(node, message)
            case _:
                assert_never(message)

    def _check_term(self, member_id: str, message: Message) -> None:
        """Refuse a term that elections cannot explain, because it would leave too few terms for later elections.

        A newcomer without entries accepts any term, because its log has no term to compare with.
        """
        claimed, (last_term, _) = _claimed_term(message), self.log_end()
        term_max = max(last_term + TERMS_AHEAD_MAX, self.term + TERMS_STEP_MAX)
        is_new = self.log.last_index <= 1 and not self.is_voter()
        if claimed > term_max and not is_new:
            raise PeerAtFault(member_id, f"names term {claimed}, but this member is in term {self.term}")

    def _note_promise(self, member_id: str, message: Message) -> None:
        """Note the member's promise: the term that it has reached. If the member leads, also note the committed
        entries.

        The member has written both to its disk before it sent the message. `note_promises` notes the committed entries
        that followers hold.
        """
        match message:
            case AppendEntries() | InstallSnapshot():
                self.log.note_promise(member_id, message.term, message.commit_index)
            case AppendReply():
                self.log.note_promise(member_id, message.term, 0)
            case VoteRequest(pre_vote=False) | VoteReply(pre_vote=False):
                self.log.note_promise(member_id, message.term, 0)
            case VoteReply():
                self.log.note_promise(member_id, message.voter_term, 0)

    def _on_command_answer(self, node: MemberNode, message: ForwardedCommandReply) -> None:
        """Process the leader's answer to a forwarded command. The caller then waits for the command's commit.

        If too many callers wait for commits already, this caller gets an unknown outcome immediately.
        """
        if node != self.leader:
            return
        if self.callers_waiting_count() >= self.conf.commandsQueueSize:
            self.disown_forwarded(message.request_id)
        else:
            super().receive(node, message)

    def _on_timeout_now(self, node: MemberNode, message: TimeoutNow) -> None:
        """If the leader asks this node to lead, and it may lead, stand for election in this step.

        This is as safe as an election timeout that ends early.
        """
        may_lead = self.is_voter() and not self.must_not_lead()
        if message.term == self.term and node == self.leader and may_lead:
            self.election_deadline = float("-inf")

    def _on_vote_request(self, node: MemberNode, message: VoteRequest) -> None:
        if message.term > self.term:
            self.become_follower(message.term)
        if message.term < self.term or self.is_leader:
            return
        if (message.last_log_term, message.last_log_index) < self.log_end():
            return
        if self.voted_for not in (None, node.id) or self.disputed_by:
            return
        self.set_term(self.term, node.id)
        self.postpone_election()
        self.transport.send(node, VoteReply(term=message.term))

    def _on_vote(self, node: MemberNode, message: VoteReply) -> None:
        """Count a vote, once per node and term. The library also counts repeated and late votes."""
        if message.term != self.term or self.role != CANDIDATE:
            return
        if node not in self.other_voters:
            return  # the sender is not a voter, or has been removed
        if self._votes[0] != message.term:
            self._votes = (message.term, set())
        self._votes[1].add(node.id)
        self.votes_count = 1 + len(self._votes[1])
        if self.is_majority(self.votes_count):
            self.become_leader()


class PreVoteElections(RaftRules):
    """The full set of rules: the handlers of RaftRules, and the pre-vote before an election. Tick thread only."""

    # A node that has received a message of the leader within this time answers no pre-vote.
    leader_alive_seconds: float

    # The term of the present pre-vote, and the ids of the members that would vote for this node in that term.
    _pre_vote: tuple[int, set[str]] = (0, set())
    # The last term in which a majority would vote for this node.
    _pre_vote_won_term: int = 0

    def before_tick(self) -> None:
        """Adopt changes of the members. If an election is due, begin a pre-vote in its place.

        The election begins in this tick if this node has won the pre-vote, or is the only voter.
        """
        self.follow_log()
        self.review_strangers()
        due = self.election_deadline < self.clock()
        if not due or self.is_leader:
            return
        if not self.is_voter() or self.must_not_lead():
            # A node that is not yet a voter, or was removed, must get no votes. A node with a diverged state, or with
            # a store that another member refuses, must not lead.
            self.postpone_election()
            self._lose_leader()
            return
        if not self.other_voters:
            return
        term = self.term + 1
        self._lose_leader()
        if self._pre_vote_won_term == term:
            return
        self.postpone_election()
        self._pre_vote = (term, set())
        last_term, last_index = self.log_end()
        request = VoteRequest(term=term, last_log_index=last_index, last_log_term=last_term, pre_vote=True)
        for node in self.other_voters:
            self.transport.send(node, request)

    def _lose_leader(self) -> None:
        """Forget the leader, because an election is due.

        Reads wait for the next leader. Commands that were forwarded to the former leader get an unknown outcome.
        """
        if self.leader is not None:
            self.leader = None
            self.give_up_forwarded()
            self.reads.on_leader_lost()

    def _on_vote_request(self, node: MemberNode, message: VoteRequest) -> None:
        if not message.pre_vote:
            super()._on_vote_request(node, message)
            return
        leader_alive = self.clock() - self.last_leader_contact < self.leader_alive_seconds
        complete = (message.last_log_term, message.last_log_index) >= self.log_end()
        if leader_alive or not complete or self.is_leader or self.disputed_by:
            return
        self.transport.send(node, VoteReply(term=message.term, pre_vote=True, voter_term=self.term))

    def _on_vote(self, node: MemberNode, message: VoteReply) -> None:
        if not message.pre_vote:
            super()._on_vote(node, message)
            return
        if message.voter_term > self.term:
            self.become_follower(message.voter_term)
        term, voters = self._pre_vote
        if message.term != term or self.is_leader or node not in self.other_voters:
            return
        voters.add(node.id)
        if self.is_majority(1 + len(voters)):
            self._pre_vote = (0, set())
            self._pre_vote_won_term = self.term + 1
            self.election_deadline = float("-inf")

    def _on_timeout_now(self, node: MemberNode, message: TimeoutNow) -> None:
        super()._on_timeout_now(node, message)
        if self.election_deadline == float("-inf"):
            # Members that hear the leader would refuse a pre-vote, but the leader itself has asked for this election.
            self._pre_vote_won_term = self.term + 1

    def send_now(self) -> None:
        """Send every member its missing entries, or a heartbeat, now, if this node leads."""
        if self.is_leader:
            self.send_append_entries()


def _claimed_term(message: Message) -> int:
    """The highest term that a message claims; 0 if it claims no term."""
    match message:
        case VoteReply():
            return max(message.term, message.voter_term)
        case AppendEntries() | InstallSnapshot() | AppendReply() | VoteRequest() | TimeoutNow():
            return message.term
        case _:
            return 0
