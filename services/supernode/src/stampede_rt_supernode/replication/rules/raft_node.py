"""The common parts of our rules of Raft, which correct faults of PySyncObj 0.3.17 ("the library").

The rules for messages are in follower_role.py, leader_role.py and elections.py. They follow the Raft paper (Ongaro and
Ousterhout 2014, figures 2 and 13). If a rule corrects a fault of the library, its text names the fault.
"""

from __future__ import annotations

from collections.abc import Callable

from stampede_rt_supernode.replication.library.node import LibraryNode
from stampede_rt_supernode.replication.rules.confirmed_reads import ConfirmedReads
from stampede_rt_supernode.replication.rules.digests import DigestPoll, Digests
from stampede_rt_supernode.replication.storage.snapshots import SnapshotKeeper
from stampede_rt_supernode.replication.wire.buffered_transport import BufferedTransport, MemberNode


class InvariantViolation(RuntimeError):
    """The log broke an invariant of Raft. The replica stops before it can do more harm."""


class PeerAtFault(Exception):
    """A member has broken the protocol. This replica drops the stream of that member, and continues."""

    def __init__(self, member_id: str, why: str) -> None:
        super().__init__(f"{member_id} {why}")
        self.member_id = member_id


class NodeState(LibraryNode):
    """The state that all rules read and change. Tick thread only."""

    transport: BufferedTransport
    # Whether the link to the member with this id accepts more entries or pieces of a snapshot.
    has_room: Callable[[str], bool]
    keeper: SnapshotKeeper
    digests: Digests
    # The other members' digests, as this node has collected them since it began to lead.
    poll: DigestPoll
    reads: ConfirmedReads

    # When this node last received a message of a leader of its term, by `clock`.
    last_leader_contact: float = float("-inf")

    def open_snapshot(self) -> None:
        """Load the stored snapshot, if there is one. Call it before the first tick.

        Raises the errors of `SnapshotKeeper.restore`: a node without its state must not take part.
        """
        self.skip_own_restore()
        last = self.keeper.restore()
        if last is not None:
            self.last_applied = last.log_index
            self.raise_commit_index(last.log_index)
            self.digests.note(*self.state_machine.digest())

    def apply(self, log_index: int, command: bytes) -> bytes:
        """Apply a committed command, and note the digest of the new state."""
        result = super().apply(log_index, command)
        self.digests.note(*self.state_machine.digest())
        return result

    def on_disconnected(self, node: MemberNode) -> None:
        """Note that the link to a member is lost, perhaps with pieces of a snapshot.

        Next time, this node sends the member the snapshot from the beginning. The library would continue in the middle.
        """
        super().on_disconnected(node)
        self.keeper.cancel_sending(node.id)
        self.on_stream_opened(node)

    def on_stream_opened(self, node: MemberNode) -> None:
        """Note that a stream to or from a member has ended or begun, so that requests or replies may be lost.

        If the member is the leader, this node repeats its read requests, and reports an unknown outcome for its
        forwarded commands. The library lets the callers of those commands wait for ever.
        """
        if node == self.leader:
            self.give_up_forwarded()
            self.reads.on_leader_lost()

    def set_role(self, role: int) -> None:
        """Become FOLLOWER, CANDIDATE or LEADER. A former leader frees the state that only a leader needs."""
        led = self.is_leader
        super().set_role(role)
        if self.is_leader and not led:
            self.digests.doubtful_at = 0  # the doubt concerned this node and a former leader
        if led and not self.is_leader:
            self.reads.on_leader_lost()
            self.keeper.end_sending()
            self.poll = DigestPoll()
            self.log.keep_after(self.log.last_index)

    def log_end(self) -> tuple[int, int]:
        """The (term, index) of the last entry. Voters compare these to see which of two logs is more complete."""
        last = self.log[-1]
        return last.term, last.log_index

    def is_majority(self, count: int) -> bool:
        """Whether `count` members, this one included, are more than half of all."""
        return 2 * count > len(self.other_voters) + 1

    def can_confirm_reads(self) -> bool:
        """Whether this node leads and has applied an entry of its own term.

        Before that, a new leader does not know which of its older entries are committed.
        """
        own = self.first_index_of_term
        return self.is_leader and own is not None and own <= self.last_applied
