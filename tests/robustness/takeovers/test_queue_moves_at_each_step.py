"""A fault at each step of a move of a queue with replicas, in virtual time: no acknowledged message is lost.

The queue moves to the host of its replica, or to a host without a copy, while producers and takers go on. The suite
kills the source and the destination. `make kill-moves` tries all faults at all hosts.
"""

from __future__ import annotations

import asyncio
import os
from collections.abc import Callable
from contextlib import suppress

import pytest

from stampede_rt.errors import StampedeError
from tests.robustness.moves.stepped_host import QUEUE_DESTINATION_STEPS, QUEUE_SOURCE_STEPS, Step, wrapped
from tests.robustness.takeovers.queue_world import DirectoryOfQueues
from tests.robustness.takeovers.simulate_queues import WITH_CLOCKS, QueueTrial, play
from tests.support.virtual_time import VirtualClock, run_virtually

EVERY_FAULT = bool(os.environ.get("STAMPEDE_EVERY_STEP"))
OWNS = "destination: owns the queue"
STEPS = QUEUE_SOURCE_STEPS | QUEUE_DESTINATION_STEPS | {OWNS: Step(DirectoryOfQueues, "commit_queue", is_after=True)}
FAULTS = ["kill", "stop", "cut_off", "slow"] if EVERY_FAULT else ["kill"]
VICTIMS = ["source", "destination", "third"] if EVERY_FAULT else ["source", "destination"]
WAIT_SECONDS = 20.0


class Scenario:
    """A move of `jobs`, and a fault at one of its steps."""

    def __init__(self, trial: QueueTrial, victim: str, fault: str, to_replica: bool) -> None:
        self.trial, self.victim, self.fault, self.to_replica = trial, victim, fault, to_replica
        self.fault_task: asyncio.Task[None] | None = None
        self.hosts: dict[str, int] = {}

    async def disturb(self) -> None:
        """Move the queue, and wait until the fault is over."""
        cluster = self.trial.cluster
        await self._until(lambda: cluster.is_complete(1))
        source = self._number(cluster.queue(cluster.jobs_id).host_id)
        (copy,) = cluster.copies(cluster.jobs_id)
        without_copy = ({1, 2, 3} - {source, self._number(copy.host_id)}).pop()
        destination = self._number(copy.host_id) if self.to_replica else without_copy
        self.hosts = {"source": source, "destination": destination, "third": 6 - source - destination}
        move = asyncio.create_task(cluster.move(cluster.jobs_id, destination))
        with suppress(StampedeError, asyncio.CancelledError):
            await move
        await self._until(lambda: self.fault_task is not None)  # perhaps after the answer to the caller of the move
        assert self.fault_task is not None
        await self.fault_task

    async def _until(self, condition: Callable[[], bool]) -> None:
        for _ in range(round(WAIT_SECONDS / 0.1)):
            if condition():
                return
            await asyncio.sleep(0.1)
        raise AssertionError("the replica is not in sync, or the move has not reached the step")

    def reached(self) -> None:
        """Begin the fault, because the move is at the step."""
        if self.hosts and self.fault_task is None:
            fault = getattr(self.trial.faults, self.fault)(self.hosts[self.victim])
            self.fault_task = asyncio.create_task(fault)

    def _number(self, host_id: bytes) -> int:
        return int.from_bytes(host_id, "big")


def played(
    monkeypatch: pytest.MonkeyPatch, step: Step, scenario_of: Callable[[QueueTrial], Scenario], seed: int
) -> None:
    async def main(clock: VirtualClock) -> None:
        trial = QueueTrial(clock, seed, replicas=1)
        scenario = scenario_of(trial)
        monkeypatch.setattr(step.owner, step.method, wrapped(step, scenario.reached))
        found = await play(trial, scenario.disturb)
        assert found.lost == 0
        assert [len(one) for one in trial.cluster.incarnations.values()] == [1, 1]

    run_virtually(main, seed, *WITH_CLOCKS)


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("victim", VICTIMS)
@pytest.mark.parametrize("to_replica", [True, False], ids=["to the replica", "to a host without a copy"])
@pytest.mark.parametrize("step", STEPS)
def test_a_move_of_a_queue_loses_nothing_and_no_acked_message_comes_back(
    monkeypatch: pytest.MonkeyPatch, step: str, to_replica: bool, victim: str, fault: str
) -> None:
    seed = [*STEPS].index(step)
    played(monkeypatch, STEPS[step], lambda trial: Scenario(trial, victim, fault, to_replica), seed)
