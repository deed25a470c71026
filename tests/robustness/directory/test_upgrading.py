"""Rolling upgrades of three and five simulated supernodes in bad weather."""

from __future__ import annotations

import logging
from collections.abc import Iterator

import pytest

from tests.robustness.directory import upgrading

SEEDS_IN_SUITE, BLOCKS = 24, 2


@pytest.fixture(autouse=True)
def _no_complaints_of_the_weather() -> Iterator[None]:
    logging.disable(logging.WARNING)
    yield
    logging.disable(logging.NOTSET)


@pytest.mark.parametrize("block", range(BLOCKS))
def test_no_states_differ_while_supernodes_of_two_releases_run_together(block: int) -> None:
    capped = 0
    for seed in range(block, SEEDS_IN_SUITE, BLOCKS):
        try:
            capped += upgrading.run(seed).capped
        except Exception as error:
            error.add_note(f"replay: python -m tests.robustness.directory.upgrading --first {seed} --seeds 1")
            raise
    assert capped > SEEDS_IN_SUITE, "the newer release's command was hardly ever done"


def test_a_seed_gives_the_same_upgrade_every_time() -> None:
    first, second = upgrading.run(3), upgrading.run(3)
    assert first.capped == second.capped > 0
    assert first.world.now == second.world.now
