"""One bound for all channels and queues of a host."""

from __future__ import annotations

import pytest

from stampede_rt.errors import Overloaded
from stampede_rt_channel_host.channels.memory import Charge, MemoryBudget


def test_a_claim_beyond_the_bound_is_refused_with_the_way_out() -> None:
    budget = MemoryBudget(1000)
    Charge(budget).set(864)
    budget.claim(136)
    with pytest.raises(Overloaded, match="864 bytes together, of at most 1000"):
        budget.claim(137)


def test_what_is_charged_adds_up_as_it_changes() -> None:
    budget = MemoryBudget(1000)
    one, other = Charge(budget), Charge(budget)
    one.set(300)
    other.set(500)
    one.set(100)
    assert budget.used_bytes == 600
    other.set(0)
    assert budget.used_bytes == 100


def test_what_time_has_outdated_is_freed_before_a_claim_is_refused() -> None:
    budget = MemoryBudget(1000, lambda: charge.set(0))
    charge = Charge(budget)
    charge.set(900)
    budget.claim(1000)
    charge.set(1000)
    with pytest.raises(Overloaded):
        budget.claim(1001)
