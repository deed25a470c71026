"""The directory under random faults, and planted faults that the same checks must find."""

from __future__ import annotations

import logging
import os
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import pytest

from stampede_rt_channel_host.cluster.host_lease import HostLease as HostLease
from stampede_rt_supernode.core.peers import transitions
from stampede_rt_supernode.replication.interface import ReplicationStatus
from stampede_rt_supernode.replication.rules.raft_node import InvariantViolation
from tests.robustness.directory import host, simulate
from tests.robustness.directory.world import Submission, _Leases
from tests.robustness.histories.channel_model import acknowledged_writes
from tests.robustness.histories.linearizability import NotLinearizable
from tests.support.supernode.list_machine import PromiseBroken

# This limit only ends a run that hangs. On a busy machine a run in simulated time takes longer.
pytestmark = pytest.mark.timeout(600)

SEEDS_IN_SUITE, BLOCKS = 16, 4
SEEDS_WITH_TWO_LEADERS = (3, 18)


@pytest.mark.parametrize("block", range(BLOCKS))
def test_histories_are_linearizable_and_nothing_has_two_owners_under_faults(block: int) -> None:
    writes = puts = grants = 0
    for seed in range(block, SEEDS_IN_SUITE, BLOCKS):
        try:
            trial = simulate.run(seed)
        except Exception as error:
            error.add_note(f"replay: python -m tests.robustness.directory.simulate --first {seed} --seeds 1")
            raise
        writes += acknowledged_writes(trial.recorder.operations)
        puts += trial.ownership.puts
        grants += trial.name_ownership.grants
    # Simulated time is the same on every machine, so these numbers do not depend on the load.
    assert writes > 60, "there were too many faults: nothing was tested"
    assert puts > 50, "there were too many faults: no host served"
    assert grants > 30, "there were too many faults: no peer was registered"


def test_a_seed_gives_the_same_run_in_every_process() -> None:
    """Python orders a set of texts by PYTHONHASHSEED.

    In an earlier version, such an order decided which of two leaders took the first random number.
    """
    first, second = (digests_of(*SEEDS_WITH_TWO_LEADERS, hash_seed=seed) for seed in (0, 5))
    assert len(first) == len(SEEDS_WITH_TWO_LEADERS)
    assert first == second


def digests_of(*seeds: int, hash_seed: int) -> list[str]:
    command = [sys.executable, "-m", "tests.robustness.directory.simulate", "--digests", "--seeds", "1", "--first"]
    environment = {**os.environ, "PYTHONHASHSEED": str(hash_seed)}
    running = [subprocess.Popen([*command, str(seed)], env=environment, stdout=subprocess.PIPE) for seed in seeds]
    return [one.communicate()[0].decode().split()[1] for one in running]


class ShorterLeases(_Leases):
    """A leader that uses a shorter lease than the cluster's lease, which its hosts know."""

    async def _take_over(self, status: ReplicationStatus) -> None:
        await super()._take_over(status)
        self._hosts.ttl_nanos //= 4


class ShorterLeasesOfPeers(_Leases):
    """A leader that uses a shorter lease for peers than the cluster's lease."""

    async def _take_over(self, status: ReplicationStatus) -> None:
        await super()._take_over(status)
        self._peers.ttl_nanos //= 4


class NeverFenced(HostLease):
    """A host that serves until the directory tells it that its lease has ended."""

    def is_held(self, now: int) -> bool:
        return self._fence_nanos is not None


@pytest.fixture(autouse=True)
def _no_log_lines_of_injected_faults() -> Iterator[None]:
    logging.disable(logging.WARNING)
    yield
    logging.disable(logging.NOTSET)


def found_within(seeds: int, **planted: Any) -> bool:
    for seed in range(seeds):
        try:
            simulate.run(seed, **planted)
        except (PromiseBroken, NotLinearizable, InvariantViolation):
            return True  # InvariantViolation: a supernode noticed the fault itself, and stopped
    return False


def test_a_leader_that_ends_leases_too_early_is_found() -> None:
    assert found_within(20, leases=ShorterLeases)


def test_a_leader_that_ends_leases_of_peers_too_early_is_found() -> None:
    assert found_within(20, leases=ShorterLeasesOfPeers)


def test_a_directory_that_lets_a_second_peer_of_a_live_name_in_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(transitions, "check_may_follow", lambda before, operation: None)
    assert found_within(5)


def test_a_supernode_that_reads_without_asking_the_leader_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    async def confirm(self: Submission, *, seconds: float) -> int:
        return 0

    monkeypatch.setattr(Submission, "confirm", confirm)
    assert found_within(20)


def test_a_host_that_does_not_fence_itself_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(host, "HostLease", NeverFenced)
    assert found_within(40)


def test_a_disk_that_forgets_acknowledged_writes_is_found() -> None:
    assert found_within(40, lost_commits=1)
