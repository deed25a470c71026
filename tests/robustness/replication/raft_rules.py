"""Checks the messages and commits of members against their disks, by rules of Raft. If a member breaks one of them,
callers may notice it late or never.

The proofs of Raft rest on these rules (Ongaro and Ousterhout 2014, figure 2 and section 5.4; the dissertation, section
4.1 with the correction of July 2015). These checks show a fault at its cause. The answers to callers may show the fault
only if a second fault comes at the right moment.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from stampede_rt_supernode.replication.interface import Member
from stampede_rt_supernode.replication.log_entries import Entry
from stampede_rt_supernode.replication.storage.raft_log import RaftLog
from stampede_rt_supernode.replication.storage.store import StoredState
from stampede_rt_supernode.replication.wire.messages import AppendReply, Message, VoteReply, VoteRequest
from tests.support.supernode.list_machine import PromiseBroken


@dataclass
class MemberPromises:
    """The promises that one member has made to others."""

    member_id: str
    # The newest term in which it voted, and its vote.
    vote: tuple[int, str] = (0, "")
    # The newest term in which it acknowledged entries, and up to which index.
    held: tuple[int, int] = (0, 0)

    def note(self, to: str, message: Message) -> None:
        """Note a message that leaves the member."""
        match message:
            case AppendReply(success=True):
                self.held = max(self.held, (message.term, message.next_index - 1))
            case VoteReply(pre_vote=False):
                self._votes(message.term, to)
            case VoteRequest(pre_vote=False):
                self._votes(message.term, self.member_id)

    def _votes(self, term: int, candidate: str) -> None:
        if term == self.vote[0] and candidate != self.vote[1]:
            raise PromiseBroken(f"{self.member_id} votes for {candidate} in term {term}, after {self.vote[1]}")
        self.vote = max(self.vote, (term, candidate))

    def check_kept(self, disk: StoredState) -> None:
        """Check after a loss of power that the disk holds the promises, unless a later term has undone them."""
        if (disk.term, disk.voted_for or "") < self.vote and (disk.term, disk.voted_for) != self.vote:
            raise PromiseBroken(f"{self.member_id} voted {self.vote}; its disk has {(disk.term, disk.voted_for)}")
        term, index = self.held
        last = disk.entries[-1].log_index if disk.entries else 0
        if disk.term < term or (disk.term == term and last < index):
            raise PromiseBroken(f"{self.member_id} held entry {index} in term {term}; its disk ends at {last}")


@dataclass
class CommittedEntries:
    """The entries that leaders have committed: the term of each index."""

    terms: dict[int, int] = field(default_factory=dict)
    highest: int = 1
    # Terms in which a leader has committed an entry of its own.
    own: set[int] = field(default_factory=set)

    def by_leader(
        self,
        term: int,
        index: int,
        log: RaftLog,
        rosters: Sequence[Sequence[Member]],
        disks: dict[str, StoredState],
    ) -> None:
        """Check that a majority of one of the rosters has the entries up to `index` on its disks, when a leader commits
        them.
        """
        if not any(_majority(index, term, [disks[one.member_id] for one in roster]) for roster in rosters):
            raise PromiseBroken(f"entry {index} of term {term} was committed without a majority of the disks")
        self.own.add(term)
        for one in range(self.highest + 1, index + 1):
            if (entry := log.entry_at(one)) is not None:
                self.terms[one] = entry.term
        self.highest = max(self.highest, index)

    def by_follower(self, member_id: str, index: int, log: RaftLog) -> None:
        """Note that a member counts all entries up to `index` as committed, and check their terms."""
        entry = log.entry_at(index)
        if index > self.highest or entry is None or self.terms.get(index, entry.term) != entry.term:
            raise PromiseBroken(f"{member_id} counts entry {index} as committed, but no leader has committed it")

    def configured(self, term: int, index: int) -> None:
        """Check that a leader put a change of the members into the log only after it committed an entry of its own."""
        if term not in self.own:
            raise PromiseBroken(f"a leader changes the members at {index} before it committed an entry of term {term}")


def check_match(term: int, member_id: str, match: int, held: Entry | None, disk: StoredState) -> None:
    """Check a leader's belief that a member holds its log up to `match`, where the leader has the entry `held`.

    A member in a later term than the leader's may have lost entries that were not committed.
    """
    if match > 0 and held is not None and disk.term <= term and not _holds(disk, match, held.term):
        raise PromiseBroken(f"a leader believes that {member_id} holds entry {match} of term {held.term}; it does not")


def _majority(index: int, term: int, disks: Sequence[StoredState]) -> bool:
    return 2 * sum(_holds(disk, index, term) for disk in disks) > len(disks)


def _holds(disk: StoredState, index: int, term: int) -> bool:
    """Whether the disk holds the entry. A snapshot holds all entries that it replaces."""
    position = index - disk.entries[0].log_index if disk.entries else 0
    return position < 0 or (position < len(disk.entries) and disk.entries[position].term == term)
