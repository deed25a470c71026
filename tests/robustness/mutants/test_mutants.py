"""The faults that `make mutants` plants: each fits the code, and the quickest few are noticed."""

from __future__ import annotations

import pytest

from tests.robustness.mutants.planted import MUTANTS, Mutant
from tests.robustness.mutants.planting import ROOT, judge

# `judge` ends each run after 10 minutes.
pytestmark = pytest.mark.timeout(660)


def shown(mutant: Mutant) -> str:
    return mutant.name


@pytest.mark.parametrize("mutant", MUTANTS, ids=shown)
def test_a_planted_fault_still_fits_the_code(mutant: Mutant) -> None:
    place = ROOT / mutant.file
    assert place.exists(), f"mutant {mutant.name}: {mutant.file} has moved; name its new place in planted.py"
    planted = mutant.plant(place.read_text())
    compile(planted, mutant.file, "exec")


@pytest.mark.parametrize("mutant", [one for one in MUTANTS if one.quick], ids=shown)
def test_a_planted_fault_is_noticed(mutant: Mutant) -> None:
    verdict = judge(mutant)
    assert verdict.noticed, verdict.how
