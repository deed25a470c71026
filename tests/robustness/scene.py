"""Where faults happen, and what is written down about them."""

from __future__ import annotations

import random
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from pathlib import Path

from tests.robustness.callers import Probe
from tests.robustness.cluster import Cluster, Supernode

RECOVERY_SECONDS_MAX, FROZEN_LEADER_SECONDS_MAX = 5.0, 4.0
PATIENCE_SECONDS = 40.0


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of one fault. `recovery_s`: from the harm to the acknowledgement of a write begun after it."""

    kind: str
    began: float
    ended: float
    recovery_s: float | None = None
    limit_s: float | None = None
    majority: bool = True  # of the supernodes was alive and connected all the time
    note: str = ""
    failed: bool = False


@dataclass
class Scene:
    """Where faults happen."""

    cluster: Cluster
    probe: Probe
    dice: random.Random
    folder: Path
    outcomes: list[Outcome] = field(default_factory=list)

    async def recovery(self, since: float) -> float:
        """How long after `since` the directory served again."""
        return await self.probe.serves_after(since, seconds=PATIENCE_SECONDS)

    async def leader_and_other(self) -> tuple[Supernode, Supernode, Supernode]:
        leader = await self.cluster.leader()
        first, second = self.dice.sample(self.cluster.others(leader), 2)
        return leader, first, second

    def ended(
        self,
        kind: str,
        began: float,
        recovery_s: float | None = None,
        limit_s: float | None = None,
        *,
        majority: bool = True,
        note: str = "",
        failed: bool = False,
    ) -> None:
        """Take the fault down, which ends now."""
        outcome = Outcome(kind, began, time.monotonic(), recovery_s, limit_s, majority, note, failed)
        self.outcomes.append(outcome)
        measured = "" if recovery_s is None else f" served again after {recovery_s:.2f} s"
        print(f"{outcome.ended:10.1f}  {kind}{measured} {note}", flush=True)


Fault = Callable[[Scene], Awaitable[None]]
