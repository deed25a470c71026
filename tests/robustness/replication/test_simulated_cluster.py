"""The production replica under random faults, and planted faults of the rules that the same checks must find."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from stampede_rt_supernode.replication.interface import Member
from stampede_rt_supernode.replication.log_entries import Entry
from stampede_rt_supernode.replication.rules.elections import PreVoteElections
from stampede_rt_supernode.replication.rules.leadership_transfer import HandOver
from stampede_rt_supernode.replication.rules.member_change import ChangeOutcome
from stampede_rt_supernode.replication.rules.proposals import Outcome
from stampede_rt_supernode.replication.rules.raft_node import InvariantViolation
from stampede_rt_supernode.replication.rules.snapshot_requests import SnapshotRequest
from stampede_rt_supernode.replication.storage.snapshots import SnapshotKeeper
from stampede_rt_supernode.replication.wire.messages import InstallSnapshot, Message, VoteRequest
from tests.robustness.replication.fault_rates import FaultRates
from tests.robustness.replication.sim_member import SimMember
from tests.robustness.replication.simulate import PRODUCTION, run
from tests.robustness.replication.world import World
from tests.support.supernode.list_machine import NEWER_COMMAND, PromiseBroken

SEEDS_IN_SUITE = 40
SEEDS_IN_BLOCK = 100


@pytest.mark.parametrize("block", range(8))
def test_no_acknowledged_command_is_lost_under_random_faults(block: int) -> None:
    play(range(block, SEEDS_IN_SUITE, 8))


@pytest.mark.slow
@pytest.mark.timeout(900)  # on a busy machine; on an idle one it takes half a minute
@pytest.mark.parametrize("first", range(100_000, 102_000, SEEDS_IN_BLOCK))  # blocks, so that pytest shows progress
def test_no_acknowledged_command_is_lost_under_random_faults_of_many_seeds(first: int) -> None:
    play(range(first, first + SEEDS_IN_BLOCK))


def play(seeds: range) -> None:
    for seed in seeds:
        try:
            run(seed)
        except Exception as error:
            error.add_note(f"replay: python -m tests.robustness.replication.simulate --first {seed} --seeds 1")
            raise


def test_a_seed_gives_the_same_run_every_time() -> None:
    first, second = run(7), run(7)
    assert first.history.command_at == second.history.command_at
    assert first.history.acknowledged == second.history.acknowledged
    assert first.history.acknowledged


class RaisesTermImmediately(PreVoteElections):
    """A member that raises its term as soon as it hears no leader, like the unchanged library."""

    def before_tick(self) -> None:
        pass


def cluster_without_faults(rules: type = PreVoteElections) -> tuple[World, str, int]:
    """Three members without faults that have elected a leader. Returns the world, the leader and the term."""
    world = World(1, size=3, fault_rates=FaultRates(), rules=rules)
    for member in world.members.values():
        member.start()
    world.run_until(5.0)  # at the first election, two members may be candidates at the same time
    leader = leader_of(world)
    assert leader is not None
    return world, *leader


def leader_of(world: World) -> tuple[str, int] | None:
    statuses = [member.replica.status() for member in world.members.values() if member.replica]
    leading = [(status.self_id, status.term) for status in statuses if status.is_leader]
    return max(leading, key=lambda each: each[1]) if leading else None


@pytest.mark.parametrize(
    "rules",
    [
        PreVoteElections,
        pytest.param(RaisesTermImmediately, marks=pytest.mark.xfail(strict=True, raises=AssertionError)),
    ],
)
def test_a_member_that_cannot_hear_the_leader_does_not_end_its_leadership(rules: type) -> None:
    world, leader, term = cluster_without_faults(rules)
    deaf = next(name for name in world.members if name != leader)
    world.block([(leader, deaf), (deaf, leader)])
    world.run_until(world.now + 30.0)
    assert leader_of(world) == (leader, term)


def test_a_leader_without_a_majority_stops_leading_and_answers_no_read() -> None:
    world, leader, _ = cluster_without_faults()
    cut = [ends for ends in world.wires if leader in ends]
    world.block(cut)
    outcomes = world.read(world.members[leader], timeout=20.0)
    world.run_until(world.now + world.timing.leader_fallback_seconds + 1.0)
    replica = world.members[leader].replica
    assert replica is not None
    assert not replica.status().is_leader
    assert outcomes == []
    world.unblock(cut)
    assert world.run_until(world.now + 10.0, lambda: bool(outcomes))
    assert outcomes[0] is not None


def test_a_new_leader_serves_within_five_seconds_of_the_loss_of_the_old_one() -> None:
    for victims in (1, 3):
        world, leader, _ = cluster_without_faults()
        lost = list(world.members.values()) if victims == 3 else [world.members[leader]]
        for member in lost:
            member.crash()
        for member in lost if victims == 3 else []:
            world.restart(member)
        assert serves(world, world.alive()[0], within=5.0)


@pytest.mark.parametrize("leader_restarts", [False, True])
def test_a_member_with_an_older_copy_of_its_disk_is_refused_and_nothing_is_lost(leader_restarts: bool) -> None:
    world, name, _ = cluster_without_faults()
    leader = world.members[name]
    victim, away = (member for member in world.members.values() if member is not leader)
    former = victim.disk.copied()
    away.crash()
    for number in range(20):
        outcomes = world.propose(leader, b"%d" % number, timeout=5.0)
        assert world.run_until(world.now + 5.0, lambda outcomes=outcomes: bool(outcomes))  # type: ignore[misc]
    for member in [victim, leader] if leader_restarts else [victim]:
        member.crash()
    victim.put_back(former)
    world.restart(victim)
    world.restart(leader)
    assert world.run_until(world.now + 10.0, lambda: victim.refused)
    world.restart(away)
    after = world.propose(leader, b"after", timeout=10.0)
    assert world.run_until(world.now + 10.0, lambda: bool(after))
    assert isinstance(after[0], bytes)
    world.run_until(world.now + 2.0)
    world.history.check_end([leader.machine, away.machine])


@pytest.mark.parametrize("with_snapshot", [False, True])
def test_a_member_whose_state_differs_notices_it_and_never_leads(with_snapshot: bool) -> None:
    world = World(5, size=3, fault_rates=FaultRates(), snapshot_every=5 if with_snapshot else PRODUCTION)
    for member in world.members.values():
        member.start()
    leader = leading(world)
    older, third = (member for member in world.members.values() if member is not leader)
    older.crash()
    older.is_older = True
    world.restart(older)
    world.run_until(world.now + 3.0)
    for command in [b"before", NEWER_COMMAND, *(b"after-%d" % number for number in range(12))]:
        outcomes = world.propose(leader, command, timeout=10.0)
        assert world.run_until(world.now + 10.0, lambda outcomes=outcomes: bool(outcomes))  # type: ignore[misc]
    assert older.replica is not None
    at = world.history.acknowledged[NEWER_COMMAND]
    assert world.run_until(world.now + 2.0, lambda: older.replica.status().diverged_at > 0)  # type: ignore[union-attr]
    assert older.replica.status().diverged_at >= at
    # The log of the diverged member is sound, so its vote counts. The third member needs this vote to lead.
    leader.crash()
    assert world.run_until(world.now + 10.0, lambda: third.replica.status().is_leader)  # type: ignore[union-attr]
    assert isinstance(world.propose(third, b"served", timeout=5.0), list)
    assert world.run_until(world.now + 5.0, lambda: b"served" in world.history.acknowledged)


def under_load(world: World, *, per_second: float) -> Callable[[], None]:
    """Let the leader take commands all the time, until the returned function is called."""
    over: list[bool] = []

    def one() -> None:
        leader = leader_of(world)
        if leader is not None:
            world.propose(world.members[leader[0]], b"load-%f" % world.now, timeout=5.0)
        if not over:
            world.after(1 / per_second, one)

    one()
    return lambda: over.append(True)


def lag(world: World, member: SimMember) -> int:
    leader = leading(world).replica
    assert leader is not None
    assert member.replica is not None
    return leader.status().applied_index - member.replica.status().applied_index


class RestartsTransfers(PreVoteElections):
    """A leader that begins a transfer again with each new snapshot, and keeps no log before the last snapshot."""

    keeper: SnapshotKeeper

    def free_sent_entries(self) -> None:
        snapshot = self.log.snapshot
        if snapshot is not None and snapshot.last_log_index != getattr(self, "_last_snapshot", 0):
            self._last_snapshot = snapshot.last_log_index
            self.keeper.end_sending()
        self.log.keep_after(self.log.last_index)


@pytest.mark.parametrize(
    "rules",
    [PreVoteElections, pytest.param(RestartsTransfers, marks=pytest.mark.xfail(strict=True, raises=AssertionError))],
)
def test_a_member_that_lags_behind_a_slow_link_catches_up_under_load_though_snapshots_are_taken(rules: type) -> None:
    """The transfer of a snapshot of 12 kB takes 2 s, and the members take a snapshot every second."""
    world = World(3, size=3, fault_rates=FaultRates(), rules=rules, snapshot_every=50, kept_log_bytes=1_000_000)
    for member in world.members.values():
        member.start()
    away = next(member for member in world.members.values() if member is not leading(world))
    away.crash()
    end = under_load(world, per_second=50)
    world.run_until(world.now + 10.0)
    leader = leading(world)
    assert leader.replica is not None
    leader.replica._node.log.keep_after(10**9)  # as if the member had been away for longer
    wire = world.wires[leader.member.member_id, away.member.member_id]
    wire.bytes_per_second = 8_000
    world.restart(away)
    caught_up = world.run_until(world.now + 20.0, lambda: lag(world, away) < 50)
    end()
    assert caught_up, lag(world, away)
    assert leading(world) is leader
    world.run_until(world.now + 5.0)
    world.history.check_end([member.machine for member in world.members.values()])


class RefusesUnnamedLeaders(PreVoteElections):
    """A member that refuses a leader until another member has named that leader."""

    def on_introduced(self, member: Member) -> None:
        pass


class KnowsOnlyMembersOfSnapshot(PreVoteElections):
    """A newcomer that knows only the members of its snapshot, which may be older than its leader."""

    def open_snapshot(self) -> None:
        self._named = {}
        super().open_snapshot()

    def on_members_reported(self, reporter_id: str, members: tuple[Member, ...]) -> None:
        if any(self.peers.get(member.member_id) != member for member in members):
            super().on_members_reported(reporter_id, members)


def replaced(world: World, old: list[str], new: int) -> None:
    """Add `new` members and remove the old ones, which end. All these changes happen between two snapshots."""
    for _ in range(new):
        leader = leading(world)
        assert leader.replica is not None
        newcomer = world.volunteer(leader.replica.status().members)
        changes(world, newcomer, is_removal=False)
    for name in old:
        changes(world, world.members[name], is_removal=True)
        world.members[name].refused = True
        if world.members[name].replica is not None:
            world.members[name].crash()


def changes(world: World, member: SimMember, *, is_removal: bool) -> None:
    """Add or remove a member, through the present leader."""
    outcomes: list[ChangeOutcome] = []
    end = world.now + 30.0
    while not any(isinstance(outcome, int) for outcome in outcomes):
        assert world.now < end, outcomes
        outcomes = world.change(leading(world), member.member, is_removal=is_removal)
        world.run_until(world.now + 5.0, lambda outcomes=outcomes: bool(outcomes))  # type: ignore[misc]
        world.run_until(world.now + 0.1)


def leading(world: World) -> SimMember:
    assert world.run_until(world.now + 10.0, lambda: leader_of(world) is not None)
    leader = leader_of(world)
    assert leader is not None
    return world.members[leader[0]]


def with_snapshot(rules: type) -> World:
    """Three members that have just written snapshots, and write no more of them for a long time."""
    world = World(1, size=3, fault_rates=FaultRates(), rules=rules, snapshot_every=PRODUCTION)
    for member in world.members.values():
        member.start()
    outcomes = world.propose(leading(world), b"before", timeout=5.0)
    assert world.run_until(world.now + 5.0, lambda: bool(outcomes))
    taken: list[object] = []
    for member in world.members.values():
        assert member.replica is not None
        member.replica.take_snapshot(SnapshotRequest(taken.append))
    assert world.run_until(world.now + 5.0, lambda: len(taken) == len(world.members))
    return world


def serves(world: World, member: SimMember, within: float = 10.0) -> bool:
    """Whether a write through this member is acknowledged in time. Repeats it if its leader is lost."""
    outcomes: list[Outcome] = []
    end = world.now + within
    while world.now < end and not any(isinstance(outcome, bytes) for outcome in outcomes):
        outcomes = world.propose(member, b"%f" % world.now, timeout=5.0)
        world.run_until(end, lambda outcomes=outcomes: bool(outcomes))  # type: ignore[misc]
    return any(isinstance(outcome, bytes) for outcome in outcomes)


@pytest.mark.parametrize(
    "rules",
    [
        PreVoteElections,
        pytest.param(KnowsOnlyMembersOfSnapshot, marks=pytest.mark.xfail(strict=True, raises=AssertionError)),
    ],
)
def test_a_member_joins_after_all_members_of_the_snapshot_were_replaced(rules: type) -> None:
    world = with_snapshot(rules)
    replaced(world, ["m0", "m1", "m2"], 3)
    newcomer = world.volunteer(leading(world).replica.status().members)  # type: ignore[union-attr]
    changes(world, newcomer, is_removal=False)
    newcomer.crash()
    world.restart(newcomer)
    assert serves(world, newcomer)


@pytest.mark.parametrize(
    "rules",
    [
        PreVoteElections,
        pytest.param(RefusesUnnamedLeaders, marks=pytest.mark.xfail(strict=True, raises=AssertionError)),
    ],
)
def test_a_member_that_was_down_while_the_others_were_replaced_counts_again(rules: type) -> None:
    world = with_snapshot(rules)
    away = next(member for member in world.members.values() if member is not leading(world))
    away.crash()
    replaced(world, [name for name in world.members if name != away.member.member_id], 2)
    world.restart(away)
    assert serves(world, away)
    leading(world).crash()
    [other] = [member for member in world.alive() if member is not away]
    assert serves(world, other)


class CutsEqualEntries(PreVoteElections):
    """A member that treats late appends like the unchanged library: it also cuts entries that are equal."""

    def _merge(self, entries: list[Entry]) -> None:
        if entries and self.log.entry_at(entries[0].log_index) is not None:
            self.log.cut_from(entries[0].log_index)
        for entry in entries:
            self.log.append(*entry)


class CommitsAtSnapshotPieces(PreVoteElections):
    """A member that, like the unchanged library, commits up to the index in each piece of a snapshot."""

    def _on_install_snapshot(self, node: object, message: InstallSnapshot) -> None:
        self.raise_commit_index(min(message.commit_index, self.log.last_index))
        super()._on_install_snapshot(node, message)


class ReadsTooEarly(PreVoteElections):
    """A leader that answers reads before it has applied an entry of its own term."""

    def can_confirm_reads(self) -> bool:
        return self.is_leader


class VotesTwice(PreVoteElections):
    """A member that forgets its vote."""

    def _on_vote_request(self, node: object, message: VoteRequest) -> None:
        if not message.pre_vote:
            self.voted_for = None
        super()._on_vote_request(node, message)


class HearsMembersOnly(PreVoteElections):
    """A member that refuses a leader that is not yet in its own log."""

    def receive(self, node: object, message: Message) -> None:
        if node in self.other_voters:
            super().receive(node, message)


# The first seed saves time: the fault shows soon after it.
@pytest.mark.parametrize(
    ("fault", "first_seed"),
    [
        (CutsEqualEntries, 5),
        (CommitsAtSnapshotPieces, 15),
        (ReadsTooEarly, 5),
        (VotesTwice, 29),
        (HearsMembersOnly, 2),
    ],
)
def test_a_planted_fault_in_the_rules_is_found(fault: type, first_seed: int) -> None:
    assert any(is_caught(seed, rules=fault) for seed in range(first_seed, first_seed + 100))


def test_a_disk_that_forgets_acknowledged_writes_is_found() -> None:
    assert any(is_caught(seed, lost_commits=1) for seed in range(60))


def is_caught(seed: int, *, rules: type = PreVoteElections, lost_commits: int = 0) -> bool:
    try:
        run(seed, rules=rules, lost_commits=lost_commits)
    except (PromiseBroken, InvariantViolation):
        return True
    return False


def with_older_member(world: World, *, leads: bool) -> tuple[SimMember, SimMember]:
    """A member that does not know the command NEWER_COMMAND, and the leader. With `leads` this member is the leader."""
    older = next(iter(world.members.values()))
    older.is_older = True
    for member in world.members.values():
        member.start()
    for _ in range(50):
        leader = leading(world)
        if (leader is older) is leads:
            return older, leader
        assert leader.replica is not None
        leader.replica.change_members(HandOver(lambda left: None))
        world.run_until(world.now + 5.0, lambda leader=leader: not _leads(leader))  # type: ignore[misc]
    raise AssertionError("the member was never elected")


def _leads(member: SimMember) -> bool:
    return member.replica is not None and member.replica.status().is_leader


def diverge(world: World, older: SimMember) -> None:
    """Send the new command between two known ones, so that the members compute digests of their states."""
    other = next(one for one in world.members.values() if one is not older and one.replica is not None)
    for command in (b"before", NEWER_COMMAND, b"after"):
        outcomes = world.propose(other, command, timeout=10.0)
        assert world.run_until(world.now + 10.0, lambda outcomes=outcomes: bool(outcomes))  # type: ignore[misc]


def check_served(world: World, leader: SimMember) -> None:
    world.propose(leader, b"served", timeout=5.0)
    assert world.run_until(world.now + 5.0, lambda: b"served" in world.history.acknowledged)


def doubts(world: World) -> list[list[str]]:
    """For each running member: the members whose states it doubts."""
    return [list(one.replica.status().doubts) for one in world.members.values() if one.replica is not None]


def diverged(member: SimMember) -> bool:
    assert member.replica is not None
    return member.replica.status().diverged_at > 0


@pytest.mark.parametrize("size", [3, 5])
def test_a_leader_steps_down_if_most_members_have_another_state_and_the_others_go_on(size: int) -> None:
    world = World(6, size=size, fault_rates=FaultRates(), snapshot_every=PRODUCTION)
    older, _ = with_older_member(world, leads=True)
    diverge(world, older)
    assert world.run_until(world.now + 3.0, lambda: diverged(older))
    assert world.run_until(world.now + 1.0, lambda: any(_leads(one) for one in world.members.values()))
    other = leading(world)
    assert other is not older
    check_served(world, other)
    world.run_until(world.now + 5.0)
    assert doubts(world) == [[]] * size


@pytest.mark.parametrize("leads", [True, False])
def test_differing_states_are_in_doubt_and_all_members_go_on_while_no_majority_has_equal_states(leads: bool) -> None:
    world = World(7, size=3, fault_rates=FaultRates(), snapshot_every=PRODUCTION)
    older, leader = with_older_member(world, leads=leads)
    one, away = (member for member in world.members.values() if member is not older)
    one, away = (away, one) if away is leader else (one, away)
    away.crash()
    diverge(world, older)
    follower = one if leads else older
    assert world.run_until(world.now + 3.0, lambda: doubts(world) == [[follower.member.member_id]] * 2)
    check_served(world, one)
    assert not diverged(older)
    world.restart(away)
    assert world.run_until(world.now + 10.0, lambda: diverged(older))
    assert world.run_until(world.now + 10.0, lambda: _leads(one) or _leads(away))
    world.run_until(world.now + 3.0)
    assert doubts(world) == [[]] * 3


def test_a_doubt_ends_with_a_restart_that_ends_its_cause() -> None:
    world = World(8, size=2, fault_rates=FaultRates(), snapshot_every=PRODUCTION)
    older, _ = with_older_member(world, leads=True)
    diverge(world, older)
    assert world.run_until(world.now + 3.0, lambda: any(doubts(world)))
    older.crash()
    older.is_older = False
    world.restart(older)
    leader = leading(world)
    assert world.run_until(world.now + 10.0, lambda: not any(doubts(world)))
    check_served(world, leader)
    assert not any(doubts(world))
