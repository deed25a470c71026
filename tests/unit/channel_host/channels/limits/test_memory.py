"""One bound for all channels and queues of a host."""

from __future__ import annotations

import pytest

from stampede_rt.errors import Overloaded
from stampede_rt_channel_host.channels.limits.memory import RECLAIMS_MAX, Charge, MemoryBudget


def test_the_error_for_a_claim_beyond_the_bound_names_a_remedy() -> None:
    budget = MemoryBudget(1000)
    Charge(budget).set(864)
    budget.claim(136)
    with pytest.raises(Overloaded, match="864 bytes together, of at most 1000"):
        budget.claim(137)


def test_the_sum_of_charges_follows_each_change() -> None:
    budget = MemoryBudget(1000)
    one, other = Charge(budget), Charge(budget)
    one.set(300)
    other.set(500)
    one.set(100)
    assert budget.used_bytes == 600
    other.set(0)
    assert budget.used_bytes == 100


def test_outdated_items_are_freed_before_a_claim_is_refused() -> None:
    def free() -> bool:
        charge.set(0)
        return False

    budget = MemoryBudget(1000, free)
    charge = Charge(budget)
    charge.set(900)
    budget.claim(1000)
    charge.set(1000)
    with pytest.raises(Overloaded):
        budget.claim(1001)


def test_a_claim_reclaims_memory_until_there_is_room_but_in_a_bounded_number_of_steps() -> None:
    reclaims = 0

    def free() -> bool:
        nonlocal reclaims
        reclaims += 1
        charge.set(900 - reclaims)
        return True

    budget = MemoryBudget(1000, free)
    charge = Charge(budget)
    charge.set(900)
    budget.claim(102)
    assert reclaims == 2
    with pytest.raises(Overloaded):
        budget.claim(1000)
    assert reclaims == 2 + RECLAIMS_MAX
