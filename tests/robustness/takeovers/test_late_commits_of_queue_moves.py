"""The answer to the commit of a queue's move comes after the leases of hosts have ended, in virtual time.

Meanwhile the source, the destination or both do not reach the directory. No acknowledged message is lost, no two hosts
serve the queue, and no host is stuck: the run ends.
"""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from stampede_rt.errors import Unavailable
from stampede_rt_channel_host.core.records import RecordedQueue
from tests.robustness.takeovers.queue_world import DirectoryOfQueues
from tests.robustness.takeovers.simulate_queues import QueueTrial
from tests.robustness.takeovers.test_queue_moves_at_each_step import OWNS, STEPS, Scenario, played

LEASES_END_SECONDS = 12.0  # a lease ends after 5 s, and the host registers again after the cut
HOSTS = {"source": ["source"], "destination": ["destination"], "both": ["source", "destination"]}
CUTS = [
    ("source", "source: holds the queue"), ("source", "source: all replicas have the queue"), ("source", OWNS),
    ("destination", "source: holds the queue"), ("destination", OWNS), ("both", OWNS),
]  # fmt: skip


class LateCommit(Scenario):
    """A cut of hosts from the directory, which begins at a step. The first answer to the commit of the destination is
    `late_seconds` late, or is lost then.
    """

    def __init__(self, trial: QueueTrial, cut: str, to_replica: bool, late_seconds: float, is_lost: bool) -> None:
        super().__init__(trial, cut, "cut_off", to_replica)
        self.late_seconds, self.is_lost = late_seconds, is_lost
        self.is_late = False  # whether the late answer has been under way

    def reached(self) -> None:
        if self.hosts and self.fault_task is None:
            self.fault_task = asyncio.create_task(self._cut_off({self.hosts[one] for one in HOSTS[self.victim]}))

    async def _cut_off(self, numbers: set[int]) -> None:
        self.trial.cluster.cut_off |= numbers
        await asyncio.sleep(LEASES_END_SECONDS)
        self.trial.cluster.cut_off -= numbers

    async def answer(self, record: RecordedQueue) -> RecordedQueue:
        """Answer the destination."""
        if self.hosts and not self.is_late:
            self.is_late = True
            await asyncio.sleep(self.late_seconds)
            if self.is_lost:
                raise Unavailable("the answer is lost")
        return record


@pytest.mark.parametrize("is_lost", [False, True], ids=["late", "lost"])
@pytest.mark.parametrize("to_replica", [True, False], ids=["to the replica", "to a host without a copy"])
@pytest.mark.parametrize(("cut", "step"), CUTS)
def test_a_late_answer_to_a_commit_loses_no_message_and_lets_no_host_wait_for_ever(
    monkeypatch: pytest.MonkeyPatch, cut: str, step: str, to_replica: bool, is_lost: bool
) -> None:
    commit, scenarios = DirectoryOfQueues.commit_queue, list[LateCommit]()

    async def late(self: DirectoryOfQueues, queue_id: bytes, epoch: int, *rest: Any) -> RecordedQueue:
        record = await commit(self, queue_id, epoch, *rest)
        is_of_destination = len(rest) > 1
        return await scenarios[-1].answer(record) if is_of_destination and scenarios else record

    def scenario(trial: QueueTrial) -> Scenario:
        late_seconds = 15.0 if is_lost else 6.0  # after, or before the hosts have registered again
        scenarios.append(LateCommit(trial, cut, to_replica, late_seconds, is_lost))
        return scenarios[-1]

    monkeypatch.setattr(DirectoryOfQueues, "commit_queue", late)
    played(monkeypatch, STEPS[step], scenario, CUTS.index((cut, step)))
    assert scenarios[-1].fault_task is not None
