"""Rolling upgrades under random faults: `python -m tests.robustness.directory.upgrading --seeds 100`.

Three or five supernodes of today's release are replaced one by one by a newer release (tests/support/newer_release.py),
and sometimes back again. Meanwhile they are killed, split and hang, and newcomers of both releases join. A machine may
be off while the others are upgraded, and comes back with its former release. A test caller always proposes the newer
release's command directly to the log, which no supernode would do. The log must refuse the command until all members
know it. No two states may differ, and no command above the level may be in the log. The level may rise only if all
members have reported that they know the new level. In the end all members run the newer release, and the command works.
"""

from __future__ import annotations

import argparse
import logging
import random
import sys
from collections.abc import Callable, Sequence
from typing import Any, cast
from unittest import mock

from stampede_rt_supernode.codecs.command_codec import decode_result, encode_command
from stampede_rt_supernode.codecs.snapshot_codec import encode_snapshot
from stampede_rt_supernode.core.channels.commands import ChannelUpdated, OpenChannel
from stampede_rt_supernode.core.commands import Command, Operation
from stampede_rt_supernode.core.hosts.commands import RegisterHost
from stampede_rt_supernode.core.records import Endpoint
from stampede_rt_supernode.replica import DirectoryReplica
from stampede_rt_supernode.replication.rules.member_change import ChangeOutcome
from stampede_rt_supernode.replication.rules.proposals import Outcome, Proposal
from stampede_rt_supernode.servicers.level_keeper import TICK_SECONDS
from tests.robustness.directory.releases import CheckedReplica, UpgradedMember, UpgradeWorld
from tests.robustness.replication.fault_rates import FaultRates
from tests.robustness.replication.simulate import draw_fault_rates, settled_members
from tests.support.newer_release import NEW_LEVEL, encode_cap
from tests.support.supernode.list_machine import PromiseBroken

FAULT_SECONDS, HEAL_SECONDS = 16.0, 20.0
NEWCOMERS_MAX = 3
HOST_ID = (1).to_bytes(16, "big")


class Upgrade:
    """Makes faults, upgrades and calls in a world, until it ends."""

    def __init__(self, world: UpgradeWorld) -> None:
        self.world, self.over = world, False
        # How often the newer release's command has succeeded.
        self.capped = 0
        self._numbers = iter(range(1, 10**9))
        # The answers to processes that asked to join.
        self._requested: list[list[ChangeOutcome]] = []
        self._newcomers: list[UpgradedMember] = []
        self._waiting = list(world.members.values())
        world.random_source.shuffle(self._waiting)
        fault_rates = world.fault_rates
        for rate, happen in (
            (fault_rates.crashes, self._crash),
            (fault_rates.partitions, self._split),
            (fault_rates.freezes, self._freeze),
            (fault_rates.link_breaks, lambda: world.break_wire(world.random_source.choice(list(world.wires)))),
            (world.random_source.choice([0.3, 0.7]), self._upgrade),
            (0.15, self._go_back),
            (world.random_source.choice([0.0, 0.1, 0.5]), self._switch_off),
            (0.1, self._volunteer),
            (5.0, self._join),
            (2.0, self._register),
            (5.0, self._open),
            (10.0, self.cap),
        ):
            if rate > 0:
                self._repeat(rate, happen)

    def _repeat(self, rate: float, happen: Callable[[], object]) -> None:
        def once() -> None:
            if not self.over:
                happen()
                self._repeat(rate, happen)

        self.world.after(self.world.random_source.expovariate(rate), once)

    def _crash(self) -> None:
        if alive := self.world.alive():
            self.world.random_source.choice(alive).crash()

    def _freeze(self) -> None:
        if alive := self.world.alive():
            self.world.random_source.choice(alive).frozen_until = self.world.now + self.world.random_source.uniform(
                0.2, 3.0
            )

    def _split(self) -> None:
        names = list(self.world.members)
        side = set(self.world.random_source.sample(names, self.world.random_source.randint(1, len(names) - 1)))
        pairs = [ends for ends in self.world.wires if len(side & set(ends)) == 1]
        self.world.block(pairs)
        self.world.after(self.world.random_source.uniform(0.3, 4.0), lambda: self.world.unblock(pairs))

    def _switch_off(self) -> None:
        """Switch one machine off for longer than the upgrade of most others takes."""
        members = list(self.world.members.values())
        if not any(one.is_off for one in members):
            member = self.world.random_source.choice(members)
            member.off_until = self.world.now + self.world.random_source.uniform(4.0, 10.0)
            if member.replica is not None:
                member.crash()

    def _upgrade(self) -> None:
        """Upgrade the next member whose machine is on."""
        ready = [one for one in self._waiting if not one.is_off]
        if ready:
            self._waiting.remove(ready[-1])
            ready[-1].run_release(CheckedReplica)
        if not self._waiting:
            self._volunteer()  # just before the level rises

    def _go_back(self) -> None:
        """Start a member with the older release again. It may run until the level has risen; then it ends."""
        member = self.world.random_source.choice(list(self.world.members.values()))
        if member not in self._waiting and not member.is_off:
            member.run_release(DirectoryReplica)
            self._waiting.append(member)

    def _join(self) -> None:
        """Ask a leader again and again to let the last newcomer in."""
        leaders = [one for one in self.world.alive() if one.replica is not None and one.replica.status().is_leader]
        if leaders and self._newcomers:
            newcomer = self._newcomers[-1].member
            self._requested.append(
                self.world.change(self.world.random_source.choice(leaders), newcomer, is_removal=False)
            )

    def _volunteer(self) -> None:
        """Start a process of either release that wants to join.

        A process of the older release is upgraded later, like the others.
        """
        if len(self._newcomers) == NEWCOMERS_MAX:
            return
        seeds = next(iter(self.world.members.values())).settings.initial_members
        newcomer = cast(UpgradedMember, self.world.volunteer(seeds))
        self._newcomers.append(newcomer)
        if self.world.random_source.random() < 0.3:
            newcomer.run_release(CheckedReplica)
        else:
            self._waiting.insert(0, newcomer)

    def answered(self, kind: type) -> int:
        """The number of answers of this kind to processes that asked to join."""
        return sum(isinstance(outcome, kind) for outcomes in self._requested for outcome in outcomes)

    def _register(self) -> None:
        process = next(self._numbers)
        self._do(
            RegisterHost(
                host_id=HOST_ID,
                name="host",
                gatekeepers=(Endpoint(target="localhost:7600", zone=""),),
                boot_incarnation=process,
                new_incarnation=next(self._numbers),
                registration_epoch=process,
            )
        )

    def _open(self) -> None:
        name = f"cam/{self.world.random_source.randrange(3)}"
        new = self.world.random_source.randbytes(16)
        self._do(OpenChannel(name=name, new_channel_id=new, new_incarnation=next(self._numbers)))

    def _do(self, operation: Operation) -> None:
        identity = self.world.random_source.randbytes(16)
        self._propose(encode_command(Command(op_id=identity, time_unix_nano=0, operation=operation)))

    def cap(self) -> None:
        """Propose the newer release's command without a check of the level."""
        for member in self.world.random_source.sample(self.world.alive(), len(self.world.alive())):
            directory = member.machine._directory
            for channel in directory.tables.channels.values():
                self._propose(
                    encode_cap(self.world.random_source.randbytes(16), channel.channel_id, channel.epoch), member
                )
                return

    def _propose(self, encoded: bytes, member: Any = None) -> None:
        alive = self.world.alive()
        member = member or (self.world.random_source.choice(alive) if alive else None)
        if member is not None:
            member.replica.propose(Proposal(encoded, self.world.now + 2.0, self._note))

    def _note(self, outcome: Outcome) -> None:
        if isinstance(outcome, bytes):
            result = decode_result(outcome)
            self.capped += isinstance(result, ChannelUpdated)


def _revive(world: UpgradeWorld) -> None:
    for member in world.members.values():
        if member.replica is None and not member.is_off and world.random_source.random() < 0.3:
            world.restart(member)
    world.after(0.4, lambda: _revive(world))


def run(seed: int) -> Upgrade:
    """Run one seed: faults, healing, checks. Raises PromiseBroken."""
    random_source = random.Random(f"upgrade-{seed}")
    world = UpgradeWorld(seed, size=random_source.choice([3, 3, 5]), fault_rates=draw_fault_rates(random_source))
    world.level_tick_seconds = random_source.choice([TICK_SECONDS, 8.0])
    with (
        mock.patch("secrets.token_bytes", world.random_source.randbytes),
        mock.patch("secrets.randbits", world.random_source.getrandbits),
        mock.patch("secrets.token_hex", lambda count: world.random_source.randbytes(count).hex()),
    ):
        for member in world.members.values():
            member.start()
        _revive(world)
        trial = Upgrade(world)
        world.run_until(FAULT_SECONDS)
        trial.over = True
        _heal_and_check(trial)
    return trial


def _heal_and_check(trial: Upgrade) -> None:
    """Heal everything and upgrade all members.

    Then the level rises by itself, the command works, and all states agree.
    """
    world = trial.world
    world.fault_rates = FaultRates()
    world.unblock(list(world.wires))
    for member in world.members.values():
        member.frozen_until = member.off_until = 0.0
        if member.software is not CheckedReplica:
            member.run_release(CheckedReplica)
    members = cast(Sequence[UpgradedMember], settled_members(world, world.now + HEAL_SECONDS))
    end = world.now + HEAL_SECONDS
    if not world.run_until(end, lambda: all(one.machine.feature_level == NEW_LEVEL for one in members)):
        levels = {one.member.member_id: one.machine.feature_level for one in members}
        raise PromiseBroken(f"all members run the newer release, but the level does not rise: {levels}")
    before = trial.capped
    while trial.capped == before and world.now < end:
        trial._register()
        trial._open()
        world.run_until(world.now + 0.5)
        trial.cap()
        world.run_until(world.now + 0.5)
    if trial.capped == before:
        raise PromiseBroken(f"the newer release's command does not work {HEAL_SECONDS} s after the last upgrade")

    def agree() -> bool:
        same = len({one.machine.digest() for one in members}) == 1
        return same and len({encode_snapshot(one.machine._directory) for one in members}) == 1

    if not world.run_until(world.now + HEAL_SECONDS, agree):
        raise PromiseBroken("two supernodes end with different states")


def main() -> int:
    """Run many seeds, and print those that fail."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--first", type=int, default=0)
    wanted = parser.parse_args()
    logging.disable(logging.WARNING)
    failed, capped = [], 0
    for seed in range(wanted.first, wanted.first + wanted.seeds):
        try:
            capped += run(seed).capped
        except Exception as error:  # noqa: BLE001 - every failure is reported with its seed
            failed.append(seed)
            print(f"seed {seed} failed: {error!r}", file=sys.stderr)
    print(f"{wanted.seeds} seeds, the newer command done {capped} times; failed: {failed or 'none'}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
