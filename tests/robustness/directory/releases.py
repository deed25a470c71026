"""Simulated supernodes of today's release and of a newer one, side by side."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from stampede_rt_supernode.replica import DirectoryReplica
from stampede_rt_supernode.replication.interface import Member, ReleaseTooOld
from stampede_rt_supernode.replication.network.refusals import Refusals
from stampede_rt_supernode.replication.raft_replica import RaftReplica
from stampede_rt_supernode.servicers.level_keeper import TICK_SECONDS, LevelKeeper
from tests.robustness.directory.world import DirectoryMember, DirectoryWorld, Submission, _Log
from tests.robustness.replication.fault_rates import FaultRates
from tests.support.newer_release import NEW_LEVEL, NewerReplica
from tests.support.supernode.list_machine import PromiseBroken


class CheckedReplica(NewerReplica):
    """The newer release's directory. It reports a command in the log that the log should have refused."""

    def apply(self, index: int, command: bytes) -> bytes:
        """Do the same as in production."""
        if not self.takes(command):
            raise PromiseBroken(f"entry {index} needs a higher feature level than {self.feature_level}")
        return super().apply(index, command)


class UpgradedMember(DirectoryMember):
    """One supernode, first with today's release."""

    world: UpgradeWorld
    software: type[DirectoryReplica] = DirectoryReplica
    # Whether this member ever ran the newer release, and may have reported the newer level.
    was_newer = False
    # The machine of this member is off until this time. Meanwhile no operator can start or upgrade the member.
    off_until = 0.0

    @property
    def is_off(self) -> bool:
        return self.world.now < self.off_until

    @property
    def machine(self) -> Any:
        return self._directory

    @machine.setter
    def machine(self, _: object) -> None:
        self._directory = self.software()

    def start(self) -> None:
        """Start as in production. The member ends if its release is too old for the data in its folder."""
        self.was_newer |= self.software is CheckedReplica
        self._outdated = Refusals()
        try:
            super().start()
        except ReleaseTooOld:
            self._check_may_be_refused()
            return
        levels = LevelKeeper(_Log(self), self._directory, Submission(self))  # type: ignore[arg-type]

        async def keep() -> None:
            while True:
                await levels.tick()
                await self.world.sleep(self.world.level_tick_seconds)

        self.run(keep)

    def refuse_release(self, by: str, why: str) -> None:
        """Note that another member has refused this member as too old. This member ends once the refusal is
        confirmed.
        """
        assert self.replica is not None
        others = {one.member_id for one in self.replica.roster.members} - {self.member.member_id}
        if self._outdated.refused(by, why, others=others, leader_id=self.replica.status().leader_id):
            self._check_may_be_refused()
            self.crash()

    def run_release(self, release: type[DirectoryReplica]) -> None:
        """Start this member with another release."""
        if self.replica is not None:
            self.crash()
        self.software = release
        self.world.restart(self)

    def _step(self, replica: Any, at: float) -> None:
        try:
            super()._step(replica, at)
        except ReleaseTooOld:
            self._check_may_be_refused()
            self.crash()
        if self.replica is not None and self._directory.feature_level == NEW_LEVEL and not self.world.has_risen:
            self.world.has_risen = True
            self._judge_rise(self.replica)

    def _judge_rise(self, replica: RaftReplica) -> None:
        """Check that all members at the log position of the new level have reported that they know the level."""
        members = [self.world.members[one.member_id] for one in _applied_members(replica)]
        if unknown := [one.member.member_id for one in members if not one.was_newer]:
            raise PromiseBroken(
                f"the level has risen, although {unknown[0]} has never reported that it knows the level"
            )

    def _check_may_be_refused(self) -> None:
        """Check that this member, whose release is too old, has reported the newer level before, or has not joined."""
        if not self.was_newer and self._has_joined():
            name = self.member.member_id
            raise PromiseBroken(f"the level has risen, although {name} has never reported that it knows the level")

    def _has_joined(self) -> bool:
        """Whether another member has applied the addition of this member. Before that, this member is only a process
        that wants to join.
        """
        replicas = [one.replica for one in self.world.alive() if one is not self]
        return any(self.member in _applied_members(one) for one in replicas if one)


def _applied_members(replica: RaftReplica) -> Sequence[Member]:
    """The members at the last index that this replica has applied."""
    return replica._log.configurations.at(replica._node.last_applied).members


class UpgradeWorld(DirectoryWorld):
    """A DirectoryWorld whose members change their release."""

    members: dict[str, UpgradedMember]  # type: ignore[assignment]
    # If the leader checks the level seldom, newcomers have time to join before the level rises.
    level_tick_seconds = TICK_SECONDS
    # Whether a member has applied the newer release's level.
    has_risen = False

    def __init__(self, seed: int, *, size: int, fault_rates: FaultRates) -> None:
        super().__init__(seed, size=size, fault_rates=fault_rates)
        self.members = {
            name: UpgradedMember(self, one.member, one.settings.initial_members) for name, one in self.members.items()
        }

    def _newcomer(self, member: Member, seeds: Sequence[Member]) -> UpgradedMember:
        return UpgradedMember(self, member, seeds, joining=True)
