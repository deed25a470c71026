"""A short campaign of faults on real supernodes; `make robustness` runs the long one, and holds it to its limits."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.robustness.campaign import longest_gap, run_campaign
from tests.robustness.network import unavailable_because
from tests.robustness.report import Simulated, limits_broken, write_report
from tests.robustness.scene import Outcome

WHY_NOT = unavailable_because()


@pytest.mark.skipif(WHY_NOT is not None, reason=WHY_NOT or "")
@pytest.mark.timeout(120)
async def test_a_cluster_that_is_killed_frozen_and_cut_in_two_loses_nothing(tmp_path: Path) -> None:
    faults = ["kill_leader", "freeze_leader", "split_off_leader", "garbage", "kill_all"]
    found = await run_campaign(tmp_path, faults, seed=7, quiet_s=0.2)
    assert len(found.outcomes) == len(faults)
    assert not [outcome for outcome in found.outcomes if outcome.failed]
    assert found.acknowledged > 20
    assert found.renewals > 0


def outcome(
    kind: str, began: float, ended: float, recovery_s: float | None = None, *, majority: bool = True
) -> Outcome:
    return Outcome(kind, began, ended, recovery_s, 5.0, majority)


def test_the_longest_gap_does_not_count_the_time_without_a_majority() -> None:
    served = [(0.0, 0.5), (1.0, 2.5), (8.0, 9.0), (9.5, 10.0)]
    assert longest_gap(served, []) == (6.5, 2.5)
    assert longest_gap(served, [outcome("kill -9 of all", 3.0, 8.5, majority=False)]) == (2.0, 0.5)


def test_a_recovery_over_its_limit_breaks_the_promise_and_shows_in_the_report() -> None:
    outcomes = [outcome("kill -9 of the leader", 0, 9, 1.5), outcome("kill -9 of the leader", 10, 19, 5.5)]
    assert limits_broken(outcomes) == ["kill -9 of the leader: 5.50 s, promised 5 s"]
    simulated = Simulated(seeds=2, failed=[1], operations=10, acknowledged=5, puts=3, seconds=1.0)
    assert "2 / 1" in write_report("make robustness", "today", "idle", [], simulated)


def test_a_fault_after_which_the_directory_did_not_come_back_breaks_the_promise() -> None:
    lost = Outcome("bridge", 0.0, 40.0, majority=False, note="did not come back in time", failed=True)
    assert limits_broken([lost]) == ["bridge: did not come back in time"]
