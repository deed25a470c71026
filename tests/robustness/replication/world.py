"""A cluster in one thread: real replicas under a false clock, network and disk, all driven by one seed."""

from __future__ import annotations

import heapq
import itertools
import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

from stampede_rt.v1 import raft_service_pb2 as pb
from stampede_rt_supernode.replication.interface import Ambiguous, LogUnavailable, Member, ReplicationStatus
from stampede_rt_supernode.replication.network.hello import TOO_OLD, introduction, newly_met
from stampede_rt_supernode.replication.raft_replica import MemberRoster, RaftReplica
from stampede_rt_supernode.replication.rules.confirmed_reads import ConfirmedRead
from stampede_rt_supernode.replication.rules.elections import PreVoteElections
from stampede_rt_supernode.replication.rules.member_changes import ChangeOutcome, MemberChange
from stampede_rt_supernode.replication.rules.proposals import Outcome, Proposal
from stampede_rt_supernode.replication.settings import RaftTiming, ReplicationSettings
from stampede_rt_supernode.replication.storage.store import StoredState
from stampede_rt_supernode.replication.wire.buffered_transport import (
    Connected,
    Disconnected,
    Introduced,
    MembersTold,
    Outgoing,
    Received,
    StreamEnded,
    StreamOpened,
)
from stampede_rt_supernode.replication.wire.codec import decode_message, encode_message
from stampede_rt_supernode.replication.wire.messages import ForwardedCommand, Message
from tests.robustness.replication.disk import Disk, DiskStore
from tests.robustness.replication.machine import History, Ignorant, ListMachine, PromiseBroken
from tests.robustness.replication.raft_rules import Committed, Said, check_match
from tests.robustness.replication.weather import Weather

T = TypeVar("T")

# A slow wire takes pieces of snapshots and entries until so much waits on it.
ROOM_SECONDS = 0.5


@dataclass
class Wire:
    """The connection from one member to another, as its sender sees it."""

    up: bool = False
    blocked: bool = False
    # Messages of an earlier connection are lost with it.
    generation: int = 0
    last_arrival: float = 0.0
    answer_due: float = 0.0
    # What is sent waits until then, as while TCP sends again and again.
    stalled_until: float = 0.0
    # How fast it is; one that is slow lets nothing overtake anything.
    bytes_per_second: float = float("inf")


class LateResult(Generic[T]):
    """Work that another thread does: finished when it was asked for some times."""

    def __init__(self, work: Callable[[], T], times: int) -> None:
        self._work = work
        self._times = times

    def done(self) -> bool:
        self._times -= 1
        return self._times < 0

    def result(self) -> T:
        return self._work()


class SimMember:
    """One member: a disk that stays, and a replica that comes and goes. It is its replica's RaftNetwork."""

    def __init__(self, world: World, member: Member, seeds: Sequence[Member], *, joining: bool = False) -> None:
        self.world = world
        self.member = member
        self.settings = ReplicationSettings(
            self_member=member,
            initial_members=seeds,
            joining=joining,
            timing=world.timing,
            cluster_id="simulated",
            snapshot_every_entries=world.snapshot_every,
            snapshot_piece_bytes=200,
            kept_log_bytes_max=world.kept_log_bytes,
        )
        self.disk = Disk()
        self.said = Said(member.member_id)
        # Whether it does not know the command `FORK`, as a member of an older release.
        self.forks = False
        self.machine = ListMachine(world.history)
        self.replica: RaftReplica | None = None
        self.frozen_until = 0.0
        # Whether the disk was put back to an earlier state, and whether another member found that out.
        self.rolled_back = self.refused = False
        self._next_step = float("inf")
        # How often it was started; for how long the present step has waited for the disk; when the last one ends.
        self._starts = 0
        self._waited = self._busy_until = self._hangs_since = 0.0
        self._checked = (0, 0)

    @property
    def now(self) -> float:
        """What its clock says: in a step that waits for the disk, later than the world's."""
        return self.world.now + self._waited

    def start(self) -> None:
        """Come up from the disk, with every connection still to be made."""
        self.machine = Ignorant(self.world.history) if self.forks else ListMachine(self.world.history)
        self._starts += 1
        self._checked, self._waited, self._hangs_since = (0, 0), 0.0, self.world.now
        self.replica = self._open()
        self._busy_until, self._waited = self.now, 0.0
        self._next_step = float("inf")
        self._plan(0.0)

    def _open(self) -> RaftReplica:
        return RaftReplica(
            self.settings,
            self.machine,
            store=DiskStore(self.disk, self._write),
            network=self,
            clock=lambda: self.now,
            random_source=random.Random(self.world.random_source.getrandbits(64)),
            wake=lambda: self._plan(0.0),
            rules=self.world.rules,
            run_in_background=self._run_in_background,
        )

    def _run_in_background(self, work: Callable[[], T], /) -> LateResult[T]:
        return LateResult(work, self.world.random_source.randint(0, 20))

    def crash(self) -> None:
        """Lose everything but what is on the disk by now."""
        self.replica = None
        self.disk.lose_power(self.world.now, lucky=lambda: self.world.random_source.random() < 0.5)
        self.said.check_kept(self.disk.newest)
        self.world.on_crash(self)

    def put_back(self, state: StoredState) -> None:
        """While it is down, somebody restores a backup of its disk."""
        self.disk.put_back(state)
        self.said, self.rolled_back = Said(self.member.member_id), True

    def hang(self, seconds: float) -> None:
        """Its disk does not answer for so long: the log stands still, and the rest of the process goes on."""
        self._hangs_since = self.world.now
        self._busy_until = max(self._busy_until, self.world.now + seconds)

    @property
    def stuck_seconds(self) -> float:
        """For how long it has waited for a disk that does not answer."""
        return self.world.now - self._hangs_since if self._busy_until > self.world.now else 0.0

    def refuse_release(self, by: str, why: str) -> None:
        """Another member has told it that its release is too old."""
        raise PromiseBroken(f"{self.member.member_id} is refused though all are of one release")

    def after_disk(self, call: Callable[[], None]) -> None:
        """Call when the step has come so far, its waiting for the disk included, unless the process ends before."""
        start = self._starts
        self.world.after(self._waited, lambda: call() if self.replica and self._starts == start else None)

    def release(self, messages: Sequence[Outgoing]) -> None:
        def leave() -> None:
            for to, message in messages:
                self.said.note(to, message)
                self.world.send(self.member.member_id, to, message)
            # The power might be lost at this very moment.
            self.said.check_kept(self.disk.durable(self.world.now))

        self.after_disk(leave)

    def follow(self, roster: MemberRoster) -> None:
        for ends in self.world.wires:
            if ends[0] == self.member.member_id and ends[1] not in roster.peers:
                self.world.break_wire(ends)

    def drop(self, member_id: str, why: str) -> None:
        """A member broke the rules: its stream ends."""
        self.world.fault(member_id, self.member.member_id, why)

    def has_room(self, member_id: str) -> bool:
        if self.world.random_source.random() < self.world.weather.full_links:
            return False
        wire = self.world.wires.get((self.member.member_id, member_id), Wire())
        return wire.last_arrival < self.world.now + ROOM_SECONDS or wire.bytes_per_second == float("inf")

    def _write(self) -> tuple[float, float]:
        """Spend the time of a commit; perhaps the power is lost within it."""
        weather, random_source, start, began = self.world.weather, self.world.random_source, self._starts, self.now
        seconds = random_source.expovariate(1 / weather.disk_seconds) if weather.disk_seconds else 0.0
        if random_source.random() < weather.disk_hangs:
            seconds += random_source.uniform(0.2, 4.0)
        if random_source.random() < weather.disk_crash:
            lost = began + seconds * random_source.uniform(0.0, 1.1)
            self.world.at(lost, lambda: self.crash() if self.replica and self._starts == start else None)
        self._waited += seconds
        return began, self.now

    def _plan(self, delay: float) -> None:
        at = max(
            self.world.now + delay + self.world.random_source.random() * 0.001, self.frozen_until, self._busy_until
        )
        if at < self._next_step:
            self._next_step = at
            replica = self.replica
            self.world.at(at, lambda: self._step(replica, at))

    def _step(self, replica: RaftReplica | None, at: float) -> None:
        if replica is None or replica is not self.replica or at != self._next_step:
            return
        self._next_step = float("inf")
        if max(self.frozen_until, self._busy_until) > self.world.now:
            self._plan(0.0)
            return
        roster, before = replica.roster, replica.status()
        again = replica.step()
        self._hangs_since, self._busy_until, self._waited = self.world.now, self.now, 0.0
        self._judge(replica, roster, before)
        self._plan(0.0 if again else self.world.timing.tick_seconds)

    def _judge(self, replica: RaftReplica, roster: MemberRoster, before: ReplicationStatus) -> None:
        """Hold what it has committed in this step against the rules of Raft."""
        status, log, committed = replica.status(), replica._log, self.world.committed
        commit_index, changed_at = log.commit_index, log.configurations.current_index
        if status.diverged_at and not self.forks:
            raise PromiseBroken(f"{self.member.member_id} finds its state another one at {status.diverged_at}")
        if status.is_leader:
            self.world.history.leads(self.member.member_id, status.term)
        # One that has heard nobody for too long commits, and leads no more, in one step.
        led = status.is_leader or (before.is_leader and before.term == status.term)
        entry = log.entry_at(commit_index)
        if commit_index <= self._checked[0]:
            pass
        elif led and entry is not None and entry.term == status.term:
            disks = {name: one.disk.durable(self.world.now) for name, one in self.world.members.items()}
            disks[self.member.member_id] = self.disk.newest
            rosters = [roster.members, replica.roster.members]
            committed.by_leader(status.term, commit_index, log, rosters, disks)
        else:
            committed.by_follower(self.member.member_id, commit_index, log)
        if status.is_leader:
            for node, match in replica._node.match_index.items():
                other = self.world.members[node.id]
                if not other.rolled_back:
                    disk = other.disk.durable(self.world.now)
                    check_match(status.term, node.id, match, log.entry_at(match), disk)
        change = log.entry_at(changed_at)
        if changed_at > self._checked[1] and status.is_leader and change is not None and change.term == status.term:
            committed.configured(status.term, changed_at)
        self._checked = (max(commit_index, self._checked[0]), changed_at)


class World:
    """Time, members and wires. `at` plans a call; `run_until` makes time pass."""

    def __init__(
        self,
        seed: int,
        *,
        size: int,
        weather: Weather,
        rules: type = PreVoteElections,
        snapshot_every: int = 15,
        kept_log_bytes: int = 1,
    ) -> None:
        self.random_source = random.Random(seed)
        self.weather = weather
        self.rules = rules
        self.snapshot_every = snapshot_every
        # By default next to nothing, so that who lags is sent snapshots.
        self.kept_log_bytes = kept_log_bytes
        self.now = 0.0
        self.timing = RaftTiming(tick_seconds=0.05)
        self.history = History()
        self.committed = Committed()
        # Whether hostile peers are about, of whose words members may repeat something.
        self.may_be_misled = False
        self._events: list[tuple[float, int, Callable[[], None]]] = []
        self._order = itertools.count()
        roster = [Member(member_id=f"m{number}", address=f"m{number}:1") for number in range(size)]
        self.members: dict[str, SimMember] = {}
        self.wires: dict[tuple[str, str], Wire] = {}
        # Ids of members whose removal was acknowledged.
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
        """A new process that wants to be a member, and was told who the members are."""
        name = f"m{len(self.members)}"
        newcomer = self._newcomer(Member(member_id=name, address=f"{name}:1"), seeds)
        newcomer.disk.forgets = next(iter(self.members.values())).disk.forgets
        self._place(newcomer)
        newcomer.start()
        return newcomer

    def at(self, when: float, call: Callable[[], None]) -> None:
        heapq.heappush(self._events, (when, next(self._order), call))

    def after(self, delay: float, call: Callable[[], None]) -> None:
        self.at(self.now + delay, call)

    def run_until(self, end: float, until: Callable[[], bool] = lambda: False) -> bool:
        """Let time pass; True as soon as `until` holds, False when the end came first."""
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
        wire = self.wires.get((sender, to), Wire())  # to outsiders there is none
        if not wire.up or wire.blocked or self.random_source.random() < self.weather.loss:
            return
        data, generation = encode_message(message).SerializeToString(), wire.generation
        arrival = max(self.now, wire.stalled_until) + self.random_source.expovariate(1 / self.weather.delay_mean)
        if wire.bytes_per_second < float("inf"):
            arrival = max(arrival, wire.last_arrival) + len(data) / wire.bytes_per_second
        if self.random_source.random() < self.weather.unruly:
            arrival += self.random_source.random() * self.weather.unruly_seconds
            if not isinstance(message, ForwardedCommand) and self.random_source.random() < 0.5:
                again = self.now + self.random_source.random() * self.weather.late_seconds_max
                self.at(again, lambda: self._arrive(sender, to, generation, data))
        else:
            arrival = wire.last_arrival = max(arrival, wire.last_arrival)
        self.at(arrival, lambda: self._arrive(sender, to, generation, data))

    def _arrive(self, sender: str, to: str, generation: int, data: bytes) -> None:
        replica = self.members[to].replica
        if replica is not None and self.wires[sender, to].generation == generation:
            replica.deliver(Received(sender, decode_message(pb.RaftMessage.FromString(data))))
            self._answer(sender, to, replica)

    def _answer(self, sender: str, to: str, receiver: RaftReplica) -> None:
        """As the stream does: every half second in which something came, the sender is told who the members are."""
        wire, replica = self.wires[sender, to], self.members[sender].replica
        if replica is not None and wire.up and not self.wires[to, sender].blocked and self.now > wire.answer_due:
            wire.answer_due = self.now + 0.5
            replica.deliver(MembersTold(to, receiver.roster.members))

    def fault(self, sender: str, receiver: str, why: str) -> None:
        """No member that keeps to the rules is ever found to break them."""
        if sender in self.members and not self.may_be_misled:
            raise PromiseBroken(f"{receiver} finds {sender} at fault: {why}")

    def break_wire(self, ends: tuple[str, str]) -> None:
        """The connection is gone, with what is on it; its sender notices and connects again."""
        wire = self.wires[ends]
        if not wire.up:
            return
        wire.up = False
        wire.generation += 1
        replica = self.members[ends[0]].replica
        if replica is not None:
            replica.deliver(Disconnected(ends[1]))
        self._stream_ends(ends)
        self._plan_connect(ends)

    def _stream_ends(self, ends: tuple[str, str]) -> None:
        """The receiver notices at once or a while later, unless a new connection comes first."""
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
        if ends[1] not in sender.roster.peers or ends[0] in receiver.roster.removed:
            self._plan_connect(ends)
            return
        if sender.highest_level < receiver.feature_level:
            self._plan_connect(ends)
            self.members[ends[0]].refuse_release(ends[1], f"{ends[0]!r} {TOO_OLD}")
            return
        if not receiver.promise_of(ends[0]).is_kept_by(*sender.standing):
            self._refuse(self.members[ends[0]])
            return
        sender.deliver(MembersTold(ends[1], receiver.roster.members))
        if ends[0] not in receiver.roster.peers:
            settings = self.members[ends[0]].settings
            hello = introduction(
                settings,
                ends[1],
                store_id="",
                standing=sender.standing,
                roster=sender.roster,
                highest_level=sender.highest_level,
            )
            if (met := newly_met(hello, self.members[ends[1]].settings)) is not None:
                receiver.deliver(Introduced(met.member_id, met))
            self._plan_connect(ends)
            return
        wire.up = True
        sender.deliver(Connected(ends[1]))
        receiver.deliver(StreamOpened(ends[0], sender.highest_level))

    def _refuse(self, member: SimMember) -> None:
        """Its store lacks what it has promised: it ends, for good."""
        if not member.rolled_back:
            raise PromiseBroken(f"{member.member.member_id} is refused though its disk kept what it should")
        member.refused = True
        member.crash()

    def block(self, pairs: Sequence[tuple[str, str]]) -> None:
        """Nothing passes on these wires; their senders notice some time later, or never."""
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
        """The others see their connections break; its own are gone without a word."""
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
        """Propose on a live member; the outcome appears in the list returned."""
        outcomes: list[Outcome] = []

        def done(outcome: Outcome) -> None:
            outcomes.append(outcome)
            if isinstance(outcome, bytes):
                self.history.acknowledge(command, int(outcome))
            elif isinstance(outcome, LogUnavailable):
                self.history.refuse(command)
            else:
                assert isinstance(outcome, Ambiguous)

        assert member.replica is not None
        later = Proposal(command, self.now + timeout, lambda outcome: member.after_disk(lambda: done(outcome)))
        member.replica.propose(later)
        return outcomes

    def change(self, leader: SimMember, member: Member, *, is_removal: bool) -> list[ChangeOutcome]:
        """Ask a live member to let another one come or go; the outcome appears in the list returned."""
        outcomes: list[ChangeOutcome] = []

        def done(outcome: ChangeOutcome) -> None:
            outcomes.append(outcome)
            if isinstance(outcome, int) and is_removal:
                self.removed.add(member.member_id)

        assert leader.replica is not None
        later = MemberChange(member, is_removal, lambda outcome: leader.after_disk(lambda: done(outcome)))
        leader.replica.change_members(later)
        return outcomes

    def read(self, member: SimMember, *, timeout: float) -> list[int | None]:
        """Begin a confirmed read on a live member; what it gave appears in the list returned."""
        before, outcomes = self.history.highest_acknowledged, []

        def done(index: int | None) -> None:
            outcomes.append(index)
            if index is not None:
                self.history.read(acknowledged_before=before, index=index)

        assert member.replica is not None
        member.replica.read(ConfirmedRead(self.now + timeout, lambda index: member.after_disk(lambda: done(index))))
        return outcomes
