"""A short campaign of faults on real processes. `make robustness` runs the long campaign, and checks its limits."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path

import pytest

from stampede_rt_local.namespaces import unavailable_because
from tests.robustness.campaign import HOSTS, REPLICATED, Findings, in_rounds, longest_gap, run_campaign
from tests.robustness.faults.scene import Outcome
from tests.robustness.histories.channel_model import (
    Delete,
    DeletedChannel,
    Open,
    Resolve,
    SeenChannel,
    Update,
    violations,
)
from tests.robustness.histories.operations import Operation
from tests.robustness.histories.ownership_model import Judgement
from tests.robustness.report import Run, SimulatedRuns, broken_promises, limits_broken, write_report

WHY_NOT = unavailable_because()
needs_namespaces = pytest.mark.skipif(WHY_NOT is not None, reason=WHY_NOT or "")


@needs_namespaces
async def test_a_directory_whose_leader_is_killed_and_removed_loses_nothing(tmp_path: Path) -> None:
    faults = ["kill_leader", "remove_leader"]
    found = await run_campaign(tmp_path, "short", faults, seed=7, secured=False, quiet_s=0.1)
    assert found.violations == ()
    assert not [outcome for outcome in found.outcomes if outcome.failed]
    assert len(found.outcomes) == len(faults)
    assert found.acknowledged > 0
    assert found.renewals > 0
    check_that_planted_violations_are_found(found.operations)


def check_that_planted_violations_are_found(history: list[Operation]) -> None:
    """Plant one violation of each kind in a real history. The checks must find it."""
    for plant in (lost_write, stale_read, doubled_claim):
        _, wrong = violations(plant(history))
        assert wrong, plant.__name__


def lost_write(history: list[Operation]) -> list[Operation]:
    """A reader finds that the last acknowledged change of a name was never made."""
    last = next(
        one for one in reversed(history) if isinstance(one.call, Update) and isinstance(one.answer, SeenChannel)
    )
    assert isinstance(last.answer, SeenChannel)
    before = replace(last.answer, value=last.answer.value + 7, version=last.answer.version - 1)
    late = max(one.invoked for one in history) + 1
    return [*history, Operation(last.key, Resolve(), late, late + 1, before)]


def stale_read(history: list[Operation]) -> list[Operation]:
    """A reader gets a value from before a change that another reader has already seen."""
    seen = [one for one in history if isinstance(one.call, Resolve) and isinstance(one.answer, SeenChannel)]
    newer = next(one for one in seen if isinstance(one.answer, SeenChannel) and one.answer.version > 1)
    assert isinstance(newer.answer, SeenChannel)
    old = replace(newer.answer, version=newer.answer.version - 1)
    return [*history, Operation(newer.key, Resolve(), newer.returned, newer.returned + 0.001, old)]


def doubled_claim(history: list[Operation]) -> list[Operation]:
    """Two callers at the same moment are told that they have made the channel."""
    deleted = {
        one.key for one in history if isinstance(one.call, Delete) and isinstance(one.answer, DeletedChannel | None)
    }
    created = next(
        one for one in history if isinstance(one.answer, SeenChannel) and one.answer.created and one.key not in deleted
    )
    assert isinstance(created.answer, SeenChannel)
    other = replace(created.answer, channel_id=b"another channel!")
    return [*history, Operation(created.key, Open(0), created.invoked, created.returned, other)]


@needs_namespaces
async def test_replicated_channels_lose_nothing_when_their_owner_is_restarted_or_dies_in_a_move(tmp_path: Path) -> None:
    faults = ["copies_restart_owner", "copies_kill_during_move"]
    found = await run_campaign(
        tmp_path, "short", faults, seed=7, secured=False, hosts=HOSTS, quiet_s=0.1, policy=REPLICATED
    )
    assert found.violations == ()
    assert not [outcome for outcome in found.outcomes if outcome.failed]
    assert found.items is not None
    assert found.items.acknowledged > 0
    assert found.items.gone_with_host == 0


@needs_namespaces
async def test_a_secured_cluster_whose_host_is_killed_has_one_owner_at_a_time(tmp_path: Path) -> None:
    faults = ["restart_host", "wrong_certificates"]
    found = await run_campaign(tmp_path, "short", faults, seed=7, secured=True, hosts=HOSTS, quiet_s=0.1)
    assert found.violations == ()
    assert not [outcome for outcome in found.outcomes if outcome.failed]
    assert found.items is not None
    assert found.items.acknowledged > 0
    assert found.items.gone_with_host > 0


def outcome(kind: str, began: float, ended: float, recovery_s: float | None = None, **facts: object) -> Outcome:
    return Outcome(kind=kind, began=began, ended=ended, recovery_s=recovery_s, limit_s=5.0, **facts)  # type: ignore[arg-type]


def findings(*outcomes: Outcome, wrong: tuple[str, ...] = ()) -> Findings:
    return Findings(
        title="Directory",
        outcomes=list(outcomes),
        operations=[],
        names=0,
        violations=wrong,
        items=Judgement(2, 40, 0, 0, 3, ()),
        item_calls_failed=2,
        not_done=0,
        renewals=1,
        registrations=1,
        gap_s=1.5,
        gap_in="no fault",
        stalled_s=0.1,
        seconds=10.0,
    )


def run(*several: Findings) -> Run:
    simulated = SimulatedRuns(seeds=2, failed=[], operations=10, acknowledged=5, puts=3, seconds=1.0)
    return Run("make robustness", "abc", 60.0, (0.1, 0.2), several, simulated)


def test_the_longest_gap_does_not_count_the_time_without_a_majority() -> None:
    served = [(0.0, 0.5), (1.0, 2.5), (8.0, 9.0), (9.5, 10.0)]
    assert longest_gap(served, []) == (6.5, 2.5)
    assert longest_gap(served, [outcome("kill -9 of all", 3.0, 8.5, majority=False)]) == (2.0, 0.5)


def test_a_recovery_over_its_limit_breaks_the_promise_and_shows_in_the_report() -> None:
    outcomes = [outcome("kill -9 of the leader", 0, 9, 1.5), outcome("kill -9 of the leader", 10, 19, 5.5)]
    [broken] = limits_broken(outcomes)
    assert broken.startswith("kill -9 of the leader: 5.50 s, promised 5 s")
    page = write_report(run(findings(*outcomes)))
    assert "| kill -9 of the leader | 2 | 3.50 s | 5.50 s | 0.00 s | 5 s | **1 of 2 over the limit** |" in page
    assert "Broken promises" in page


def test_a_recovery_that_exceeds_its_limit_only_by_the_start_of_processes_is_reported_and_keeps_the_promise() -> None:
    slow = outcome("kill -9 of all", 0, 9, 6.5, start_s=4.0)
    assert limits_broken([slow]) == []
    assert "kept, except for up to 4.0 s of waiting for the CPU (1 of 1)" in write_report(run(findings(slow)))
    assert limits_broken([replace(slow, start_s=1.0)]) != []
    assert limits_broken([replace(slow, start_s=0.0, stall_s=2.0)]) == []


def test_a_fault_after_which_the_directory_did_not_come_back_breaks_the_promise() -> None:
    lost = outcome("bridge", 0.0, 40.0, majority=False, note="did not come back in time", failed=True)
    assert limits_broken([lost]) == ["bridge: did not come back in time"]
    assert broken_promises(run(findings(lost))) == ["bridge: did not come back in time"]


def test_a_violation_is_counted_and_shown_and_fails_the_run() -> None:
    bad = run(findings(wrong=("key cam: no order explains it\n  the history",)))
    assert broken_promises(bad) == ["Directory: key cam: no order explains it"]
    page = write_report(bad)
    assert "and other violations** | **1** |" in page
    assert "  the history" in page


def test_every_fault_is_injected_once_before_any_is_injected_again() -> None:
    names = [f"fault-{number}" for number in range(9)]
    order = list(itertools.islice(in_rounds(names, 3, 60.0), 18))
    assert sorted(order[:9]) == sorted(order[9:]) == names
    assert order[:9] != order[9:]
    assert order == list(itertools.islice(in_rounds(names, 3, 60.0), 18)), "a seed gives the same order again"


def test_a_round_that_takes_much_too_long_ends_early() -> None:
    assert list(in_rounds(["kill_leader"], 3, -1.0)) == []


def test_a_round_that_must_be_whole_does_not_end_early() -> None:
    assert sorted(in_rounds(["one", "another"], 3, -1.0, all_once=True)) == ["another", "one"]


@needs_namespaces
async def test_hostile_clients_and_used_up_quotas_cost_good_clients_no_call_and_no_lease(tmp_path: Path) -> None:
    faults = ["attack_unfinished-puts", "quota_streams", "quota_channels"]
    found = await run_campaign(tmp_path, "short", faults, seed=7, secured=False, hosts=1, quiet_s=0.1)
    assert found.violations == ()
    assert [outcome.note for outcome in found.outcomes if outcome.failed] == []
    assert len(found.outcomes) == len(faults)
    assert found.item_calls_failed == 0
