"""Hostile peers with valid credentials, whose actions a seed decides: outsiders that claim to be members, and members
that lie.

An outsider does the cluster no harm. A lying member may break the rules on which Raft rests, so its victim's state may
become wrong. But no lie ends a process, and the victim can still open its store.
"""

from __future__ import annotations

import os
import random
from collections.abc import Sequence
from pathlib import Path

import pytest

from stampede_rt.v1 import raft_service_pb2 as pb
from stampede_rt_supernode.replication.arrivals import InboxFull
from stampede_rt_supernode.replication.interface import Member
from stampede_rt_supernode.replication.raft_replica import MemberRoster, RaftReplica
from stampede_rt_supernode.replication.rules.confirmed_reads import ConfirmedRead
from stampede_rt_supernode.replication.rules.proposals import Proposal
from stampede_rt_supernode.replication.settings import RaftTiming, ReplicationSettings
from stampede_rt_supernode.replication.storage.sqlite_store import SqliteStore
from stampede_rt_supernode.replication.wire.buffered_transport import (
    LinkConnected,
    MembersReported,
    MessageReceived,
    NodeIntroduced,
    Outgoing,
    StreamOpened,
)
from stampede_rt_supernode.replication.wire.codec import decode_message
from stampede_rt_supernode.replication.wire.messages import ForwardedCommand, ReadIndexRequest
from stampede_rt_supernode.replication.wire.records import MalformedMessage
from tests.robustness.replication.fault_rates import FaultRates
from tests.robustness.replication.hostile_messages import FalseMessages
from tests.robustness.replication.raft_rules import CommittedEntries
from tests.robustness.replication.simulate import Trial, draw_fault_rates, heal_and_check
from tests.robustness.replication.world import World
from tests.support.supernode.list_machine import History, ListMachine

SEEDS = range(int(os.environ.get("STAMPEDE_HOSTILE_SEEDS", "15")))
MESSAGES = 400


class VictimNetwork:
    """The victim's network. It notes the dropped streams, and sends nothing."""

    def __init__(self) -> None:
        self.dropped: list[str] = []
        # The ids of the requests without an answer.
        self.request_ids: list[int] = []

    def release(self, messages: Sequence[Outgoing]) -> None:
        """Send nothing: no peer gives a true answer."""
        for _, message in messages:
            if isinstance(message, ForwardedCommand | ReadIndexRequest):
                self.request_ids = [*self.request_ids[-20:], message.request_id]

    def has_room(self, member_id: str) -> bool:
        """Always true."""
        return True

    def drop(self, member_id: str, why: str) -> None:
        """Note that the victim has dropped a member at fault."""
        self.dropped.append(member_id)

    def follow(self, roster: MemberRoster) -> None:
        """Do nothing: all are connected."""


class UncheckedHistory(History):
    """A history without checks, because a hostile leader may make the victim's state wrong."""

    def applied(self, index: int, command: bytes) -> None:
        """Do nothing."""

    def acknowledge(self, command: bytes, index: int) -> None:
        """Do nothing: a misled member may acknowledge a command that is not committed."""

    def read(self, *, acknowledged_before: int, index: int) -> None:
        """Do nothing."""

    def leads(self, member_id: str, term: int) -> None:
        """Do nothing."""


class UncheckedRules(CommittedEntries):
    """The rules without checks, because a misled member may commit wrong entries."""

    def by_leader(self, *facts: object) -> None:  # type: ignore[override]
        """Do nothing."""

    def by_follower(self, *facts: object) -> None:  # type: ignore[override]
        """Do nothing."""

    def configured(self, *facts: object) -> None:  # type: ignore[override]
        """Do nothing."""


class UncheckedMachine(ListMachine):
    """A state machine that a hostile leader may set back."""

    def apply(self, index: int, command: bytes) -> bytes:
        """Apply any bytes, without a check of the former state."""
        self.entries.append((index, command.hex().encode()))
        return b"%d" % index


class Victim:
    """Member `a` of `a`, `b` and `c`, with a store on a disk, and a clock that the test moves."""

    def __init__(self, random_source: random.Random, folder: Path) -> None:
        self._random_source, self._folder = random_source, folder
        members = [Member(member_id=name, address=f"{name}:1") for name in "abc"]
        self._settings = ReplicationSettings(
            self_member=members[0],
            initial_members=members,
            timing=RaftTiming(),
            snapshot_every_entries=20,
            snapshot_piece_bytes=100,
        )
        self.now, self.network = 100.0, VictimNetwork()
        self.replica = self._open()

    def _open(self) -> RaftReplica:
        replica = RaftReplica(
            self._settings,
            UncheckedMachine(UncheckedHistory()),
            store=SqliteStore(self._folder, cluster_id="", member_id="a", create=True),
            network=self.network,
            clock=lambda: self.now,
            random_source=self._random_source,
        )
        for name in "bc":
            replica.deliver(LinkConnected(name))
            replica.deliver(StreamOpened(name))
        return replica

    def deliver(self, sender: str, message: pb.RaftMessage) -> None:
        """Take a message as the servicer does: an unreadable or too large one ends the stream."""
        try:
            decoded = decode_message(pb.RaftMessage.FromString(message.SerializeToString()))
            self.replica.deliver(MessageReceived(sender, decoded, message.ByteSize()))
        except (MalformedMessage, InboxFull):
            self.replica.deliver(StreamOpened(sender))

    def step(self) -> None:
        """Let a little time pass. Perhaps a caller makes a call."""
        self.now += self._random_source.choice((0.001, 0.03, 0.5))
        if self._random_source.random() < 0.3:
            self.replica.propose(Proposal(self._random_source.randbytes(8), self.now + 1.0, lambda outcome: None))
            self.replica.read(ConfirmedRead(self.now + 1.0, lambda index: None))
        self.replica.step()

    def restart(self) -> None:
        """End, and start from the disk."""
        self.replica.close()
        self.replica = self._open()


@pytest.mark.parametrize("seed", SEEDS)
def test_no_message_of_a_member_ends_a_process_or_spoils_its_store(seed: int, tmp_path: Path) -> None:
    random_source = random.Random(f"hostile-{seed}")
    victim = Victim(random_source, tmp_path)
    for _ in range(MESSAGES):
        victim.deliver(
            random_source.choice("bbc"),
            FalseMessages(random_source, victim.replica, victim.network.request_ids).message(),
        )
        if random_source.random() < 0.5:
            victim.step()
        if random_source.random() < 0.01:
            victim.restart()
    victim.restart()
    victim.replica.close()
    assert victim.replica._node.callers_waiting_count() <= 1000
    assert len(victim.replica._log.promises) <= 64


class Outsider:
    """A caller with valid credentials that is not a member.

    It introduces itself, and sends false messages to each member that counts it as a peer.
    """

    def __init__(self, world: World) -> None:
        self._world = world
        self._random_source = random.Random(f"outsider-{world.random_source.random()}")
        self.over = False
        self.received = 0

    def begin(self) -> None:
        """Send something to a member every few milliseconds."""
        if self.over:
            return
        for member in self._world.alive():
            assert member.replica is not None
            self._bother(member.replica)
        self._world.after(self._random_source.uniform(0.005, 0.05), self.begin)

    def _bother(self, replica: RaftReplica) -> None:
        name = f"outsider{self._random_source.randint(0, 40)}"
        member = Member(member_id=name, address=f"{name}:1")
        if name not in replica.roster.peers:  # as in production: a refused hello names its sender
            replica.deliver(NodeIntroduced(name, member))
            return
        self.received += 1
        replica.deliver(LinkConnected(name))
        replica.deliver(StreamOpened(name))
        replica.deliver(MembersReported(name, (member, Member(member_id=f"{name}'", address="elsewhere:1"))))
        try:
            message = FalseMessages(self._random_source, replica).message()
            replica.deliver(
                MessageReceived(name, decode_message(pb.RaftMessage.FromString(message.SerializeToString())))
            )
        except (MalformedMessage, InboxFull):
            pass


@pytest.mark.parametrize("seed", SEEDS)
def test_callers_that_are_not_members_cannot_stop_the_cluster(seed: int) -> None:
    world = World(seed, size=3, fault_rates=FaultRates())
    for member in world.members.values():
        member.start()
    outsider, trial = Outsider(world), Trial(world)
    outsider.begin()
    assert world.run_until(5.0, lambda: any(one.replica and one.replica.status().is_leader for one in world.alive()))
    world.run_until(world.now + 2.0)  # two members may win their pre-votes together; then the later candidate leads
    [leader] = [one for one in world.alive() if one.replica and one.replica.status().is_leader]
    assert leader.replica is not None
    term, acknowledged = leader.replica.status().term, len(world.history.acknowledged)
    world.run_until(world.now + 20.0)
    status = leader.replica.status()
    assert (status.is_leader, status.term) == (True, term)
    assert len(world.history.acknowledged) > acknowledged + 100
    assert outsider.received == 0
    outsider.over = trial.over = True
    heal_and_check(world)


@pytest.mark.parametrize("seed", SEEDS)
def test_members_that_outsiders_have_misled_find_each_other_after_a_restart(seed: int) -> None:
    """A member that is cut off may listen to outsiders. No process ends, and the members find each other again."""
    world = World(seed, size=3, fault_rates=draw_fault_rates(random.Random(seed)))
    world.history, world.committed, world.may_be_misled = UncheckedHistory(), UncheckedRules(), True
    for member in world.members.values():
        member.start()
    outsider = Outsider(world)
    outsider.begin()
    world.run_until(8.0)
    outsider.over = True
    world.fault_rates = FaultRates()
    for member in world.members.values():
        world.restart(member)
    ends = world.now + 20.0
    assert world.run_until(ends, lambda: any(one.replica and one.replica.status().is_leader for one in world.alive()))
