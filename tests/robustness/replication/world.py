"""A cluster in one thread: real replicas with a simulated clock, network and disk. One seed determines everything."""

from __future__ import annotations

import heapq
import itertools
import random
from collections.abc import Callable, Sequence

from stampede_rt.v1 import raft_service_pb2 as pb
from stampede_rt_supernode.replication.interface import TOO_OLD, LogUnavailable, Member, OutcomeUnknown
from stampede_rt_supernode.replication.network.hello import introduced_member, introduction
from stampede_rt_supernode.replication.raft_replica import RaftReplica
from stampede_rt_supernode.replication.rules.confirmed_reads import ConfirmedRead
from stampede_rt_supernode.replication.rules.elections import PreVoteElections
from stampede_rt_supernode.replication.rules.member_change import ChangeOutcome, MemberChange
from stampede_rt_supernode.replication.rules.proposals import Outcome, Proposal
from stampede_rt_supernode.replication.settings import RaftTiming
from stampede_rt_supernode.replication.wire.buffered_transport import (
    LinkConnected,
    LinkDisconnected,
    MembersReported,
    MessageReceived,
    NodeIntroduced,
    StreamEnded,
    StreamOpened,
)
from stampede_rt_supernode.replication.wire.codec import decode_message, encode_message
from stampede_rt_supernode.replication.wire.messages import ForwardedCommand, Message
from tests.robustness.replication.fault_rates import FaultRates
from tests.robustness.replication.raft_rules import CommittedEntries
from tests.robustness.replication.sim_member import SimMember, Wire
from tests.support.supernode.list_machine import History, PromiseBroken

TIMING = RaftTiming(tick_seconds=0.05)


class World:
    """Time, members and connections. `at` plans a call; `run_until` lets time pass. Times are in seconds."""

    def __init__(
        self,
        seed: int,
        *,
        size: int,
        fault_rates: FaultRates,
        rules: type = PreVoteElections,
        snapshot_every: int = 15,
        kept_log_bytes: int = 1,
        timing: RaftTiming = TIMING,
    ) -> None:
        self.random_source = random.Random(seed)
        self.fault_rates = fault_rates
        self.rules = rules
        self.snapshot_every = snapshot_every
        # By default the log keeps few entries, so that a member that lags behind gets snapshots.
        self.kept_log_bytes = kept_log_bytes
        self.now = 0.0
        self.timing = timing
        self.history = History()
        self.committed = CommittedEntries()
        # Whether there are hostile peers, whose false statements members may repeat.
        self.may_be_misled = False
        self._events: list[tuple[float, int, Callable[[], None]]] = []
        self._order = itertools.count()
        roster = [Member(member_id=f"m{number}", address=f"m{number}:1") for number in range(size)]
        self.members: dict[str, SimMember] = {}
        self.wires: dict[tuple[str, str], Wire] = {}
        # The ids of members whose removal was acknowledged.
        self.removed: set[str] = set()
        for member in roster:
            self._place(SimMember(self, member, roster))

    def _place(self, newcomer: SimMember) -> None:
        name = newcomer.member.member_id
        ends = [pair for other in self.members for pair in ((name, other), (other, name))]
        self.members[name] = newcomer
        for pair in ends:
            self.wires[pair] = Wire()
            self._plan_connect(pair)

    def _newcomer(self, member: Member, seeds: Sequence[Member]) -> SimMember:
        return SimMember(self, member, seeds, joining=True)

    def volunteer(self, seeds: Sequence[Member]) -> SimMember:
        """Start a new process that asks to become a member, and knows the addresses of `seeds`."""
        name = f"m{len(self.members)}"
        newcomer = self._newcomer(Member(member_id=name, address=f"{name}:1"), seeds)
        newcomer.disk.lost_commits = next(iter(self.members.values())).disk.lost_commits
        self._place(newcomer)
        newcomer.start()
        return newcomer

    def at(self, when: float, call: Callable[[], None]) -> None:
        heapq.heappush(self._events, (when, next(self._order), call))

    def after(self, delay: float, call: Callable[[], None]) -> None:
        self.at(self.now + delay, call)

    def run_until(self, end: float, until: Callable[[], bool] = lambda: False) -> bool:
        """Let time pass. Returns True as soon as `until` holds, and False at `end`."""
        while self._events and self._events[0][0] <= end:
            self.now, _, call = heapq.heappop(self._events)
            call()
            if until():
                return True
        self.now = end
        return until()

    def alive(self) -> list[SimMember]:
        return [member for member in self.members.values() if member.replica is not None]

    # -- network ---------------------------------------------------------------------------------------------

    def send(self, sender: str, to: str, message: Message) -> None:
        wire = self.wires.get((sender, to), Wire())  # there is no connection to outsiders
        if not wire.up or wire.blocked or self.random_source.random() < self.fault_rates.loss:
            return
        data, generation = encode_message(message).SerializeToString(), wire.generation
        arrival = max(self.now, wire.stalled_until) + self.random_source.expovariate(1 / self.fault_rates.delay_mean)
        if wire.bytes_per_second < float("inf"):
            arrival = max(arrival, wire.last_arrival) + len(data) / wire.bytes_per_second
        if self.random_source.random() < self.fault_rates.reordered:
            arrival += self.random_source.random() * self.fault_rates.reordered_seconds
            if not isinstance(message, ForwardedCommand) and self.random_source.random() < 0.5:
                repeated_at = self.now + self.random_source.random() * self.fault_rates.late_seconds_max
                self.at(repeated_at, lambda: self._arrive(sender, to, generation, data))
        else:
            arrival = wire.last_arrival = max(arrival, wire.last_arrival)
        self.at(arrival, lambda: self._arrive(sender, to, generation, data))

    def _arrive(self, sender: str, to: str, generation: int, data: bytes) -> None:
        replica = self.members[to].replica
        if replica is not None and self.wires[sender, to].generation == generation:
            replica.deliver(MessageReceived(sender, decode_message(pb.RaftMessage.FromString(data))))
            self._answer(sender, to, replica)

    def _answer(self, sender: str, to: str, receiver: RaftReplica) -> None:
        """Report the receiver's members to the sender after a message, as the stream does: at most once in 0.5 s."""
        wire, replica = self.wires[sender, to], self.members[sender].replica
        if replica is not None and wire.up and not self.wires[to, sender].blocked and self.now > wire.answer_due:
            wire.answer_due = self.now + 0.5
            replica.deliver(MembersReported(to, receiver.roster.members))

    def fault(self, sender: str, receiver: str, why: str) -> None:
        """Raises PromiseBroken, because no member may break the rules, unless hostile peers have misled it."""
        if sender in self.members and not self.may_be_misled:
            raise PromiseBroken(f"{receiver} finds {sender} at fault: {why}")

    def break_wire(self, ends: tuple[str, str]) -> None:
        """Break the connection, and lose its messages. The sender notices it and connects again."""
        wire = self.wires[ends]
        if not wire.up:
            return
        wire.up = False
        wire.generation += 1
        replica = self.members[ends[0]].replica
        if replica is not None:
            replica.deliver(LinkDisconnected(ends[1]))
        self._stream_ends(ends)
        self._plan_connect(ends)

    def _stream_ends(self, ends: tuple[str, str]) -> None:
        """Let the receiver notice the end immediately or later, unless a new connection comes first."""
        generation = self.wires[ends].generation

        def notice() -> None:
            wire, replica = self.wires[ends], self.members[ends[1]].replica
            if replica is not None and not wire.up and wire.generation == generation:
                replica.deliver(StreamEnded(ends[0]))

        self.after(self.random_source.choice([0.0, 0.3]), notice)

    def _plan_connect(self, ends: tuple[str, str]) -> None:
        self.after(self.random_source.uniform(0.1, 0.5), lambda: self._connect(ends))

    def _connect(self, ends: tuple[str, str]) -> None:
        wire, sender, receiver = self.wires[ends], self.members[ends[0]].replica, self.members[ends[1]].replica
        if wire.up or sender is None:
            return
        if wire.blocked or receiver is None or self.wires[ends[1], ends[0]].blocked:
            self._plan_connect(ends)
            return
        if ends[1] not in sender.roster.peers or ends[0] in receiver.roster.former_ids:
            self._plan_connect(ends)
            return
        if sender.highest_level < receiver.feature_level:
            self._plan_connect(ends)
            self.members[ends[0]].refuse_release(ends[1], f"{ends[0]!r} {TOO_OLD}")
            return
        if not receiver.promise_of(ends[0]).is_kept_by(*sender.durable_end):
            self._refuse(self.members[ends[0]])
            return
        sender.deliver(MembersReported(ends[1], receiver.roster.members))
        if ends[0] not in receiver.roster.peers:
            settings = self.members[ends[0]].settings
            hello = introduction(
                settings,
                ends[1],
                store_id="",
                durable_end=sender.durable_end,
                roster=sender.roster,
                highest_level=sender.highest_level,
            )
            if (member := introduced_member(hello, self.members[ends[1]].settings)) is not None:
                receiver.deliver(NodeIntroduced(member.member_id, member))
            self._plan_connect(ends)
            return
        wire.up = True
        sender.deliver(LinkConnected(ends[1]))
        receiver.deliver(StreamOpened(ends[0], sender.highest_level))

    def _refuse(self, member: SimMember) -> None:
        """End the member, and never start it again, because its store lacks entries that it has promised."""
        if not member.rolled_back:
            raise PromiseBroken(f"{member.member.member_id} is refused, although its disk has every promised entry")
        member.refused = True
        member.crash()

    def block(self, pairs: Sequence[tuple[str, str]]) -> None:
        """Let nothing pass on these connections. The senders notice it some time later, or never."""
        for ends in pairs:
            self.wires[ends].blocked = True
            if self.random_source.random() < 0.7:
                self.after(self.random_source.uniform(0.0, 3.0), lambda ends=ends: self._notice(ends))

    def _notice(self, ends: tuple[str, str]) -> None:
        if self.wires[ends].blocked:
            self.break_wire(ends)

    def unblock(self, pairs: Sequence[tuple[str, str]]) -> None:
        for ends in pairs:
            self.wires[ends].blocked = False

    def on_crash(self, member: SimMember) -> None:
        """End the connections of a crashed member. The others see them break."""
        for ends, wire in self.wires.items():
            if ends[0] == member.member.member_id:
                wire.up, wire.generation = False, wire.generation + 1
                self._stream_ends(ends)
            elif ends[1] == member.member.member_id:
                self.after(self.random_source.random() * 0.2, lambda ends=ends: self.break_wire(ends))

    def restart(self, member: SimMember) -> None:
        if member.replica is not None or member.refused:
            return
        for ends, wire in self.wires.items():
            if member.member.member_id in ends and wire.up:
                self.break_wire(ends)
        member.start()
        for ends in self.wires:
            if ends[0] == member.member.member_id:
                self._plan_connect(ends)

    # -- callers ---------------------------------------------------------------------------------------------

    def propose(self, member: SimMember, command: bytes, *, timeout: float) -> list[Outcome]:
        """Propose at a live member. The outcome appears in the returned list."""
        outcomes: list[Outcome] = []

        def done(outcome: Outcome) -> None:
            outcomes.append(outcome)
            if isinstance(outcome, bytes):
                self.history.acknowledge(command, int(outcome))
            elif isinstance(outcome, LogUnavailable):
                self.history.refuse(command)
            else:
                assert isinstance(outcome, OutcomeUnknown)

        assert member.replica is not None
        proposal = Proposal(command, self.now + timeout, lambda outcome: member.after_disk(lambda: done(outcome)))
        member.replica.propose(proposal)
        return outcomes

    def change(self, leader: SimMember, member: Member, *, is_removal: bool) -> list[ChangeOutcome]:
        """Ask a live member to add or remove another one. The outcome appears in the returned list."""
        outcomes: list[ChangeOutcome] = []

        def done(outcome: ChangeOutcome) -> None:
            outcomes.append(outcome)
            if isinstance(outcome, int) and is_removal:
                self.removed.add(member.member_id)

        assert leader.replica is not None
        member_change = MemberChange(member, is_removal, lambda outcome: leader.after_disk(lambda: done(outcome)))
        leader.replica.change_members(member_change)
        return outcomes

    def read(self, member: SimMember, *, timeout: float) -> list[int | None]:
        """Begin a confirmed read at a live member. Its result appears in the returned list."""
        before, outcomes = self.history.highest_acknowledged, []

        def done(index: int | None) -> None:
            outcomes.append(index)
            if index is not None:
                self.history.read(acknowledged_before=before, index=index)

        assert member.replica is not None
        member.replica.read(ConfirmedRead(self.now + timeout, lambda index: member.after_disk(lambda: done(index))))
        return outcomes
