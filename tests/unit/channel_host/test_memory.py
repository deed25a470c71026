"""One bound for all channels of a host."""

from __future__ import annotations

import pytest

from stampede_rt.errors import Overloaded
from stampede_rt_channel_host.channels.memory import MemoryBudget


class Host:
    """What is really held, and how often it was measured."""

    def __init__(self, bytes_max: int) -> None:
        self.held = 0
        self.measured = 0
        self.now = 0
        self.budget = MemoryBudget(bytes_max, self.measure, lambda: self.now)

    def measure(self) -> int:
        self.measured += 1
        return self.held

    def put(self, payload_bytes: int, items: int = 1) -> None:
        self.budget.claim(payload_bytes, items)
        self.held += payload_bytes + 64 * items


def test_nothing_is_measured_while_there_is_room() -> None:
    host = Host(1000)
    host.put(300)
    host.put(300)
    assert host.measured == 0


def test_a_put_beyond_the_bound_is_refused_with_the_way_out() -> None:
    host = Host(1000)
    host.put(800)
    with pytest.raises(Overloaded, match="864 bytes together and 1000 are their most"):
        host.put(100)


def test_items_count_beside_their_payloads() -> None:
    host = Host(1000)
    with pytest.raises(Overloaded):
        host.put(0, items=16)


def test_what_went_makes_room_at_the_next_measurement() -> None:
    host = Host(1000)
    host.put(900)
    host.held = 0
    host.put(900)
    assert host.measured == 1


def test_a_full_host_is_not_measured_at_every_put() -> None:
    host = Host(1000)
    host.put(900)
    for _ in range(100):
        with pytest.raises(Overloaded):
            host.put(900)
    assert host.measured == 1
    host.held = 0
    host.now += 10_000_000
    host.put(900)
    assert host.measured == 2
