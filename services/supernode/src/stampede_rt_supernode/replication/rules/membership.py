"""The members whose votes this node counts, whose messages it accepts, and to which it sends.

There are three kinds. The *voters* are the members of the newest configuration in the log; only their votes and
acknowledgements count. The *learner* gets the log from the leader, so that it can become a voter soon. This node also
accepts messages of every other *known* node, because a member that was unreachable does not know the present leader yet
(Ongaro's dissertation, section 4.1: servers accept requests from servers outside their configuration). It accepts no
message of a member whose removal is applied.

The members in the log are known, and so are the members that a known node has named. Every other node is a *stranger*:
only that node itself or another stranger has named it. This node accepts messages of strangers only while it is
*locked out*: it has not received a message of a leader for so long that all members it knows may be gone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

from stampede_rt_supernode.replication.configuration import Configuration
from stampede_rt_supernode.replication.interface import Member
from stampede_rt_supernode.replication.library.node import LEADER
from stampede_rt_supernode.replication.rules.raft_node import NodeState
from stampede_rt_supernode.replication.wire.buffered_transport import MemberNode
from stampede_rt_supernode.replication.wire.messages import TimeoutNow
from stampede_rt_supernode.replication.wire.records import encode_configuration

# The most members that this node remembers because a known member has named them.
NAMED_MEMBERS_MAX = 64
# The most strangers that this node remembers.
STRANGERS_MAX = 16


class Membership(NodeState):
    """Applies the configurations of the log to this node. Tick thread only."""

    self_member: Member
    # Makes the library's node for an id.
    make_member: Callable[[str], MemberNode]
    # The node that catches up in order to be added; only while this node leads.
    learner: Member | None = None

    # When this node last had a leader, or led. It is locked out if `locked_out_seconds` have passed after that time.
    had_leader_at: float
    locked_out_seconds: float

    # By id: the members that known members have named, the latest last. At first these are the members in the settings.
    _named: dict[str, Member]
    # By id: the nodes that have named themselves, or that a stranger has named, the latest last.
    _strangers: dict[str, Member]
    _accepts_strangers: bool = False
    # When this node began to lead, and by id: when a voter or the learner last answered it as the leader of this term.
    # The library's `last_response_time` also counts a voter that has not answered yet.
    _led_since: float = float("-inf")
    _answered_at: dict[str, float]
    # By id: why a known member refuses this node's store. As long as one does, this node does not vote.
    disputed_by: dict[str, str]
    # All members whose messages this node accepts, by id, without itself.
    peers: dict[str, Member]
    # The facts that this node adopted last: the version of the log's configurations, and the newest applied one.
    _adopted: tuple[int, Configuration | None] = (-1, None)

    def open_snapshot(self) -> None:
        """Load the stored snapshot, adopt the members in the log, and set the election deadline."""
        super().open_snapshot()
        self.follow_log()
        if self.is_voter() and not self.other_voters:
            # This node is the only voter, so its first tick makes it the leader.
            self.election_deadline = float("-inf")
        else:
            self.postpone_election()

    def is_voter(self) -> bool:
        """Whether this node is a member by its own log.

        A non-member neither stands for election nor takes snapshots.
        """
        return self.log.configurations.current.find(self.self_member.member_id) is not None

    def voter_ids(self) -> set[str]:
        """The ids of all other voters."""
        return {node.id for node in self.other_voters}

    def follow_log(self) -> None:
        """Adopt the newest configuration in the log, and the removals in the newest applied configuration.

        Does nothing if neither has changed.
        """
        configurations = self.log.configurations
        seen = (configurations.version, configurations.at(self.last_applied))
        if seen != self._adopted:
            self._adopted = seen
            self._adopt()

    def on_members_reported(self, reporter_id: str, members: tuple[Member, ...]) -> None:
        """Process the list of members that another node has sent.

        Remembers also the members that the log names, because a snapshot may replace the entries that name them.
        """
        if self.is_stranger(reporter_id):
            for member in members:
                self.on_introduced(member)
        elif any(self._named.get(member.member_id) != member for member in members):
            _remember(self._named, members, NAMED_MEMBERS_MAX)
            self._adopt()

    def on_introduced(self, member: Member) -> None:
        """Remember a stranger: a node that has named itself as a member, or that another stranger has named."""
        if self._strangers.get(member.member_id) != member:
            _remember(self._strangers, (member,), STRANGERS_MAX)
            if self._accepts_strangers:
                self._adopt()

    def review_strangers(self) -> None:
        """Begin to accept messages of strangers when this node is locked out.

        Stop when this node leads, or receives a message of a known leader.
        """
        is_accepting = self._accepts_strangers
        if self.leader is None:
            is_accepting = is_accepting or self.clock() - self.had_leader_at > self.locked_out_seconds
        else:
            self.had_leader_at = self.clock()
            is_accepting = is_accepting and self.is_stranger(self.leader.id)
        if is_accepting != self._accepts_strangers:
            self._accepts_strangers = is_accepting
            self._adopt()

    def is_stranger(self, member_id: str) -> bool:
        """Whether neither the log nor a known member has named this member."""
        if member_id in self._named or member_id == self.self_member.member_id:
            return False
        return all(member.member_id != member_id for member in self.log.configurations.known_members())

    def on_disputed(self, member_id: str, why: str) -> None:
        """Note that a member refuses this node's store, for the reason `why`. Ignores a stranger's refusal.

        If `why` is empty, the member accepts the store again.
        """
        if not why:
            self.disputed_by.pop(member_id, None)
        elif member_id in self.peers and not self.is_stranger(member_id):
            self.disputed_by[member_id] = why

    def must_not_lead(self) -> bool:
        """Whether this node must not lead: its state has diverged, or a known member refuses its store."""
        return bool(self.digests.diverged_at or self.disputed_by)

    def doubts(self) -> dict[str, int]:
        """By member id: the first position at which the member's state differs from the leader's.

        A leader names the other members, a follower only itself. Empty as soon as more than half of the members are
        known to have the same state.
        """
        if self.is_leader:
            return dict(self.poll.doubts)
        at = self.digests.doubtful_at
        return {self.self_member.member_id: at} if at else {}

    def set_learner(self, learner: Member | None) -> None:
        """Begin to send the log to `learner`, which is not a member yet.

        None ends the sending to the present learner.
        """
        self.learner = learner
        self._adopt()
        if learner is not None:
            node = self.transport.node(learner.member_id)
            self.next_index[node] = self.log.last_index + 1
            self.match_index[node] = 0

    def append_configuration(self, configuration: Configuration) -> int:
        """Put a configuration into the log. It takes effect immediately. Returns its log position. Only for a
        leader.
        """
        log_index = self.log.last_index + 1
        self.log.append(encode_configuration(configuration), log_index, self.term)
        self.follow_log()
        self.send_append_entries()
        return log_index

    def _adopt(self) -> None:
        configurations = self.log.configurations
        self._adopt_peers(configurations.known_members(), configurations.current)
        voters = {member.member_id for member in configurations.current.members} - {self.self_member.member_id}
        for node in [node for node in self.other_voters if node.id not in voters]:
            self.other_voters.discard(node)
        for member_id in sorted(voters - self.voter_ids()):
            node = self.transport.node(member_id)
            self.other_voters.add(node)
            # A learner that becomes a voter keeps its acknowledged position.
            self.next_index.setdefault(node, self.log.last_index + 1)
            self.match_index.setdefault(node, 0)
            self.last_response_time[node] = self.clock()
        self._forget_progress()

    def _adopt_peers(self, known: list[Member], current: Configuration) -> None:
        strangers = self._strangers if self._accepts_strangers else {}
        peers = {**strangers, **self._named, **{member.member_id: member for member in known}}
        if self.learner is not None:
            peers[self.learner.member_id] = self.learner
        # Drops a member only when its removal is applied. Until then a new leader, even the member itself, may undo the
        # removal.
        for member_id in self.log.configurations.at(self.last_applied).retired:
            peers.pop(member_id, None)
        # Keeps all present members, even if a hostile leader has added a removed member again.
        peers.update({member.member_id: member for member in current.members})
        peers.pop(self.self_member.member_id, None)
        for member_id in self.peers.keys() - peers.keys():
            self.transport.drop_node(self.transport.node(member_id))
        for member_id in sorted(peers.keys() - self.peers.keys()):
            self.transport.add_node(self.make_member(member_id))
        self.peers = peers

    def _forget_progress(self) -> None:
        sent_to = {node.id for node in self.sent_to()}
        self._answered_at = {name: at for name, at in self._answered_at.items() if name in sent_to}
        for progress in (self.next_index, self.match_index):
            for node in [node for node in progress if node.id not in sent_to]:
                del progress[node]

    def sent_to(self) -> list[MemberNode]:
        """The nodes to which a leader sends its log: the other voters in the order of the set, then the learner."""
        learner = self.transport.find_node(self.learner.member_id) if self.learner is not None else None
        others = list(self.other_voters)
        return others if learner is None or learner in self.other_voters else [*others, learner]

    def set_role(self, role: int) -> None:
        """Become FOLLOWER, CANDIDATE or LEADER. Only a leader has a learner."""
        super().set_role(role)
        if role != LEADER and self.learner is not None:
            self.set_learner(None)
        self._answered_at = {}
        self._led_since = self.clock()

    def note_answer(self, node: MemberNode) -> None:
        """Note that a voter or the learner has answered this leader in its term."""
        self.last_response_time[node] = self._answered_at[node.id] = self.clock()

    def take_snapshot_if_due(self) -> None:
        """Take a due snapshot, but only as a member.

        A node that is not a member may not know the configuration at the beginning of its log.
        """
        applied = self.log.configurations.at(self.last_applied)
        if applied.find(self.self_member.member_id) is not None:
            super().take_snapshot_if_due()

    # -- for member changes ------------------------------------------------------------------------------------

    def may_change_members(self) -> bool:
        """Whether this node leads, has committed an entry of its own term, and no change is uncommitted.

        Without the entry of its own term, two changes by leaders of different terms may overlap (Ongaro, raft-dev, July
        2015).
        """
        return self.can_confirm_reads() and self.log.configurations.current_index <= self.commit_index

    def known_levels(self) -> dict[str, int]:
        """By member id: the highest feature level that the member's release knows, as the member said.

        Includes this member.
        """
        return {**self.transport.highest_levels, self.self_member.member_id: self.state_machine.highest_level}

    def level_to_join(self) -> int:
        """The feature level that a newcomer's release must know.

        It is the cluster's level, or the higher level to which the cluster is about to rise.
        """
        known = self.known_levels()
        levels = [known.get(member.member_id, 0) for member in self.configuration().members]
        return max(self.state_machine.feature_level, min(levels))

    def configuration(self) -> Configuration:
        """The present configuration."""
        return self.log.configurations.current

    def held_by(self, member_id: str) -> int:
        """The position up to which a member or the learner has acknowledged this leader's log; 0 for other members."""
        node = self.transport.find_node(member_id)
        return 0 if node is None else self.match_index.get(node, 0)

    def note_promises(self) -> None:
        """Note a promise of each follower: the committed entries that it has acknowledged.

        A follower must never come back without these entries.
        """
        for node, match in self.match_index.items():
            held = min(match, self.commit_index)
            self.log.note_promise(node.id, 0, held)

    def free_sent_entries(self) -> None:
        """Free the entries that a snapshot has replaced and that are only kept to be sent.

        A leader keeps the entries that a receiver may still lack, and the entry before them. A follower keeps none.
        """
        held = [self.match_index.get(node, 0) for node in self.sent_to()]
        self.log.keep_after(min(held, default=self.log.last_index) - 1 if self.is_leader else self.log.last_index)

    def term_at(self, log_index: int) -> int | None:
        """The term of an entry; None if the log does not hold it."""
        entry = self.log.entry_at(log_index)
        return None if entry is None else entry.term

    def alive_voters(self, *, within_seconds: float) -> set[str]:
        """The ids of all other voters that have answered this leader in its term within the last `within_seconds`."""
        return {name for name in self.voter_ids() if self.has_answered(name, within_seconds=within_seconds)}

    def has_answered(self, member_id: str, *, within_seconds: float) -> bool:
        """Whether a voter or the learner has answered this leader in its term within the last `within_seconds`."""
        return self._answered_at.get(member_id, float("-inf")) > self.clock() - within_seconds

    def has_led_for(self, seconds: float) -> bool:
        """Whether this node has led for that time, so that each live voter has had the time to answer."""
        return self.is_leader and self.clock() - self._led_since >= seconds

    def send_timeout_now(self, member_id: str) -> bool:
        """Ask a member to lead. Returns False if the message cannot be sent."""
        node = self.transport.find_node(member_id)
        return node is not None and self.transport.send(node, TimeoutNow(term=self.term))


def _remember(members: dict[str, Member], named: Iterable[Member], members_max: int) -> None:
    """Put the `named` members last, and forget the first members if there are too many."""
    for member in named:
        members.pop(member.member_id, None)
        members[member.member_id] = member
    for member_id in list(members)[:-members_max]:
        del members[member_id]
