"""Runs the replicated log under random faults: `python -m tests.robustness.replication.simulate --seeds 1000`.

A seed determines the whole run: `--first SEED --seeds 1` repeats a failure.
"""

from __future__ import annotations

import argparse
import random
import sys
import time
import traceback
from collections.abc import Callable
from dataclasses import fields, replace

from stampede_rt_supernode.replication.rules.elections import PreVoteElections
from stampede_rt_supernode.replication.rules.leadership_transfer import HandOver
from stampede_rt_supernode.replication.rules.snapshot_requests import SnapshotRequest
from stampede_rt_supernode.replication.settings import RaftTiming, ReplicationSettings
from tests.robustness.replication.fault_rates import FaultRates
from tests.robustness.replication.sim_member import SimMember
from tests.robustness.replication.world import World
from tests.support.supernode.list_machine import PromiseBroken

FAULT_SECONDS = 12.0
[PRODUCTION] = (one.default for one in fields(ReplicationSettings) if one.name == "snapshot_every_entries")
OFTEN = 15  # entries between two snapshots: few, so that most seeds have many snapshots
PROCESSES_MAX = 12
# A connection that stalls for longer is ended, and its messages are lost.
SILENCE_SECONDS = RaftTiming().link_silence_seconds
# After everything is healed every member must serve, and then hold everything, within this time. It is twice the
# longest time of 120 seeds. The promise for serving again, with an election, is 5 s.
HEAL_SECONDS = 8.0


def draw_fault_rates(random_source: random.Random) -> FaultRates:
    """Draw the kinds and rates of faults."""
    return FaultRates(
        loss=random_source.choice([0.0, 0.0, 0.01, 0.05, 0.2]),
        delay_mean=random_source.choice([0.001, 0.005, 0.03, 0.15]),
        reordered=random_source.choice([0.0, 0.0, 0.05, 0.3]),
        reordered_seconds=random_source.choice([0.5, 0.5, 4.0]),
        crashes=random_source.choice([0.0, 0.2, 0.6]),
        disk_seconds=random_source.choice([0.0, 0.0005, 0.005, 0.03]),
        disk_crash=random_source.choice([0.0, 0.0, 0.002, 0.01]),
        disk_hangs=random_source.choice([0.0, 0.0, 0.001]),
        partitions=random_source.choice([0.0, 0.2, 0.5]),
        freezes=random_source.choice([0.0, 0.0, 0.3]),
        link_breaks=random_source.choice([0.0, 0.3, 2.0]),
        full_links=random_source.choice([0.0, 0.0, 0.3]),
        changes=random_source.choice([0.0, 0.0, 0.5, 2.0]),
    )


class Trial:
    """Makes faults and calls in a world, until it ends."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._commands = 0
        self.over = self._outvoted = False
        fault_rates = world.fault_rates
        for rate, happen in (
            (fault_rates.crashes, self._crash),
            (fault_rates.partitions, self._partition),
            (fault_rates.isolations, self._isolate),
            (fault_rates.freezes, self._freeze),
            (fault_rates.outvotes, self._outvote),
            (fault_rates.link_breaks, self._break_wire),
            (fault_rates.changes, self._change),
            (fault_rates.snapshots, self._snapshot),
            (25.0, self._propose),
            (8.0, self._read),
        ):
            if rate > 0:
                self._repeat(rate, happen)

    def _repeat(self, rate: float, happen: object) -> None:
        def once() -> None:
            if self.over:
                return
            assert callable(happen)
            happen()
            self._repeat(rate, happen)

        self._world.after(self._world.random_source.expovariate(rate), once)

    def _some(self) -> SimMember | None:
        alive = self._world.alive()
        return self._world.random_source.choice(alive) if alive else None

    def _crash(self) -> None:
        random_source, world = self._world.random_source, self._world
        everybody = random_source.random() < 0.15
        for member in world.alive() if everybody else [self._some()]:
            if member is not None:
                member.crash()

    def _freeze(self) -> None:
        if (member := self._some()) is not None:
            member.frozen_until = self._world.now + self._world.random_source.uniform(0.2, 4.0)

    def _break_wire(self) -> None:
        if self._world.wires:
            self._world.break_wire(self._world.random_source.choice(list(self._world.wires)))

    def _partition(self) -> None:
        random_source, world = self._world.random_source, self._world
        names = list(world.members)
        if len(names) == 1:
            return
        kind = random_source.choice(["split", "one way", "bridge"])
        side = set(random_source.sample(names, random_source.randint(1, len(names) - 1)))
        if kind == "bridge":
            a, b = random_source.sample(names, 2)
            pairs = [(a, b), (b, a)]
        else:
            pairs = [(a, b) for a, b in world.wires if a in side and b not in side]
            if kind == "split":
                pairs += [(b, a) for a, b in pairs]
        world.block(pairs)
        world.after(random_source.uniform(0.3, 5.0), lambda: world.unblock(pairs))

    def _isolate(self) -> None:
        """Cut the leader off from all others. For a while it goes on to take commands, which are never committed."""
        world = self._world
        names = [name for name, one in world.members.items() if one.replica and one.replica.status().is_leader]
        pairs = [ends for ends in world.wires if set(ends) & set(names)]
        world.block(pairs)
        world.after(world.random_source.uniform(1.0, 4.0), lambda: world.unblock(pairs))

    def _outvote(self) -> None:
        """Leave the leader with one follower, whose last answers are late.

        The others elect another leader. Then the first one leads again, unless another member does. Only then the late
        answers come.
        """
        random_source, world = self._world.random_source, self._world
        leaders = self._leaders()
        if not leaders or self._outvoted:
            return
        [leader, follower] = pair = [
            leaders[0],
            random_source.choice([name for name in world.members if name != leaders[0]]),
        ]
        leader_links, follower_links = (
            [ends for ends in world.wires if name in ends and set(ends) != set(pair)] for name in pair
        )
        silent_at = world.now + random_source.uniform(0.5, 1.8)
        late_until = silent_at + random_source.uniform(0.7, 1.0) * SILENCE_SECONDS

        def fall_silent() -> None:
            if not self.over:
                world.wires[follower, leader].stalled_until = late_until

        def come_back() -> None:
            if self.over:
                return
            world.unblock(leader_links)
            world.wires[leader, follower].stalled_until = late_until + random_source.uniform(0.0, 0.5)
            self._let_lead(leader, until=late_until)

        def end() -> None:
            world.unblock([*leader_links, *follower_links])
            self._outvoted = False

        self._outvoted = True
        world.block([*leader_links, *follower_links])
        world.at(silent_at, fall_silent)
        self._when(lambda: self._leaders() not in ([], [leader]), come_back, until=late_until)
        world.at(late_until + 1.0, end)

    def _leaders(self) -> list[str]:
        return [name for name, one in self._world.members.items() if one.replica and one.replica.status().is_leader]

    def _when(self, holds: Callable[[], bool], then: Callable[[], None], *, until: float) -> None:
        """Call `then` once `holds()` is true, if that is before `until`."""
        if holds():
            then()
        elif self._world.now < until:
            self._world.after(0.05, lambda: self._when(holds, then, until=until))

    def _let_lead(self, wanted: str, *, until: float) -> None:
        """Let other leaders hand over until the member `wanted` leads, or `until` has come."""
        if not self.over and self._world.now < until and self._leaders() != [wanted]:
            self._hand_over()
            self._world.after(0.2, lambda: self._let_lead(wanted, until=until))

    def _hand_over(self) -> None:
        for member in self._world.alive():
            if member.replica is not None and member.replica.status().is_leader:
                member.replica.change_members(HandOver(lambda left: None))

    def _change(self) -> None:
        """Ask the apparent leader to add or remove a member, or to hand over."""
        random_source, world = self._world.random_source, self._world
        leaders = [each for each in world.alive() if each.replica and each.replica.status().is_leader]
        if not leaders:
            return
        leader = random_source.choice(leaders)
        assert leader.replica is not None
        members = leader.replica.status().members
        kind = random_source.choice(["add", "add", "remove", "hand over"])
        if kind == "hand over":
            self._hand_over()
        elif kind == "remove":
            world.change(leader, random_source.choice(members), is_removal=True)
        elif len(world.members) < PROCESSES_MAX:
            world.change(leader, world.volunteer(members).member, is_removal=False)
        else:
            world.change(leader, random_source.choice(list(world.members.values())).member, is_removal=False)

    def _snapshot(self) -> None:
        """Ask a member for a snapshot, as for a backup."""
        if (member := self._some()) is not None and member.replica is not None:
            member.replica.take_snapshot(SnapshotRequest(lambda outcome: None))

    def _propose(self) -> None:
        if (member := self._some()) is not None:
            self._commands += 1
            command = f"command-{self._commands}-{'x' * self._world.random_source.randint(0, 30)}"
            self._world.propose(member, command.encode(), timeout=self._world.random_source.uniform(0.2, 4.0))

    def _read(self) -> None:
        if (member := self._some()) is not None:
            self._world.read(member, timeout=self._world.random_source.uniform(0.2, 3.0))


def _revive(world: World) -> None:
    """Start crashed members again after a while, for the whole run."""
    for member in world.members.values():
        if member.replica is None and world.random_source.random() < 0.3:
            world.restart(member)
    world.after(0.4, lambda: _revive(world))


def run(seed: int, *, rules: type = PreVoteElections, lost_commits: int = 0) -> World:
    """Run one seed: faults, healing, checks. Raises PromiseBroken. `rules` and `lost_commits` plant faults."""
    random_source = random.Random(f"weather-{seed}")
    size, fault_rates, every = random_source.choice([1, 2, 3, 3, 3, 5]), draw_fault_rates(random_source), OFTEN
    if seed % 5 == 4:  # as in production: the snapshot is old, and many entries came after it
        fault_rates, every = replace(fault_rates, changes=2.0, snapshots=0.2), PRODUCTION
    elif seed % 5 == 2:  # leaders come and go, and leave entries behind that only they have
        fault_rates = replace(
            fault_rates, partitions=0.0, isolations=0.4, full_links=0.5, loss=0.0, reordered_seconds=4.0
        )
    elif seed % 5 == 3:  # messages of one tenure arrive in a later one
        size, every = 5, PRODUCTION
        fault_rates = FaultRates(delay_mean=fault_rates.delay_mean, full_links=fault_rates.full_links, outvotes=1.0)
    kept_log_bytes = (1, 4000, 100_000)[seed % 3]
    world = World(
        seed, size=size, fault_rates=fault_rates, rules=rules, snapshot_every=every, kept_log_bytes=kept_log_bytes
    )
    for member in world.members.values():
        member.disk.lost_commits = lost_commits
        member.start()
    _revive(world)
    trial = Trial(world)
    world.run_until(FAULT_SECONDS)
    trial.over = True
    heal_and_check(world)
    return world


def heal_and_check(world: World) -> None:
    """Heal everything. Then check that every member answers and that all agree.

    The healing begins only after the last late message has arrived.
    """
    stalls_end = max((wire.stalled_until for wire in world.wires.values()), default=0.0)
    late_until = max(world.now + world.fault_rates.late_seconds_max, stalls_end)
    world.fault_rates = FaultRates()
    world.unblock(list(world.wires))
    for member in world.members.values():
        member.frozen_until = 0.0
        world.restart(member)
    world.run_until(late_until)
    settled = settled_members(world, world.now + HEAL_SECONDS)
    end = world.now + HEAL_SECONDS
    for number, member in enumerate(settled):
        command, served = f"healed-{number}".encode(), False
        while not served and world.now < end:
            outcomes = world.propose(member, command, timeout=2.0)
            world.run_until(end, lambda outcomes=outcomes: bool(outcomes))
            served = bool(outcomes) and isinstance(outcomes[0], bytes)
            command += b"'"
        if not served:
            raise PromiseBroken(f"{member.member.member_id} does not serve {HEAL_SECONDS} s after everything healed")
    machines = [member.machine for member in settled]
    target = world.history.highest_acknowledged

    def caught_up() -> bool:
        return all(machine.entries and machine.entries[-1][0] >= target for machine in machines)

    if not world.run_until(end, caught_up):
        raise PromiseBroken("a member does not catch up after everything healed")
    world.run_until(world.now + 1.0)
    world.history.check_end(machines)


def settled_members(world: World, end: float) -> list[SimMember]:
    """Wait until a leader and all members agree on the members, and return them.

    Checks that no acknowledged removal is undone.
    """
    found: list[SimMember] = []

    def settled() -> bool:
        leading = [each for each in world.alive() if each.replica and each.replica.status().is_leader]
        found[:] = []
        for leader in leading:
            assert leader.replica is not None
            names = {member.member_id for member in leader.replica.status().members}
            rosters = [world.members[name].replica for name in names]
            agreed = all({m.member_id for m in each.roster.members} == names for each in rosters if each)
            if agreed and leader.replica.can_begin_change():
                found[:] = [world.members[name] for name in sorted(names)]
        return bool(found)

    if not world.run_until(end, settled):
        raise PromiseBroken(f"no leader and its members agree on the members {HEAL_SECONDS} s after everything healed")
    if back := world.removed & {member.member.member_id for member in found}:
        raise PromiseBroken(f"{back} were removed, and are members again")
    return found


def main() -> int:
    """Run many seeds, and print those that fail."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--first", type=int, default=0)
    arguments = parser.parse_args()
    failed, acknowledged, began = [], 0, time.monotonic()
    for seed in range(arguments.first, arguments.first + arguments.seeds):
        try:
            acknowledged += len(run(seed).history.acknowledged)
        except Exception:  # noqa: BLE001 - every failure is reported with its seed
            failed.append(seed)
            print(f"seed {seed} failed:", file=sys.stderr)
            traceback.print_exc()
    took = time.monotonic() - began
    print(f"{arguments.seeds} seeds, {acknowledged} acknowledged writes, {took:.0f} s; failed: {failed or 'none'}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
