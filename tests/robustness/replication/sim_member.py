"""One member of a simulated cluster: a real replica, a disk that survives crashes, and simulated connections to the
others.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Generic, TypeVar

from stampede_rt_supernode.replication.interface import Member, ReplicationStatus
from stampede_rt_supernode.replication.raft_replica import MemberRoster, RaftReplica
from stampede_rt_supernode.replication.settings import ReplicationSettings
from stampede_rt_supernode.replication.storage.store import StoredState
from stampede_rt_supernode.replication.wire.buffered_transport import (
    Outgoing,
)
from tests.robustness.replication.raft_rules import MemberPromises, check_match
from tests.support.supernode.list_machine import ListMachine, OlderListMachine, PromiseBroken
from tests.support.supernode.simulated_disk import Disk, DiskStore

if TYPE_CHECKING:
    from tests.robustness.replication.world import World

T = TypeVar("T")

# A slow connection whose last message arrives later than this takes no more pieces of snapshots and entries.
ROOM_SECONDS = 0.5


@dataclass
class Wire:
    """The connection from one member to another, as the sender sees it."""

    up: bool = False
    blocked: bool = False
    # Number of the connection. Messages of an earlier connection are lost with it.
    generation: int = 0
    last_arrival: float = 0.0
    answer_due: float = 0.0
    # Messages wait until this time, because TCP repeats lost segments.
    stalled_until: float = 0.0
    # The speed. On a slow connection no message overtakes another.
    bytes_per_second: float = float("inf")


class LateResult(Generic[T]):
    """Simulated work of another thread. It counts as done after `times` polls."""

    def __init__(self, work: Callable[[], T], times: int) -> None:
        self._work = work
        self._times = times

    def done(self) -> bool:
        self._times -= 1
        return self._times < 0

    def result(self) -> T:
        return self._work()


class SimMember:
    """One member: a disk that survives, and a replica that is started and crashed.

    It is the RaftNetwork of its replica.
    """

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
        self.promises = MemberPromises(member.member_id)
        # Whether it does not know the command `NEWER_COMMAND`, like a member of an older release.
        self.is_older = self.was_older = False
        self.machine = ListMachine(world.history)
        self.replica: RaftReplica | None = None
        self.frozen_until = 0.0
        # Whether its disk was put back to an earlier state, and whether another member has noticed that.
        self.rolled_back = self.refused = False
        self._next_step = float("inf")
        # The number of its starts; how long the present step has waited for the disk; when the last wait ends; when the
        # disk last answered.
        self._starts = 0
        self._waited = self._busy_until = self._hangs_since = 0.0
        self._checked = (0, 0)

    @property
    def now(self) -> float:
        """The time of its clock. In a step that waits for the disk, it is later than the world's time."""
        return self.world.now + self._waited

    def start(self) -> None:
        """Start from the disk, without connections."""
        self.machine = OlderListMachine(self.world.history) if self.is_older else ListMachine(self.world.history)
        self.was_older |= self.is_older  # stays True: the other members may doubt this state for a little longer
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
        """Lose everything except the data on the disk."""
        self.replica = None
        self.disk.lose_power(self.world.now, lucky=lambda: self.world.random_source.random() < 0.5)
        self.promises.check_kept(self.disk.newest)
        self.world.on_crash(self)

    def put_back(self, state: StoredState) -> None:
        """Restore a backup of its disk while it is down."""
        self.disk.put_back(state)
        self.promises, self.rolled_back = MemberPromises(self.member.member_id), True

    def hang(self, seconds: float) -> None:
        """Stop its disk for `seconds`: the log stands still, and the rest of the process goes on."""
        self._hangs_since = self.world.now
        self._busy_until = max(self._busy_until, self.world.now + seconds)

    @property
    def stuck_seconds(self) -> float:
        """The time for which it has waited for a disk that does not answer."""
        return self.world.now - self._hangs_since if self._busy_until > self.world.now else 0.0

    def refuse_release(self, by: str, why: str) -> None:
        """Note that another member has refused its release as too old."""
        raise PromiseBroken(f"{self.member.member_id} is refused, although all members have one release")

    def after_disk(self, call: Callable[[], None]) -> None:
        """Call the function once the step's waits for the disk up to now are over, unless the process ends before."""
        start = self._starts
        self.world.after(self._waited, lambda: call() if self.replica and self._starts == start else None)

    def release(self, messages: Sequence[Outgoing]) -> None:
        def leave() -> None:
            for to, message in messages:
                self.promises.note(to, message)
                self.world.send(self.member.member_id, to, message)
            # The power may fail at this moment.
            self.promises.check_kept(self.disk.durable(self.world.now))

        self.after_disk(leave)

    def follow(self, roster: MemberRoster) -> None:
        for ends in self.world.wires:
            if ends[0] == self.member.member_id and ends[1] not in roster.peers:
                self.world.break_wire(ends)

    def drop(self, member_id: str, why: str) -> None:
        """End the stream of a member that broke the rules."""
        self.world.fault(member_id, self.member.member_id, why)

    def has_room(self, member_id: str) -> bool:
        if self.world.random_source.random() < self.world.fault_rates.full_links:
            return False
        wire = self.world.wires.get((self.member.member_id, member_id), Wire())
        return wire.last_arrival < self.world.now + ROOM_SECONDS or wire.bytes_per_second == float("inf")

    def _write(self) -> tuple[float, float]:
        """Spend the time of a commit. Perhaps the power fails during it."""
        fault_rates, random_source, start, began = (
            self.world.fault_rates,
            self.world.random_source,
            self._starts,
            self.now,
        )
        seconds = random_source.expovariate(1 / fault_rates.disk_seconds) if fault_rates.disk_seconds else 0.0
        if random_source.random() < fault_rates.disk_hangs:
            seconds += random_source.uniform(0.2, 4.0)
        if random_source.random() < fault_rates.disk_crash:
            self.world.at(began + seconds * random_source.uniform(0.0, 1.1), lambda: self._lose_power(start))
        self._waited += seconds
        return began, self.now

    def _lose_power(self, start: int) -> None:
        """Cut the power, unless the process has ended since `start`, or everything was healed meanwhile."""
        if self.replica and self._starts == start and self.world.fault_rates.disk_crash:
            self.crash()

    def _plan(self, delay: float) -> None:
        at = max(self.world.now + delay, self.frozen_until, self._busy_until)
        at += self.world.random_source.random() * 0.001
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
        has_more_work = replica.step()
        self._hangs_since, self._busy_until, self._waited = self.world.now, self.now, 0.0
        self._judge(replica, roster, before)
        self._plan(0.0 if has_more_work else replica.pause_seconds())

    def _judge(self, replica: RaftReplica, roster: MemberRoster, before: ReplicationStatus) -> None:
        """Check the commits and beliefs of the member after this step against the rules of Raft."""
        status, log, committed = replica.status(), replica._log, self.world.committed
        commit_index, changed_at = log.commit_index, log.configurations.current_index
        if status.diverged_at and not self.is_older:
            raise PromiseBroken(f"{self.member.member_id} finds that its state differs at {status.diverged_at}")
        if status.doubts and not any(one.was_older for one in self.world.members.values()):
            raise PromiseBroken(f"{self.member.member_id} doubts the states of members: {dict(status.doubts)}")
        if status.is_leader:
            self.world.history.leads(self.member.member_id, status.term)
        # A leader that no member has answered for too long may commit and stop leading in one step.
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
