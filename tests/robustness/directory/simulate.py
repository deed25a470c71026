"""The whole directory under random faults: `python -m tests.robustness.directory.simulate --seeds 200`.

Production code: the replicated log, the state machine, leases, the service, and the hosts' lease and channel store.
Simulated: time, network, disks, clocks that drift, and wall clocks that are set. A seed determines the whole run:
`--first SEED --seeds 1` repeats a failure.
"""

from __future__ import annotations

import argparse
import hashlib
import logging
import random
import sys
import time
import traceback
from collections.abc import Callable
from dataclasses import replace
from typing import Any
from unittest import mock

from stampede_rt.errors import StampedeError
from stampede_rt_supernode.servicers.lease_keeper import LeaseKeeper
from tests.robustness.directory.calls import FINAL, QUEUES, host_id_of, refusal_of, request_of, shown
from tests.robustness.directory.host import Ownership, SimHost
from tests.robustness.directory.peer import NameOwnership, SimPeer
from tests.robustness.directory.tasks import drive
from tests.robustness.directory.world import LEASE_TTL_NANOS, DirectoryWorld, _Leases
from tests.robustness.histories.channel_model import (
    Delete,
    DeletedChannel,
    Open,
    Resolve,
    SeenChannel,
    Update,
    acknowledged_writes,
    check_channel_histories,
)
from tests.robustness.histories.operations import Recorder
from tests.robustness.replication.fault_rates import FaultRates
from tests.robustness.replication.simulate import draw_fault_rates
from tests.robustness.replication.world import TIMING
from tests.robustness.report import SimulatedRuns
from tests.support.supernode.list_machine import PromiseBroken

FAULT_SECONDS, HEAL_SECONDS = 30.0, 12.0
CALLERS, QUEUE_CALLERS, HOSTS, PEERS, NAMES = 8, 2, 3, 3, 4
# With this TTL, hosts still renew in time at the successor of a leader whose disk hangs. The hanging leader still
# believes that it leads. It counts a host as lost if the last renewal that it knows was a while ago.
LONG_TTL_NANOS = 40 * 10**8
# The successor leads before the leases that hosts have from the hanging leader end.
SOON_SUCCEEDED = replace(TIMING, election_timeout_min_seconds=0.4, election_timeout_max_seconds=0.8)
NOT_DONE_REASONS = ("NO_QUORUM", "NO_HOST", "NOT_LEADER")


class Caller:
    """One sequential caller in simulated time, see `tests.robustness.real_cluster.callers.Caller`."""

    def __init__(self, number: int, trial: DirectoryTrial) -> None:
        self._trial, self._world = trial, trial.world
        self._value = 1_000_000 * (number + 1)
        self._prefix = "sim/" if number < CALLERS else QUEUES
        self._seen: dict[str, SeenChannel] = {}
        self._host_of: dict[str, bytes] = {}

    async def run(self) -> None:
        self._trial.calling += 1
        while not self._trial.over:
            name = f"{self._prefix}{int(self._world.now / 3)}-{self._world.random_source.randrange(NAMES)}"
            await self._once(name)
            await self._world.sleep(self._world.random_source.expovariate(1 / 0.04))
        self._trial.calling -= 1

    async def _once(self, name: str) -> None:
        call, invoked, recorder = self._choose(name), self._world.now, self._trial.recorder
        answer = await self._answer(name, call)
        if answer is None:
            recorder.ambiguous(name, call, invoked)
        elif not isinstance(answer, StampedeError):
            recorder.done(name, call, invoked, answer)
        if isinstance(answer, SeenChannel):
            self._seen[name] = answer
            if not name.startswith(QUEUES):
                self._trial.put(self._host_of[name], answer)
        elif not isinstance(answer, StampedeError):
            self._seen.pop(name, None)

    def _choose(self, name: str) -> Open | Resolve | Update | Delete:
        chance, seen = self._world.random_source.random(), self._seen.get(name)
        if seen is None or chance < 0.2:
            return Open(0) if chance < 0.7 else Resolve()
        if chance < 0.5:
            return Resolve()
        if chance > 0.95:
            return Delete(seen.channel_id)
        self._value += 1
        return Update(seen.channel_id, seen.epoch, self._value)

    async def _answer(self, name: str, call: Open | Resolve | Update | Delete) -> object:
        """The answer for the history; None: unknown; a StampedeError: the call certainly had no effect."""
        method, request = request_of(name, call, self._world.random_source)
        outcome = await self._persist(method, request)
        if isinstance(outcome, StampedeError) and outcome.reason in FINAL:
            return refusal_of(outcome.reason)
        if outcome is None or isinstance(outcome, StampedeError):
            return outcome
        if isinstance(call, Delete):
            return DeletedChannel()
        self._host_of[name] = host_id_of(name, outcome)
        return shown(name, outcome)

    async def _persist(self, method: str, request: Any) -> Any:
        began, unknown = self._world.now, False
        deadline = began + self._world.random_source.uniform(1, 6)
        outcome: Any = None
        while (left := deadline - self._world.now) > 0:
            member = self._world.random_source.choice(list(self._world.members.values()))
            age_s = self._world.now - began
            outcome = await self._world.call(member, method, request, min(left, 1.5), age_s=age_s)
            if outcome is None:
                unknown = True
            elif not isinstance(outcome, StampedeError) or outcome.reason in FINAL:
                return outcome
            else:
                unknown |= outcome.reason not in NOT_DONE_REASONS
            await self._world.sleep(self._world.random_source.uniform(0.02, 0.3))
        return None if unknown else outcome


class DirectoryTrial:
    """Makes faults and calls, and runs hosts, until the world ends."""

    def __init__(self, world: DirectoryWorld) -> None:
        self.world, self.over = world, False
        self.calling = 0  # the callers that have not ended
        self.recorder = Recorder(lambda: world.now)
        self.ownership = Ownership()
        self._hosts = [SimHost(world, number, self.ownership) for number in range(HOSTS)]
        self.name_ownership = NameOwnership(world)
        self._peers = [SimPeer(world, number, self.name_ownership) for number in range(PEERS)]
        for number in range(CALLERS + QUEUE_CALLERS):
            drive(Caller(number, self).run)
        fault_rates = world.fault_rates
        long = world.lease_ttl_nanos == LONG_TTL_NANOS
        for rate, happen in (
            (fault_rates.crashes, self._crash),
            (fault_rates.partitions, self._partition),
            (fault_rates.freezes, self._freeze),
            (fault_rates.link_breaks, lambda: world.break_wire(world.random_source.choice(list(world.wires)))),
            (0.0 if long else 0.15, self._cut_leader_off),
            (0.2 if long else 0.15, self._hang_before_a_renewal if long else self._hang_leader),
            (0.3, self._set_wall_clock),
            (0.15, lambda: world.random_source.choice(self._hosts).restart()),
            (0.0 if long else 0.3, self._freeze_host),
            (0.15, lambda: world.random_source.choice(self._peers).restart()),
            (0.15, self._delay_registration),
        ):
            if rate > 0:
                self._repeat(rate, happen)

    def put(self, host_id: bytes, seen: SeenChannel) -> None:
        """Put twice at the owner that the caller knows. A put may arrive late, when the channel has another owner."""
        owner = next((host for host in self._hosts if host.identity.host_id == host_id), None)
        for _ in range(2):
            delay = self.world.trip()
            if owner is not None and delay is not None:
                later = delay + self.world.random_source.choice([0.0, 0.0, self.world.random_source.uniform(0, 6)])
                self.world.after(later, lambda: owner.put(seen.channel_id, seen.epoch))

    def _repeat(self, rate: float, happen: Callable[[], None]) -> None:
        def once() -> None:
            if not self.over:
                happen()
                self._repeat(rate, happen)

        self.world.after(self.world.random_source.expovariate(rate), once)

    def _crash(self) -> None:
        alive, everybody = self.world.alive(), self.world.random_source.random() < 0.15
        for member in alive if everybody else alive and [self.world.random_source.choice(alive)]:
            member.crash()

    def _freeze(self) -> None:
        if alive := self.world.alive():
            self.world.random_source.choice(alive).frozen_until = self.world.now + self.world.random_source.uniform(
                0.2, 4.0
            )

    def _freeze_host(self) -> None:
        frozen: Any = self.world.random_source.choice([*self._hosts, *self._peers])
        frozen.frozen_until = self.world.now + self.world.random_source.uniform(0.2, 5.0)

    def _cut_leader_off(self) -> None:
        """Cut the leader off from the other supernodes.

        In half of the cases hosts and peers cannot reach the leader either. In the other half two of them reach only
        the leader.

        In this second half the leader may also freeze, and go on as if no time had passed.
        """
        random_source, world = self.world.random_source, self.world
        leaders = self._leaders()
        pairs = [ends for ends in world.wires if not set(ends).isdisjoint(leaders)]
        callers: list[Any] = [*self._hosts, *self._peers]
        with_it = set() if random_source.random() < 0.5 else set(random_source.sample(callers, 2))
        ways = {(one, name) for one in callers for name in world.members if (one in with_it) != (name in leaders)}
        seconds = random_source.uniform(1.5, 6.0)
        world.block(pairs)
        world.unreachable |= ways
        if with_it and random_source.random() < 0.7:
            for name in leaders:
                world.members[name].frozen_until = world.now + seconds * random_source.uniform(0.5, 1.0)

        def heal() -> None:
            world.unblock(pairs)
            world.unreachable -= ways

        world.after(seconds, heal)

    def _hang_leader(self) -> None:
        """Let the leader's disk hang. The leader goes on to answer callers, and counts itself as the leader for a
        while.

        Two hosts or peers reach only this leader meanwhile, so its successor counts them as lost. If leases are long,
        all reach its successor, and the hanging leader counts them as lost.
        """
        random_source, world = self.world.random_source, self.world
        leaders, long = self._leaders(), world.lease_ttl_nanos == LONG_TTL_NANOS
        apart = [] if long else random_source.sample([*self._hosts, *self._peers], 2)
        ways: set[tuple[object, str]] = {(one, name) for one in apart for name in world.members if name not in leaders}
        seconds = random_source.uniform(2.9, 3.6) if long else random_source.uniform(2.0, 6.0)
        for name in leaders:
            world.members[name].hang(seconds)
        world.unreachable |= ways
        world.after(seconds, lambda: world.unreachable.difference_update(ways))

    def _hang_before_a_renewal(self) -> None:
        """Let the leader's disk hang just before a host renews, when the last renewal was a while ago."""
        host = self.world.random_source.choice(self._hosts)
        due_s = host.lease.renewal_in_nanos(host.clock.boottime_nanos()) / 1e9
        self.world.after(max(0.0, due_s - 0.05), self._hang_leader)

    def _delay_registration(self) -> None:
        """Kill a host or peer while it registers, and start it again. Its former request arrives after the new
        registration.

        The former request is the first request of the process, or the request with the number that the process took
        after it learned of its predecessor.
        """
        random_source, world = self.world.random_source, self.world
        one: Any = random_source.choice([*self._hosts, *self._peers])
        one.restart()
        world.hold_registrations(one, random_source.choice([0, 1]))

        def start_again() -> None:
            held = world.held_registrations(one)
            one.restart()
            for arrive in held:
                world.after(random_source.uniform(0.1, 4.0), arrive)

        world.after(random_source.uniform(0.1, 1.5), start_again)

    def _leaders(self) -> list[str]:
        return [name for name, one in self.world.members.items() if one.replica and one.replica.status().is_leader]

    def _set_wall_clock(self) -> None:
        machine: Any = self.world.random_source.choice([*self.world.members.values(), *self._hosts, *self._peers])
        machine.clock.wall_offset_nanos = int(self.world.random_source.uniform(-1e18, 1e18))

    def _partition(self) -> None:
        random_source, world = self.world.random_source, self.world
        names = list(world.members)
        side = set(random_source.sample(names, random_source.randint(1, len(names) - 1)))
        kind = random_source.choice(["split", "one way", "bridge"])
        pairs = [(a, b) for a, b in world.wires if a in side and b not in side]
        if kind == "bridge":
            pairs = pairs[:1]
        if kind != "one way":
            pairs += [(b, a) for a, b in pairs]
        world.block(pairs)
        world.after(random_source.uniform(0.3, 5.0), lambda: world.unblock(pairs))


def run(seed: int, *, leases: type[LeaseKeeper] = _Leases, lost_commits: int = 0) -> DirectoryTrial:
    """Run one seed: faults, healing, checks. Raises PromiseBroken or NotLinearizable. `leases` and `lost_commits` plant
    faults.
    """
    random_source = random.Random(f"directory-{seed}")
    size, fault_rates = random_source.choice([3, 3, 3, 5]), draw_fault_rates(random_source)
    if seed % 5 in (1, 3):
        # Among the supernodes only leaders have faults, so that others succeed them. With 1 leaders hang. With 3 they
        # hang or are cut off.
        fault_rates = FaultRates(delay_mean=fault_rates.delay_mean)
    ttl_nanos, timing = (LONG_TTL_NANOS, SOON_SUCCEEDED) if seed % 5 == 1 else (LEASE_TTL_NANOS, TIMING)
    world = DirectoryWorld(
        seed, size=size, fault_rates=fault_rates, leases=leases, lease_ttl_nanos=ttl_nanos, timing=timing
    )
    with (
        mock.patch("secrets.token_bytes", world.random_source.randbytes),
        mock.patch("secrets.randbits", world.random_source.getrandbits),
        mock.patch("secrets.token_hex", lambda count: world.random_source.randbytes(count).hex()),
    ):
        for member in world.members.values():
            member.disk.lost_commits = lost_commits
            member.start()
        _revive(world)
        trial = DirectoryTrial(world)
        world.run_until(FAULT_SECONDS)
        trial.over = True
        _heal_and_check(trial)
    check_channel_histories(trial.recorder.operations)
    return trial


def digest_of(trial: DirectoryTrial) -> str:
    """A hash of the whole run. Runs that differ anywhere have other random numbers from then on."""
    random_state = trial.world.random_source.getstate()
    happened = (trial.recorder.operations, trial.ownership.puts, trial.name_ownership.grants, random_state)
    return hashlib.sha256(repr(happened).encode()).hexdigest()


def _revive(world: DirectoryWorld) -> None:
    for member in world.members.values():
        if member.replica is None and world.random_source.random() < 0.3:
            world.restart(member)
    world.after(0.4, lambda: _revive(world))


def _heal_and_check(trial: DirectoryTrial) -> None:
    """Heal everything. Then read every name at every supernode, as a part of the history."""
    world = trial.world
    world.fault_rates = FaultRates()
    world.unblock(list(world.wires))
    world.unreachable.clear()
    for member in world.members.values():
        member.frozen_until = 0.0
        world.restart(member)
    names = sorted({operation.key for operation in trial.recorder.operations})
    waiting: set[tuple[str, str]] = set()
    for member in world.members.values():
        for name in names:
            waiting.add((member.member.member_id, name))
            drive(lambda member=member, name=name: _read_until_answered(trial, member, name, waiting))
    if not world.run_until(world.now + HEAL_SECONDS, lambda: not waiting and not trial.calling):
        raise PromiseBroken(
            f"{len(waiting)} reads and {trial.calling} callers got no answer {HEAL_SECONDS} s after everything healed"
        )


async def _read_until_answered(trial: DirectoryTrial, member: Any, name: str, waiting: set[tuple[str, str]]) -> None:
    world = trial.world
    while True:
        invoked = world.now
        method, request = request_of(name, Resolve(), world.random_source)
        outcome = await world.call(member, method, request, 2.0)
        refused = isinstance(outcome, StampedeError)
        if outcome is not None and (not refused or outcome.reason in FINAL):
            answer = refusal_of(outcome.reason) if refused else shown(name, outcome)
            trial.recorder.done(name, Resolve(), invoked, answer)
            waiting.discard((member.member.member_id, name))
            return
        await world.sleep(0.1)


def run_seeds(first: int, count: int) -> SimulatedRuns:
    """Run many seeds, and print the failed ones with their errors on stderr."""
    logging.disable(logging.WARNING)  # services warn of the injected faults
    failed, operations, acknowledged, puts, began = [], 0, 0, 0, time.monotonic()
    for seed in range(first, first + count):
        try:
            trial = run(seed)
        except Exception:  # noqa: BLE001 - every failure is reported with its seed
            failed.append(seed)
            print(f"seed {seed} failed:", file=sys.stderr)
            traceback.print_exc()
            continue
        operations += len(trial.recorder.operations)
        acknowledged += acknowledged_writes(trial.recorder.operations)
        puts += trial.ownership.puts
    return SimulatedRuns(count, failed, operations, acknowledged, puts, time.monotonic() - began)


def main() -> int:
    """Run many seeds, and print those that fail."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--digests", action="store_true", help="print a digest of each run instead")
    wanted = parser.parse_args()
    if wanted.digests:
        logging.disable(logging.WARNING)
        for seed in range(wanted.first, wanted.first + wanted.seeds):
            print(seed, digest_of(run(seed)))
        return 0
    found = run_seeds(wanted.first, wanted.seeds)
    print(found)
    return 1 if found.failed else 0


if __name__ == "__main__":
    sys.exit(main())
