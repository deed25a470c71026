"""The cluster in which faults happen, and the record of each fault."""

from __future__ import annotations

import random
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tests.robustness.real_cluster.cluster import Cluster
from tests.robustness.real_cluster.probe import Probe
from tests.robustness.real_cluster.supernode import Supernode
from tests.robustness.real_cluster.traffic import Traffic

RECOVERY_SECONDS_MAX, FROZEN_LEADER_SECONDS_MAX = 5.0, 4.0
PATIENCE_SECONDS = 40.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """The result of one fault. Times are in seconds.

    `recovery_s`: from the fault to the acknowledgement of a write that began after it. `start_s`: how much of that time
    the start of processes took. `stall_s`: the longest time in it when the measuring process itself did not run.
    `gap_s`: the longest time without an acknowledged write until the fault had ended. `evidence`: the observation that
    shows that the fault took effect.
    """

    kind: str
    began: float
    ended: float
    recovery_s: float | None = None
    limit_s: float | None = None
    start_s: float = 0.0
    stall_s: float = 0.0
    gap_s: float = 0.0
    majority: bool = True  # whether a majority of the supernodes was alive and connected all the time
    evidence: str = ""
    note: str = ""
    failed: bool = False

    @property
    def over_limit(self) -> bool:
        """Whether the recovery took longer than promised."""
        return self.limit_s is not None and self.recovery_s is not None and self.recovery_s > self.limit_s

    @property
    def late(self) -> bool:
        """Whether the promise was broken: over the limit, and not only because this machine was too busy."""
        return self.over_limit and (self.recovery_s or 0.0) - self.excused_s > (self.limit_s or 0.0)

    @property
    def excused_s(self) -> float:
        """The part of the recovery in which processes started, or in which the measuring process did not run."""
        return max(self.start_s, self.stall_s)


@dataclass
class Scene:
    """The cluster in which faults happen. `traffic` is None in a cluster without channel hosts."""

    cluster: Cluster
    probe: Probe
    rng: random.Random
    folder: Path
    traffic: Traffic | None = None
    calm_bytes: dict[str, int] = field(default_factory=dict)  # the memory of processes before their first attack
    outcomes: list[Outcome] = field(default_factory=list)

    async def recovery(self, since: float) -> float:
        """The time from `since` until the directory served again. Raises TimeoutError."""
        return await self.probe.serves_after(since, seconds=PATIENCE_SECONDS)

    async def leader_and_other(self) -> tuple[Supernode, Supernode, Supernode]:
        """The leader, and two others in any order."""
        leader = await self.cluster.leader()
        first, second = self.rng.sample(self.cluster.others(leader), 2)
        return leader, first, second

    def ended(self, kind: str, began: float, recovery_s: float | None = None, **facts: Any) -> None:
        """Record the fault, which ends now; `facts` are the other fields of Outcome."""
        ended = time.monotonic()
        gap_s = self.probe.longest_gap_s(began, ended)
        stall_s = self.probe.stalled_s(began, began + (recovery_s or 0.0))
        facts |= {"recovery_s": recovery_s, "gap_s": gap_s, "stall_s": stall_s}
        outcome = Outcome(kind=kind, began=began, ended=ended, **facts)
        self.outcomes.append(outcome)
        measured = "" if recovery_s is None else f" recovered after {recovery_s:.2f} s"
        print(f"{outcome.ended:10.1f}  {kind}{measured} [{outcome.evidence}] {outcome.note}", flush=True)


Fault = Callable[[Scene], Awaitable[None]]
