"""Confirmed reads. Each one finds a log position that includes every write acknowledged before the read.

No read adds an entry to the log. The leader notes its commit index, starts a new round, and waits until a majority has
answered a message of that round or a later one in the leader's own term. This proves that there was no newer leader
when the round began (Ongaro's dissertation, section 6.4). A follower asks the leader for the position. Many reads share
one round and one request.

PySyncObj has no such reads. Its `lastResponseTime` does not suffice, because replies to messages from before the read
update it, too.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

from stampede_rt_supernode.replication.wire.buffered_transport import BufferedTransport, MemberNode
from stampede_rt_supernode.replication.wire.messages import ReadIndexReply, ReadIndexRequest


@dataclass(slots=True)
class ConfirmedRead:
    """One read under way. `done` is called once: with the applied index, or with None if no index was found.

    It gets None after `deadline`, by the replica's clock, and when the replica closes.
    """

    deadline: float
    done: Callable[[int | None], None]


@dataclass(slots=True)
class _Round:
    """The reads, and the requests of followers, that wait until a majority has echoed one round."""

    number: int
    commit_index: int
    reads: list[ConfirmedRead] = field(default_factory=list)
    # (member, request id) of the followers that asked
    requests: list[tuple[MemberNode, int]] = field(default_factory=list)


@dataclass(slots=True)
class _ForwardedReads:
    """The reads that wait for the leader's answer to one request. At `give_up_at` they begin again."""

    request_id: int
    reads: list[ConfirmedRead]
    give_up_at: float
    leader_id: str

    def is_answered_by(self, member_id: str, request_id: int) -> bool:
        """Whether a reply of `member_id` with `request_id` is the asked leader's answer to this request."""
        return (self.leader_id, self.request_id) == (member_id, request_id)


class ReadingNode(Protocol):
    """The attributes and methods of the node that reads use."""

    leader: MemberNode | None
    commit_index: int
    last_applied: int

    def can_confirm_reads(self) -> bool:
        """Whether this node leads and has applied an entry of its own term."""

    def voter_ids(self) -> set[str]:
        """The ids of all other voters."""

    def is_majority(self, count: int) -> bool:
        """Whether `count` voters, this one included, are more than half of all."""


class ConfirmedReads:
    """All reads of one replica. Tick thread only.

    Invariant: a read is in exactly one of `_new`, `_rounds`, `_forwarded`, `_confirmed` until it is done.
    """

    def __init__(
        self,
        node: ReadingNode,
        transport: BufferedTransport,
        clock: Callable[[], float],
        *,
        retry_seconds: float,
        first_request_id: int,
    ) -> None:
        """A follower repeats its request to the leader after `retry_seconds` without an answer."""
        self._node = node
        self._transport = transport
        self._clock = clock
        self._retry_seconds = retry_seconds
        self._next_request_id = first_request_id
        # The number of the newest round. The leader puts it in every append message, and the replies echo it.
        self.round = 0
        # The reads that have no round and no request yet.
        self._new: list[ConfirmedRead] = []
        # The latest request of each member: a member that asks again has given up its earlier request.
        self._new_requests: dict[MemberNode, int] = {}
        # The rounds that wait for a majority, the oldest first.
        self._rounds: list[_Round] = []
        # By member id: the newest round that the member has echoed in the present term.
        self._echoes: dict[str, int] = {}
        # The present request to the leader; None if there is none.
        self._forwarded: _ForwardedReads | None = None
        # (log position, reads): the reads that wait until this replica has applied the position.
        self._confirmed: list[tuple[int, list[ConfirmedRead]]] = []

    @property
    def is_idle(self) -> bool:
        """Whether no read of this node waits."""
        return not (self._new or self._rounds or self._forwarded or self._confirmed)

    def add(self, read: ConfirmedRead) -> None:
        """Begin a read."""
        self._new.append(read)

    def on_request(self, node: MemberNode, message: ReadIndexRequest) -> None:
        """Note that a member asks for a position."""
        self._new_requests[node] = message.request_id

    def on_reply(self, member_id: str, message: ReadIndexReply) -> None:
        """Process a member's reply. If it has no position, the reads that wait for the reply begin again."""
        if self._forwarded is not None and self._forwarded.is_answered_by(member_id, message.request_id):
            answered, self._forwarded = self._forwarded, None
            if message.read_index > 0:
                self._confirmed.append((message.read_index, answered.reads))
            else:
                self._new.extend(answered.reads)

    def on_echo(self, member_id: str, round_number: int) -> None:
        """Note that a member has answered a message of this round in the present term."""
        self._echoes[member_id] = max(round_number, self._echoes.get(member_id, 0))

    def on_leader_lost(self) -> None:
        """Begin all unconfirmed reads again, and refuse the requests of followers.

        Requests and answers may be lost. Requests and answers of a former leadership do not count.
        """
        self._echoes.clear()
        rounds, self._rounds = self._rounds, []
        for each in rounds:
            self._new.extend(each.reads)
            self._refuse(each.requests)
        if self._forwarded is not None:
            self._new.extend(self._forwarded.reads)
            self._forwarded = None

    def start_round(self) -> bool:
        """Begin the waiting reads, if possible.

        Returns True if this node leads and must send a message to all members now.
        """
        if self._forwarded is not None and self._clock() >= self._forwarded.give_up_at:
            self._new.extend(self._forwarded.reads)
            self._forwarded = None
        if not self._node.can_confirm_reads():
            requests, self._new_requests = list(self._new_requests.items()), {}
            self._refuse(requests)
            self._ask_leader()
            return False
        if not self._new and not self._new_requests:
            return False
        self.round += 1
        requests = list(self._new_requests.items())
        self._rounds.append(_Round(self.round, self._node.commit_index, reads=self._new, requests=requests))
        self._new, self._new_requests = [], {}
        return True

    def finish(self) -> None:
        """Complete the reads that are confirmed and applied, and give up the reads whose time is up."""
        while self._rounds and self._is_confirmed(self._rounds[0]):
            done = self._rounds.pop(0)
            self._confirmed.append((done.commit_index, done.reads))
            for node, request_id in done.requests:
                self._answer(node, request_id, done.commit_index)
        applied = self._node.last_applied
        for index, reads in self._confirmed:
            if index <= applied:
                for read in reads:
                    read.done(applied)
        self._confirmed = [(index, reads) for index, reads in self._confirmed if index > applied]
        self._expire()

    def close(self) -> None:
        """End every read with None."""
        self.on_leader_lost()
        for read in [*self._new, *(read for _, reads in self._confirmed for read in reads)]:
            read.done(None)
        self._new, self._confirmed = [], []

    def _is_confirmed(self, each: _Round) -> bool:
        voters = self._node.voter_ids()
        echoed = sum(1 for name, number in self._echoes.items() if number >= each.number and name in voters)
        return bool(self._node.is_majority(1 + echoed))

    def _ask_leader(self) -> None:
        leader = self._node.leader
        if not self._new or self._forwarded is not None or leader is None:
            return
        if not self._transport.is_reachable(leader.id):
            return
        self._next_request_id += 1
        self._transport.send(leader, ReadIndexRequest(request_id=self._next_request_id))
        give_up_at = self._clock() + self._retry_seconds
        self._forwarded = _ForwardedReads(self._next_request_id, self._new, give_up_at, leader.id)
        self._new = []

    def _refuse(self, requests: list[tuple[MemberNode, int]]) -> None:
        for node, request_id in requests:
            self._answer(node, request_id, 0)

    def _answer(self, node: MemberNode, request_id: int, read_index: int) -> None:
        self._transport.send(node, ReadIndexReply(request_id=request_id, read_index=read_index))

    def _expire(self) -> None:
        now = self._clock()
        self._new = _unexpired(self._new, now)
        for each in self._rounds:
            each.reads = _unexpired(each.reads, now)
        if self._forwarded is not None:
            self._forwarded.reads = _unexpired(self._forwarded.reads, now)
        self._confirmed = [(index, _unexpired(reads, now)) for index, reads in self._confirmed]


def _unexpired(reads: list[ConfirmedRead], now: float) -> list[ConfirmedRead]:
    for read in reads:
        if read.deadline <= now:
            read.done(None)
    return [read for read in reads if read.deadline > now]
