"""Rolling upgrades of three and five simulated supernodes under random faults."""

from __future__ import annotations

import logging
from collections.abc import Iterator

import pytest

from stampede_rt_supernode.core.cluster.feature_levels import HIGHEST_LEVEL
from stampede_rt_supernode.replica import DirectoryReplica
from stampede_rt_supernode.replication.interface import ReleaseOutdated
from tests.robustness.directory import upgrading
from tests.robustness.directory.releases import CheckedReplica, UpgradedMember, UpgradeWorld
from tests.robustness.replication.fault_rates import FaultRates

SEEDS_IN_SUITE, BLOCKS = 24, 2


@pytest.fixture(autouse=True)
def _no_log_lines_of_injected_faults() -> Iterator[None]:
    logging.disable(logging.WARNING)
    yield
    logging.disable(logging.NOTSET)


@pytest.mark.parametrize("block", range(BLOCKS))
def test_no_states_differ_while_supernodes_of_two_releases_run_together(block: int) -> None:
    capped = joined = 0
    for seed in range(block, SEEDS_IN_SUITE, BLOCKS):
        try:
            upgrade = upgrading.run(seed)
            capped += upgrade.capped
            joined += upgrade.answered(int)
        except Exception as error:
            error.add_note(f"replay: python -m tests.robustness.directory.upgrading --first {seed} --seeds 1")
            raise
    assert capped > SEEDS_IN_SUITE, "the newer release's command was hardly ever done"
    assert joined > SEEDS_IN_SUITE / BLOCKS, "hardly any process has joined"


def test_a_seed_gives_the_same_upgrade_every_time() -> None:
    first, second = upgrading.run(3), upgrading.run(3)
    assert first.capped == second.capped > 0
    assert first.world.now == second.world.now


def test_an_older_newcomer_is_refused_while_the_level_is_about_to_rise_and_joins_with_the_newer_release() -> None:
    world = UpgradeWorld(1, size=3, fault_rates=FaultRates())
    members = list(world.members.values())
    for member in members:
        member.start()
    world.run_until(5.0)
    world.level_tick_seconds = 1000.0
    for member in members:
        member.run_release(CheckedReplica)
        world.run_until(world.now + 5.0)
    assert {member.machine.feature_level for member in members} == {HIGHEST_LEVEL}, "the level has not risen yet"
    [leader] = [one for one in members if one.replica is not None and one.replica.status().is_leader]
    newcomer = world.volunteer([one.member for one in members])
    assert isinstance(newcomer, UpgradedMember)
    for release, answer in ((DirectoryReplica, ReleaseOutdated), (CheckedReplica, int)):
        newcomer.run_release(release)
        outcomes = world.change(leader, newcomer.member, is_removal=False)
        assert world.run_until(world.now + 20.0, lambda outcomes=outcomes: bool(outcomes))  # type: ignore[misc]
        assert isinstance(outcomes[0], answer), outcomes
