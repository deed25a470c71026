"""A ReplicatedLog of one replica that applies immediately. A test controls its failures and its leadership."""

from __future__ import annotations

import asyncio
from collections import deque
from enum import Enum

from stampede_rt_runtime.metrics.families import Durations
from stampede_rt_supernode.replication.interface import (
    LogUnavailable,
    Member,
    OutcomeUnknown,
    ReplicationStatus,
    StateMachine,
    TakenSnapshot,
)

SELF, OTHER = Member(member_id="s1", address="localhost:7581"), Member(member_id="s2", address="localhost:7582")


class ProposalOutcome(Enum):
    """The outcome of a proposal."""

    REFUSED = "not taken"
    LOST = "unknown, and not done"
    DONE_WITHOUT_ANSWER = "unknown, and done"


class MemoryLog:
    """A log in memory. `outcomes`: the outcomes of the next proposals; empty: all succeed. `quorum` False: all fail."""

    def __init__(self, machine: StateMachine) -> None:
        self.machine = machine
        self.index = 0
        self.tenure = 1
        self.leader_id: str | None = SELF.member_id
        self.other = OTHER
        self.retired: set[str] = set()
        self.quorum = True
        self.diverged_at = 0
        self.disk_silent_seconds = 0.0
        # The highest feature levels that the members have reported; None: both know the levels of this release.
        self.highest_levels: dict[str, int] | None = None
        # The error of every change of the members; None: it succeeds.
        self.change_fails: Exception | None = None
        self.snapshot_fails: Exception | None = None
        self.added: list[tuple[Member, str]] = []
        self.outcomes: deque[ProposalOutcome] = deque()
        # With True, the next proposal never ends for its caller. `apply_held` applies the proposal later.
        self.holds = False
        self.held: list[bytes] = []
        self.held_one = asyncio.Event()  # set once a proposal is held
        self.reads_may_end = asyncio.Event()
        self.reads_may_end.set()
        self.read_waits = asyncio.Event()  # set once a read has come; reads wait for `reads_may_end`
        self.outcome_met = asyncio.Event()  # set once a proposal has had one of the outcomes

    async def propose(self, command: bytes, *, timeout: float) -> bytes:
        outcome = self.outcomes.popleft() if self.outcomes else None
        if outcome is not None:
            self.outcome_met.set()
        if outcome is ProposalOutcome.REFUSED or not self.quorum:
            raise LogUnavailable("as the test planned")
        if outcome is ProposalOutcome.LOST:
            raise OutcomeUnknown("as the test planned")
        if self.holds:
            self.holds = False
            self.held.append(command)
            self.held_one.set()
            await asyncio.Event().wait()  # until the caller gives up
        self.index += 1
        result = self.machine.apply(self.index, command)
        if outcome is ProposalOutcome.DONE_WITHOUT_ANSWER:
            raise OutcomeUnknown("as the test planned")
        return result

    def apply_held(self) -> list[bytes]:
        """Apply the held proposals, and return their results."""
        held, self.held = self.held, []
        self.index += len(held)
        first = self.index - len(held) + 1
        return [self.machine.apply(index, command) for index, command in enumerate(held, start=first)]

    async def confirm_read(self, *, timeout: float) -> int:
        if not self.quorum:
            raise LogUnavailable("as the test planned")
        self.read_waits.set()
        await self.reads_may_end.wait()
        return self.index

    def write_times(self) -> Durations:
        return Durations(())

    def status(self) -> ReplicationStatus:
        leads = self.leader_id == SELF.member_id
        return ReplicationStatus(
            self_id=SELF.member_id,
            leader_id=self.leader_id,
            is_leader=leads,
            tenure=self.tenure if leads else 0,
            term=self.tenure,
            applied_index=self.index,
            diverged_at=self.diverged_at,
            disk_silent_seconds=self.disk_silent_seconds,
            members=[SELF, self.other],
            feature_level=self.machine.feature_level,
            highest_levels=self._levels(),
            former_ids=self.retired,
        )

    def _levels(self) -> dict[str, int]:
        own = self.machine.highest_level
        return {SELF.member_id: own, self.other.member_id: own} if self.highest_levels is None else self.highest_levels

    async def add_member(self, member: Member, *, ticket: str = "", timeout: float) -> int:
        self.added.append((member, ticket))
        return self._changed()

    async def remove_member(self, member_id: str, *, timeout: float) -> int:
        return self._changed()

    def _changed(self) -> int:
        if self.change_fails is not None:
            raise self.change_fails
        self.index += 1
        return self.index

    async def take_snapshot(self, *, timeout: float) -> TakenSnapshot:
        if self.snapshot_fails is not None:
            raise self.snapshot_fails
        return TakenSnapshot(log_index=self.index, record=self.machine.begin_snapshot()())

    async def hand_over(self, *, timeout: float) -> bool:
        return False

    async def close(self) -> None:
        self.quorum = False
